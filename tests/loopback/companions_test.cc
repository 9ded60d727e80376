// What stands beside the services: health, reflection, information, metrics, addresses.
#include <arpa/inet.h>
#include <grpcpp/client_context.h>
#include <grpcpp/completion_queue.h>
#include <grpcpp/generic/generic_stub.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <string>
#include <vector>

#include "tests/loopback/loopback.h"
#include "tests/support/wire_frame.h"

namespace shadowfit {
namespace {

using namespace std::chrono_literals;

TEST(Health, IsToldForTheServerAndForEachService) {
  testing::Loopback loopback;
  const auto channel = loopback.Connect()->channel();
  for (const char* service : {"", "shadowfit.v1.OptimizerService", "shadowfit.v1.InfoService"}) {
    EXPECT_EQ(testing::CheckHealth(channel, service), 1) << service;
  }
  EXPECT_EQ(testing::CheckHealth(channel, "shadowfit.v1.Unheard"), -1);
}

TEST(Reflection, ListsTheServices) {
  testing::Loopback loopback;
  const auto channel = loopback.Connect()->channel();
  grpc::GenericStub stub(channel);
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + 10s);
  grpc::CompletionQueue queue;
  const auto wait = [&queue] {
    void* tag = nullptr;
    bool ok = false;
    return queue.Next(&tag, &ok) && ok;
  };
  const auto call =
      stub.PrepareCall(&context, "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo", &queue);
  call->StartCall(nullptr);
  ASSERT_TRUE(wait());
  const grpc::Slice request(
      std::string("\x3A\x01*"));  // ServerReflectionRequest { string list_services = 7; }
  call->Write(grpc::ByteBuffer(&request, 1), nullptr);
  ASSERT_TRUE(wait());
  grpc::ByteBuffer response;
  call->Read(&response, nullptr);
  ASSERT_TRUE(wait());
  std::vector<grpc::Slice> slices;
  ASSERT_TRUE(response.Dump(&slices).ok());
  std::string text;
  for (const grpc::Slice& slice : slices)
    text.append(reinterpret_cast<const char*>(slice.begin()), slice.size());
  for (const char* service :
       {"shadowfit.v1.OptimizerService", "shadowfit.v1.InfoService", "grpc.health.v1.Health"}) {
    EXPECT_NE(text.find(service), std::string::npos) << service;
  }
  call->WritesDone(nullptr);
  ASSERT_TRUE(wait());
  grpc::Status status;
  call->Finish(&status, nullptr);
  ASSERT_TRUE(wait());
  EXPECT_TRUE(status.ok());
}

TEST(Info, TellsLimitsAndLoad) {
  ServerOptions options;
  options.workers = 3;
  options.max_message_bytes = 12345678;
  options.max_admitted_jobs = 17;
  testing::Loopback loopback(options);
  const auto client = loopback.Connect();
  const auto stream = client->OpenStream();
  v1::Frame* frame = stream->Acquire();
  *frame = testing::WireFrame(1, testing::RandomFrame(1, 8, 8, 1).request);
  ASSERT_TRUE(stream->Submit(frame).ok());
  ASSERT_TRUE(stream->Wait(10s).has_value());
  const auto info = client->GetInfo();
  ASSERT_TRUE(info.ok()) << info.status();
  EXPECT_FALSE(info->version().empty());
  EXPECT_EQ(info->limits().workers(), 3U);
  EXPECT_EQ(info->limits().max_message_bytes(), 12345678U);
  EXPECT_EQ(info->limits().max_admitted_jobs(), 17U);
  EXPECT_EQ(info->limits().max_lights(), 32U);
  EXPECT_EQ(info->load().open_streams(), 1U);
  EXPECT_FALSE(info->load().draining());
}

TEST(Addresses, ASecondServerOnTheSamePortIsRefused) {
  testing::Loopback loopback;
  ServerOptions options;
  options.listen = {loopback.tcp()};
  const auto second = Server::Start(options);
  ASSERT_FALSE(second.ok());
  EXPECT_TRUE(absl::IsUnavailable(second.status())) << second.status();
  EXPECT_NE(second.status().message().find(loopback.tcp()), absl::string_view::npos);
}

TEST(Addresses, PlaintextBeyondThisMachineIsRefusedUnlessAllowed) {
  ServerOptions options;
  options.listen = {"0.0.0.0:0"};
  EXPECT_TRUE(absl::IsInvalidArgument(Server::Start(options).status()));
  options.allow_plaintext = true;
  options.lame_duck_seconds = 0.0;
  EXPECT_TRUE(Server::Start(options).ok());
}

std::string HttpGet(uint16_t port, const std::string& path) {
  const int socket_fd = socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(port);
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  std::string reply;
  if (connect(socket_fd, reinterpret_cast<sockaddr*>(&address), sizeof(address)) == 0) {
    const std::string request = "GET " + path + " HTTP/1.0\r\n\r\n";
    if (write(socket_fd, request.data(), request.size()) == static_cast<ssize_t>(request.size())) {
      char buffer[4096];
      ssize_t count = 0;
      while ((count = read(socket_fd, buffer, sizeof(buffer))) > 0)
        reply.append(buffer, static_cast<size_t>(count));
    }
  }
  close(socket_fd);
  return reply;
}

uint16_t FreePort() {
  const int socket_fd = socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof(address);
  EXPECT_EQ(bind(socket_fd, reinterpret_cast<sockaddr*>(&address), size), 0);
  EXPECT_EQ(getsockname(socket_fd, reinterpret_cast<sockaddr*>(&address), &size), 0);
  close(socket_fd);
  return ntohs(address.sin_port);
}

TEST(Metrics, CountWhatWasAnswered) {
  const uint16_t port = FreePort();
  ServerOptions options;
  options.metrics_listen = "127.0.0.1:" + std::to_string(port);
  testing::Loopback loopback(options);
  const auto client = loopback.Connect();
  const v1::Frame good = testing::WireFrame(1, testing::RandomFrame(1, 8, 8, 1).request);
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(client->Optimize(good).ok());
  EXPECT_FALSE(client->Optimize({}).ok());
  const std::string text = HttpGet(port, "/metrics");
  EXPECT_NE(text.find("shadowfit_answers_total{code=\"OK\",method=\"Optimize\"} 3"), std::string::npos)
      << text;
  EXPECT_NE(text.find("shadowfit_answers_total{code=\"INVALID_ARGUMENT\",method=\"Optimize\"} 1"),
            std::string::npos)
      << text;
  EXPECT_NE(text.find("shadowfit_queue_seconds_count{method=\"Optimize\"} 4"), std::string::npos) << text;
  EXPECT_NE(text.find("shadowfit_compute_seconds_count{method=\"Optimize\"} 4"), std::string::npos) << text;
  EXPECT_NE(text.find("shadowfit_open_streams 0"), std::string::npos) << text;
  EXPECT_NE(text.find("shadowfit_admitted_bytes 0"), std::string::npos) << text;
}

}  // namespace
}  // namespace shadowfit
