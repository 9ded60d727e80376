#pragma once

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "client/client.h"

namespace shadowfit {

class Server;

/// The service that a command uses: one elsewhere, or its own.
class ServiceConnection {
 public:
  /// Connects to `address` ("HOST:PORT" or "unix:PATH"); where it is empty, starts a service in this process.
  /// It is the same code that shadowfit-server runs, reached by a channel that leaves out the network.
  static absl::StatusOr<std::unique_ptr<ServiceConnection>> Open(const std::string& address);
  ~ServiceConnection();

  Client& client() { return *client_; }
  bool is_embedded() const { return server_ != nullptr; }

 private:
  ServiceConnection();

  std::unique_ptr<Server> server_;
  std::unique_ptr<Client> client_;  // Goes before the server that it talks to.
};

}  // namespace shadowfit
