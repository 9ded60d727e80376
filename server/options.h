#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace shadowfit {

/// How a service runs. Flags and the configuration file carry the same names (flags.h).
struct ServerOptions {
  /// "HOST:PORT" (port 0: any free one) or "unix:PATH". Empty: reachable within this process only.
  std::vector<std::string> listen;
  /// Without it, plaintext is refused on every address but loopback and Unix sockets.
  bool allow_plaintext = false;
  /// Requests that are worked on at a time; 0: one for each core.
  int workers = 0;

  /// Largest request that is received, bytes.
  size_t max_message_bytes = size_t{64} << 20;
  /// Requests that wait or are worked on: their bytes and their number.
  size_t max_admitted_bytes = size_t{512} << 20;
  int max_admitted_jobs = 256;
  /// Memory for uploaded scenes; those that are not in use make room for others.
  size_t max_scene_bytes = size_t{2} << 30;
  /// Streams that may be open; each keeps the memory of its largest frames for the next ones.
  int max_streams = 256;
  /// Frames of one stream that the service holds; beyond them it does not read the stream.
  int max_frames_in_stream = 3;

  /// Between saying that it is about to go and going, seconds: time for balancers and clients to notice.
  double lame_duck_seconds = 1.0;
  /// After which streams that do not end are ended, seconds.
  double drain_seconds = 10.0;

  /// "HOST:PORT" where Prometheus metrics are served as plain HTTP under /metrics. Empty: nowhere.
  std::string metrics_listen;
};

}  // namespace shadowfit
