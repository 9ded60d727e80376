#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "client/demo/walk.h"
#include "client/render/renderer.h"
#include "client/service_stream.h"
#include "core/fit/frame_optimizer.h"

namespace shadowfit {

struct FrameLoopOptions {
  v1::Method method = v1::METHOD_DEFAULT;
  MapSize map_size{512, 512};  ///< Of every light's shadow map.

  /// A frame is drawn with the matrices of the frame that was drawn so many frames before, so that the
  /// service has that long to answer. The loop waits only where it takes longer, and does not use an answer
  /// that comes sooner: what is drawn does not depend on how fast the service is.
  int latency = 2;

  /// The matrices will serve a camera that has moved on by then: the low-resolution pass looks this share
  /// farther than the screen on each side.
  double guard_band = 0.08;

  /// Every so many frames the bit pass uses conventional (Focused) shadow maps of the moment instead of the
  /// last frame's, because what came into view beside those would otherwise stay unseen for good. 0: never.
  int standard_maps_every = 4;
};

/// Where a frame's time went, in milliseconds.
struct FrameTrace {
  double samples_ms = 0.0;      ///< Low-resolution pass, conventional maps for it included, and read-back.
  double wait_ms = 0.0;         ///< For the service.
  double shadow_maps_ms = 0.0;  ///< Passes with the matrices that returned.
  /// Of the answer that this frame was drawn with; none before the first answer.
  std::optional<double> round_trip_ms;
  std::vector<double> optimize_ms;  ///< One a light, as the service measured it.
};

/// A renderer's loop around the service: low-resolution pass with the previous maps, read-back, frame to the
/// service, shadow maps with the matrices that came back. The caller draws its picture with maps().
class FrameLoop {
 public:
  /// `renderer` must outlive the loop.
  static absl::StatusOr<std::unique_ptr<FrameLoop>> Create(Renderer* renderer, std::vector<SceneLight> lights,
                                                           std::unique_ptr<FrameStream> stream,
                                                           const FrameLoopOptions& options);

  /// Makes maps() ready for a picture from this camera. Fails where the service is gone or refuses the frame.
  absl::StatusOr<FrameTrace> Step(const CameraMatrices& camera);

  const ShadowMaps& maps() const { return maps_; }
  const FrameLoopOptions& options() const { return options_; }

 private:
  FrameLoop(Renderer* renderer, std::vector<SceneLight> lights, std::unique_ptr<FrameStream> stream,
            const FrameLoopOptions& options, ShadowMaps maps, ShadowMaps standard_maps);

  absl::Status DrawSamples(const Camera& camera);
  absl::Status DrawStandardMaps(const Camera& camera, ShadowMaps* maps);
  absl::Status Submit(const CameraMatrices& camera);
  absl::StatusOr<FrameOutcome> Await(uint64_t frame_id);
  absl::Status DrawMaps(const v1::FrameResult& result);

  Renderer* renderer_;
  std::vector<SceneLight> lights_;
  std::unique_ptr<FrameStream> stream_;
  FrameLoopOptions options_;
  ShadowMaps maps_;           // The picture's, and the next frame's bits'.
  ShadowMaps standard_maps_;  // The bit pass's now and then.
  bool maps_drawn_ = false;
  uint64_t frame_id_ = 0;  // Of the frame that is being drawn.
  SampleBuffers samples_;
  FrameOptimizer optimizer_;  // For the conventional maps, which a renderer makes for itself.
  FrameSummary summary_;
  std::map<uint64_t, FrameOutcome> early_;  // Answers that are not due yet.
};

/// The camera with its frustum widened by a share of the picture on each side.
CameraMatrices WithGuardBand(CameraMatrices camera, double guard_band);

}  // namespace shadowfit
