#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "core/bias/safe_bias.h"
#include "core/budget/atlas.h"
#include "core/cancellation.h"
#include "core/fit/light_problem.h"
#include "core/fit/map_quality.h"
#include "core/fit/options.h"
#include "core/frame/camera.h"
#include "core/frame/images.h"
#include "core/math/light.h"

namespace shadowfit {

/// One light of a frame.
struct LightRequest {
  uint32_t id = 0;  ///< The caller's name for the light; unique in a frame.
  Light light;
  MapSize
      map_size;  ///< Texels, 1 to kMaxMapSize a side. The aspect ratio only, where Options::sizing is set.
  /// The matrix that the previous frame used, in FrameRequest::output_clip_depth convention; temporal
  /// stability works from it. A matrix that is not this light's (it moved) is ignored, and the summary says
  /// so.
  std::optional<glm::dmat4> previous_clip_from_world;
  double weight = 1.0;  ///< What a wrong pixel of this light counts where texels are shared. Above 0.
  /// Texels of the map that the previous matrix made, 1 to kMaxMapSize a side; none: `map_size`.
  std::optional<MapSize> previous_map_size = std::nullopt;
};

inline constexpr int kMaxLights = 32;

/// One frame: what the camera sees, and the lights to fit. Pictures are borrowed.
struct FrameRequest {
  CameraMatrices camera;
  DepthView depth;
  std::optional<BitsView> bits;      ///< Same size as depth; bit i belongs to lights[i].
  std::vector<LightRequest> lights;  ///< At most kMaxLights.
  /// Size of the final picture, whose pixels predictions count. Zero: that of the depth buffer.
  MapSize screen;
  std::optional<Bounds> ws_scene_bounds;
  ClipDepth output_clip_depth = ClipDepth::kNegativeOneToOne;
  /// Asks for LightMap::safe_bias, which takes time of its own; its `screen` is taken from above.
  std::optional<BiasOptions> safe_bias;
};

/// One shadow map.
struct LightMap {
  glm::dmat4 clip_from_world{1.0};
  ShadowProjection projection;
  DepthRange depth_range;
  std::optional<SafeBias> safe_bias;            ///< Where the request asks for it.
  std::optional<AtlasPosition> atlas_position;  ///< Where BudgetOptions::atlas asks for it.
};

/// What was done for one light, and how good it is.
struct LightSummary : LightMap {
  uint32_t id = 0;
  /// Further maps where options allow several: the first map that holds a point judges it, the light's own
  /// (this) before these. Points that no map holds are lit.
  std::vector<LightMap> further_maps;
  FitOutcome outcome = FitOutcome::kFitted;
  SampleSource sample_source = SampleSource::kNone;
  std::string note;  ///< Why a fallback was taken, or why a previous matrix was ignored; empty otherwise.

  /// On the final screen; shadow that no map holds included.
  double predicted_misclassified_pixels = 0.0;
  double shadow_outside_pixels = 0.0;  ///< Of these, shadow that no map holds.
  double objective = 0.0;              ///< The papers' h at the returned matrix.
  /// Mean motion of texel centres on the receivers since the previous frame, in pixels of the final screen
  /// (swim.h). Where the request has a previous matrix of this light, and the light one map.
  std::optional<double> swim_pixels;
  /// Why the prediction is what it is; without shadow edges, of every edge that there might be. Where
  /// Options::assess_quality asks for it.
  std::optional<MapQuality> quality;
  int boundary_samples = 0;
  int hull_samples = 0;
  int evaluations = 0;
  double seconds = 0.0;  ///< This light's share: samples, fit and depth row.
};

struct FrameSummary {
  std::vector<LightSummary> lights;  ///< In the order of the request.
  double sampling_seconds = 0.0;     ///< Work shared by all lights.
  double bias_seconds = 0.0;         ///< Safe biases of all lights.
  double total_seconds = 0.0;

  std::string BriefReport() const;  ///< One line.
  std::string FullReport() const;   ///< A table, one row a light.
};

/// Turns frames into light matrices. Keeps its working memory between calls, so that a stream of frames
/// allocates nothing once warm: use one optimizer a stream, from one thread at a time. The answer depends on
/// the request alone.
class FrameOptimizer {
 public:
  FrameOptimizer();
  ~FrameOptimizer();
  FrameOptimizer(FrameOptimizer&&) noexcept;
  FrameOptimizer& operator=(FrameOptimizer&&) noexcept;

  /// InvalidArgument where the request is malformed; the message begins with the field, as
  /// "lights[2].spot.direction: zero-length vector". Cancelled or DeadlineExceeded where `cancellation` asks
  /// for it.
  absl::Status Optimize(const FrameRequest& request, const Options& options, const Cancellation& cancellation,
                        FrameSummary* summary);

 private:
  struct Workspace;
  std::unique_ptr<Workspace> workspace_;
};

}  // namespace shadowfit
