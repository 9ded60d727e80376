#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/options.h"

namespace grpc {
class Channel;
}

namespace shadowfit {

/// InvalidArgument, naming the option, where Server::Start() would say so.
absl::Status CheckServerOptions(const ServerOptions& options);

/// A running shadowfit service with its standard companions: health of each service, reflection, metrics.
class Server {
 public:
  /// InvalidArgument for options that make no sense, Unavailable where an address cannot be had.
  static absl::StatusOr<std::unique_ptr<Server>> Start(const ServerOptions& options);

  /// Drains, if that was not done.
  ~Server();
  Server(const Server&) = delete;
  Server& operator=(const Server&) = delete;

  /// Where the service listens, with the ports that were chosen.
  const std::vector<std::string>& addresses() const { return addresses_; }

  /// A connection that does not leave the process.
  std::shared_ptr<grpc::Channel> InProcessChannel();

  /// Ends the service in good order and returns when it has ended: says NOT_SERVING to health checks, asks
  /// the clients of open streams to end them, gives everyone the lame-duck time to go elsewhere, answers what
  /// has arrived, ends the streams that are still open after the drain time, and shuts down.
  void Drain();

 private:
  struct Impl;
  explicit Server(std::unique_ptr<Impl> impl);

  std::unique_ptr<Impl> impl_;
  std::vector<std::string> addresses_;
};

/// Raises glibc's thresholds so that message buffers stay with the process instead of going back to the
/// kernel with every frame, which costs more than the copy of the frame itself. For programs; a library
/// leaves its host's allocator alone.
void KeepLargeBuffers();

}  // namespace shadowfit
