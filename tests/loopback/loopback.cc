#include "tests/loopback/loopback.h"

#include <grpcpp/client_context.h>
#include <grpcpp/generic/generic_stub.h>
#include <stdlib.h>

#include <filesystem>
#include <future>
#include <stdexcept>
#include <utility>
#include <vector>

namespace shadowfit::testing {

Loopback::Loopback(ServerOptions options) {
  char folder[] = "/tmp/shadowfit_loopback_XXXXXX";
  folder_ = mkdtemp(folder);
  options.listen = {"127.0.0.1:0", "unix:" + folder_ + "/socket"};
  options.lame_duck_seconds = 0.0;
  auto server = Server::Start(options);
  if (!server.ok()) throw std::runtime_error(std::string(server.status().message()));
  server_ = *std::move(server);
}

Loopback::~Loopback() {
  server_.reset();
  std::filesystem::remove_all(folder_);
}

std::unique_ptr<Client> Loopback::Connect() const {
  auto client = Client::Connect(tcp());
  if (!client.ok()) throw std::runtime_error(std::string(client.status().message()));
  return *std::move(client);
}

std::unique_ptr<Client> Loopback::ConnectInProcess() const {
  return Client::FromChannel(server_->InProcessChannel(), "in-process");
}

grpc::Status CallRaw(const std::shared_ptr<grpc::Channel>& channel, const std::string& method,
                     const std::string& request, std::string* response) {
  grpc::GenericStub stub(channel);
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(10));
  const grpc::Slice slice(request);
  grpc::ByteBuffer in(&slice, 1);
  grpc::ByteBuffer out;
  std::promise<grpc::Status> done;
  stub.UnaryCall(&context, method, {}, &in, &out,
                 [&done](grpc::Status status) { done.set_value(std::move(status)); });
  grpc::Status status = done.get_future().get();
  std::vector<grpc::Slice> slices;
  if (status.ok() && out.Dump(&slices).ok()) {
    for (const grpc::Slice& part : slices) {
      response->append(reinterpret_cast<const char*>(part.begin()), part.size());
    }
  }
  return status;
}

int CheckHealth(const std::shared_ptr<grpc::Channel>& channel, const std::string& service) {
  // HealthCheckRequest { string service = 1; }  HealthCheckResponse { ServingStatus status = 1; }
  std::string request;
  if (!service.empty()) request = std::string("\x0A") + static_cast<char>(service.size()) + service;
  std::string response;
  if (!CallRaw(channel, "/grpc.health.v1.Health/Check", request, &response).ok()) return -1;
  return response.size() == 2 && response[0] == '\x08' ? response[1] : 0;
}

}  // namespace shadowfit::testing
