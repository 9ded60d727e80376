#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/frame_stream.h"
#include "shadowfit/v1/mask.pb.h"

namespace shadowfit {

/// What became of a frame.
struct MaskOutcome {
  uint64_t frame_id = 0;
  /// NotFound where the service has forgotten the scene, or is another one than it was uploaded to: upload it
  /// (Client::UploadScene) and send the next frames.
  absl::StatusOr<v1::MaskResult> result = absl::UnknownError("no outcome");
  /// From Submit() to the arrival of the answer or the failure.
  std::chrono::nanoseconds round_trip{0};
};

/// A stream of frames to the service and of shadow masks back. As FrameStream, which see.
class MaskStream {
 public:
  /// `name` stands for the service in error messages.
  MaskStream(const std::shared_ptr<grpc::Channel>& channel, std::string name,
             const FrameStreamOptions& options);
  /// Cancels what is under way, and returns when gRPC has let go of it.
  ~MaskStream();
  MaskStream(const MaskStream&) = delete;
  MaskStream& operator=(const MaskStream&) = delete;

  v1::MaskFrame* Acquire();
  absl::Status Submit(v1::MaskFrame* frame);
  void Discard(v1::MaskFrame* frame);

  std::optional<MaskOutcome> Poll();
  std::optional<MaskOutcome> Wait(std::chrono::milliseconds timeout);
  int in_flight() const;
  absl::Status status() const;
  absl::Status Finish(std::chrono::milliseconds timeout);
  void Cancel();

 private:
  class Reactor;
  std::unique_ptr<Reactor> reactor_;
};

}  // namespace shadowfit
