#pragma once

#include <glm/glm.hpp>
#include <optional>
#include <vector>

#include "absl/status/statusor.h"
#include "core/cancellation.h"
#include "core/frame/camera.h"
#include "core/frame/frame_sampler.h"
#include "core/frame/light_samples.h"
#include "core/math/light.h"
#include "core/math/ray_space.h"
#include "core/math/shadow_projection.h"
#include "core/scene/bounds.h"

namespace shadowfit {

struct RayHulls;

/// All that a method may read when it makes one light's matrix for one frame. Everything is borrowed; nothing
/// in here depends on the matrix that is sought.
struct LightProblem {
  const Camera* camera = nullptr;
  const Light* light = nullptr;
  const RaySpace* ray_space = nullptr;
  const LightSamples* samples = nullptr;
  MapSize map_size;

  /// Extremes of the visible samples' NDC depth: the part of the view frustum that holds anything.
  double nearest_ndc_depth = -1.0;
  double farthest_ndc_depth = 1.0;

  /// Bounds of the scene's casters and receivers where the caller gave them, of the visible part of the view
  /// frustum otherwise. Never empty.
  Bounds ws_scene_bounds;

  /// What the frame was sampled by and the light's number in it: knows every pixel of the light's shadow,
  /// where there are bits, and not only the samples. May be null: then the samples are all that is known.
  const FrameSampler* sampler = nullptr;
  size_t light_in_frame = 0;
  /// Whether every pixel of the light's shadow is known, and there is any edge of it.
  bool KnowsShadow() const { return sampler != nullptr && samples->source == SampleSource::kShadowBoundary; }

  /// Polled between the steps of long fits, whose answer is worthless once it is requested.
  const Cancellation* cancellation = nullptr;

  /// Hulls of `samples` that MakeRayHull() made for this problem, for whoever asks next. May be null: then
  /// each makes its own.
  RayHulls* hulls = nullptr;

  /// The previous frame's projection of this light, where there was one and it was this light's.
  const ShadowProjection* previous = nullptr;
};

/// How a method came to its matrix.
enum class FitOutcome {
  kFitted,        ///< As the method says.
  kKeptPrevious,  ///< The previous frame's matrix, as it is or rescaled, was good enough.
  kFallback,      ///< The method cannot serve this configuration; LightFit::note says what was done instead.
};

struct LightFit {
  ShadowProjection projection;
  /// Further maps of the light where the method makes several: the first map that holds a point judges it,
  /// `projection` before these.
  std::vector<ShadowProjection> further_projections;
  FitOutcome outcome = FitOutcome::kFitted;
  const char* note = "";  ///< A static string: the reason for a fallback; empty otherwise.
  int evaluations = 0;    ///< How often the objective was evaluated; 0 for methods without one.

  /// All maps, in the order in which they are asked.
  std::vector<ShadowProjection> Projections() const {
    std::vector<ShadowProjection> projections = {projection};
    projections.insert(projections.end(), further_projections.begin(), further_projections.end());
    return projections;
  }
};

/// A way of making a light matrix: the papers' optimizer, ours, or a published baseline. Stateless and
/// thread-safe.
class LightMatrixMethod {
 public:
  virtual ~LightMatrixMethod() = default;

  /// Fails only where no usable matrix exists at all; a configuration that the method itself cannot serve is
  /// answered with a stated fallback.
  virtual absl::StatusOr<LightFit> Fit(const LightProblem& problem) const = 0;
};

}  // namespace shadowfit
