#pragma once

#include <grpcpp/channel.h>

#include <memory>
#include <string>

#include "client/client.h"
#include "server/server.h"

namespace shadowfit::testing {

/// A server on a free port, a Unix socket and within the process, with no lame-duck time.
class Loopback {
 public:
  explicit Loopback(ServerOptions options = {});
  ~Loopback();

  Server& server() { return *server_; }
  const std::string& tcp() const { return server_->addresses()[0]; }
  const std::string& unix_socket() const { return server_->addresses()[1]; }

  /// Over TCP.
  std::unique_ptr<Client> Connect() const;
  std::unique_ptr<Client> ConnectInProcess() const;

 private:
  std::string folder_;
  std::unique_ptr<Server> server_;
};

/// Calls a unary method by name with a message in wire form: for services whose generated code is not at
/// hand.
grpc::Status CallRaw(const std::shared_ptr<grpc::Channel>& channel, const std::string& method,
                     const std::string& request, std::string* response);

/// grpc.health.v1.Health/Check: 1 SERVING, 2 NOT_SERVING, -1 an error.
int CheckHealth(const std::shared_ptr<grpc::Channel>& channel, const std::string& service);

}  // namespace shadowfit::testing
