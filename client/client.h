#pragma once

#include <chrono>
#include <cstddef>
#include <memory>
#include <span>
#include <stop_token>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/packed_scene.h"
#include "client/service_stream.h"
#include "shadowfit/v1/frame.pb.h"
#include "shadowfit/v1/info.pb.h"
#include "shadowfit/v1/mask.pb.h"
#include "shadowfit/v1/resolution.pb.h"

namespace grpc {
class Channel;
}

namespace shadowfit {

struct ClientOptions {
  /// How long Connect() waits for the service to answer.
  std::chrono::milliseconds connect_timeout{5000};
  /// Largest message that is sent or received, bytes. The service has a limit of its own (64 MiB by default).
  size_t max_message_bytes = size_t{256} << 20;
};

struct CallOptions {
  /// The call fails with DeadlineExceeded after this time, and the service drops its work. Zero: no limit.
  std::chrono::milliseconds timeout{30000};
  /// The call fails with Cancelled once a stop is requested, and the service drops its work.
  std::stop_token stop;
};

/// A connection to a shadowfit service. Thread-safe.
///
/// Errors of all calls: InvalidArgument names the field of the frame as "lights[2].spot.direction:
/// zero-length vector"; Unavailable means that the service is busy or gone, and the call may be tried again;
/// ResourceExhausted that the frame exceeds the service's limits and never will be served; DeadlineExceeded
/// and Cancelled are the caller's own wish. Details that came with an error (google.rpc.BadRequest,
/// RetryInfo) are payloads of the status under their type URL.
class Client {
 public:
  /// Connects to "HOST:PORT" or "unix:PATH", or to several replicas as "ipv4:A:PORT,B:PORT", over which calls
  /// are then spread. Unavailable where nothing answers in time.
  static absl::StatusOr<std::unique_ptr<Client>> Connect(const std::string& address,
                                                         const ClientOptions& options = {});

  /// Uses a channel that was made elsewhere; `name` stands for it in error messages.
  static std::unique_ptr<Client> FromChannel(std::shared_ptr<grpc::Channel> channel, std::string name);

  ~Client();

  /// Fits one frame and waits for the answer. It depends on the frame alone: for stability over time, set
  /// lights[].previous_world_to_shadow_clip or use a stream.
  absl::StatusOr<v1::FrameResult> Optimize(const v1::Frame& frame, const CallOptions& options = {});

  /// Estimates how large each light's map must be for one frame, best given at full resolution.
  absl::StatusOr<v1::ResolutionResult> EstimateResolution(const v1::Frame& frame,
                                                          const v1::ResolutionOptions& resolution_options,
                                                          const CallOptions& options = {});

  /// Opens a stream, the fast way for a renderer. Does not block. The stream may outlive the client.
  std::unique_ptr<FrameStream> OpenStream(const FrameStreamOptions& options = {});

  /// Alias-free shadow masks of one frame of a scene that was uploaded. NotFound where the service does not
  /// have it (any more); with `scene`, whose digest must be the frame's, this uploads it then and tries
  /// again.
  absl::StatusOr<v1::MaskResult> RenderMasks(const v1::MaskFrame& frame, const PackedScene* scene = nullptr,
                                             const CallOptions& options = {});

  /// Opens a stream of frames and their masks. Does not block. The stream may outlive the client.
  std::unique_ptr<MaskStream> OpenMaskStream(const FrameStreamOptions& options = {});

  /// Those of the digests that the service lacks.
  absl::StatusOr<std::vector<std::string>> FindMissingScenes(std::span<const std::string> digests,
                                                             const CallOptions& options = {});
  /// Uploads a scene in chunks; returns soon where the service has it already. The time limit must suffice
  /// for its bytes.
  absl::StatusOr<v1::UploadSceneResponse> UploadScene(const PackedScene& scene,
                                                      const CallOptions& options = {});
  absl::StatusOr<v1::ListScenesResponse> ListScenes(const CallOptions& options = {});
  absl::Status DeleteScene(const std::string& digest, const CallOptions& options = {});

  absl::StatusOr<v1::GetInfoResponse> GetInfo(const CallOptions& options = {});

  const std::string& name() const { return name_; }
  const std::shared_ptr<grpc::Channel>& channel() const { return channel_; }

 private:
  Client(std::shared_ptr<grpc::Channel> channel, std::string name);

  const std::shared_ptr<grpc::Channel> channel_;
  const std::string name_;
};

}  // namespace shadowfit
