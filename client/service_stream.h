#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "shadowfit/v1/frame.pb.h"
#include "shadowfit/v1/mask.pb.h"

namespace grpc {
class Channel;
}

namespace shadowfit {

struct FrameStreamOptions {
  /// Frames that may be under way at a time, from Submit() until their outcome is taken. The stream keeps one
  /// message for each, so memory is bounded and reused.
  int max_in_flight = 3;
  /// A frame without an answer for this long has failed with DeadlineExceeded; the service drops its work.
  /// Zero: never.
  std::chrono::milliseconds frame_timeout{5000};
};

/// What became of a frame.
template <typename Result>
struct StreamOutcome {
  uint64_t frame_id = 0;
  /// NotFound where the service has forgotten the frame's scene, or is another one than it was uploaded to:
  /// upload it (Client::UploadScene) and send the next frames.
  absl::StatusOr<Result> result = absl::UnknownError("no outcome");
  /// From Submit() to the arrival of the answer or the failure.
  std::chrono::nanoseconds round_trip{0};
};

/// A stream of frames to the service and of results back, for a render loop that must not stall:
///
///     if (v1::Frame* frame = stream->Acquire()) {  // Null: the service is behind; render on with older
///     matrices.
///       FillIn(frame);                             // frame_id must grow from frame to frame, from 1.
///       absl::Status status = stream->Submit(frame);
///     }
///     while (std::optional<FrameOutcome> outcome = stream->Poll()) Use(*outcome);
///
/// Acquire, Submit and Poll never wait for the service. Every submitted frame has exactly one outcome: when
/// the service dies, or is stopped, all frames under way fail with Unavailable, and Submit() returns why.
/// Thread-safe; outcomes come in the order in which they are ready.
template <typename Frame, typename Result>
class ServiceStream {
 public:
  /// `name` stands for the service in error messages.
  ServiceStream(const std::shared_ptr<grpc::Channel>& channel, std::string name,
                const FrameStreamOptions& options);
  /// Cancels what is under way, and returns when gRPC has let go of it.
  ~ServiceStream();
  ServiceStream(const ServiceStream&) = delete;
  ServiceStream& operator=(const ServiceStream&) = delete;

  /// An empty frame to fill in, whose buffers kept the memory of an earlier one; null while max_in_flight
  /// frames are under way. It belongs to the stream; hand it back with Submit() or Discard().
  Frame* Acquire();

  /// Sends a frame that Acquire() returned. Its frame_id must exceed those of all earlier frames of this
  /// stream (InvalidArgument otherwise). Fails with the reason once the stream has ended or the service asked
  /// for its end: then open a new one. On failure the frame is given back.
  absl::Status Submit(Frame* frame);
  void Discard(Frame* frame);

  /// An outcome that is there already, or nothing.
  std::optional<StreamOutcome<Result>> Poll();
  /// Waits up to `timeout` for an outcome; nothing where no frame is under way or none was ready in time.
  std::optional<StreamOutcome<Result>> Wait(std::chrono::milliseconds timeout);

  /// Frames submitted whose outcome was not yet taken.
  int in_flight() const;

  /// OK while frames can be submitted; then why they cannot.
  absl::Status status() const;

  /// Ends the stream in good order: no further Submit(); waits up to `timeout` until all frames under way are
  /// answered (their outcomes stay to be polled), then cancels what is left. Returns how the stream ended.
  absl::Status Finish(std::chrono::milliseconds timeout);

  /// Ends the stream at once; frames under way fail with Cancelled.
  void Cancel();

 private:
  class Reactor;
  std::unique_ptr<Reactor> reactor_;
};

/// Light matrices; the service remembers each light's from frame to frame.
using FrameStream = ServiceStream<v1::Frame, v1::FrameResult>;
using FrameOutcome = StreamOutcome<v1::FrameResult>;
/// Shadow masks.
using MaskStream = ServiceStream<v1::MaskFrame, v1::MaskResult>;
using MaskOutcome = StreamOutcome<v1::MaskResult>;

}  // namespace shadowfit
