#include "client/embedded/service_connection.h"

#include <utility>

#include "server/server.h"

namespace shadowfit {

absl::StatusOr<std::unique_ptr<ServiceConnection>> ServiceConnection::Open(const std::string& address) {
  std::unique_ptr<ServiceConnection> connection(new ServiceConnection());
  if (!address.empty()) {
    absl::StatusOr<std::unique_ptr<Client>> client = Client::Connect(address);
    if (!client.ok()) return client.status();
    connection->client_ = *std::move(client);
    return connection;
  }
  KeepLargeBuffers();
  ServerOptions options;
  options.lame_duck_seconds = 0.0;  // Its only client goes first.
  // Limits protect a shared service from its clients; here they are one.
  options.max_message_bytes = size_t{1} << 30;
  options.max_admitted_bytes = size_t{4} << 30;
  absl::StatusOr<std::unique_ptr<Server>> server = Server::Start(options);
  if (!server.ok()) return server.status();
  connection->server_ = *std::move(server);
  connection->client_ = Client::FromChannel(connection->server_->InProcessChannel(), "embedded service");
  return connection;
}

ServiceConnection::ServiceConnection() = default;
ServiceConnection::~ServiceConnection() = default;

}  // namespace shadowfit
