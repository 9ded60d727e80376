#include "core/fit/default_method.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <vector>

#include "core/fit/map_partition.h"
#include "core/fit/outer_samples.h"
#include "core/fit/prediction.h"
#include "core/fit/rescale_previous.h"

namespace shadowfit {
namespace {

/// Fraction of width and height left free on each side where a kept matrix is rescaled to hold this frame's
/// samples: until they have moved through it, the next frames need not rescale again.
constexpr double kBorder = 0.02;

/// Of a kept matrix: with a free aspect ratio, the ratio stays as well, and with it every texel where the
/// number of texels does.
MapSize KeptSize(const LightProblem& problem, const DefaultOptions& options) {
  const MapSize previous = problem.previous->size;
  if (!options.free_aspect) return problem.map_size;
  const double share = previous.texels() / problem.map_size.texels();
  if (share <= 1.0 && share > 0.98) return previous;
  const double stretch = double(previous.width) / previous.height;
  const int width = std::max(1, static_cast<int>(std::sqrt(problem.map_size.texels() * stretch)));
  return {width, std::max(1, static_cast<int>(problem.map_size.texels() / width))};
}

/// What a kept matrix must hold.
std::vector<glm::dvec3> ShadowRays(const LightSamples& samples) {
  std::vector<glm::dvec3> rays;
  for (const int32_t i : HullSamples(samples, HullOf::kShadow)) {
    rays.push_back(samples.hull_rays[static_cast<size_t>(i)]);
  }
  return rays;
}

}  // namespace

absl::StatusOr<LightFit> DefaultMethod::Fit(const LightProblem& problem) const {
  const MapPartition partition = PartitionMaps(problem, options_);
  LightFit fit;
  if (partition.maps.size() == 1 && partition.maps[0].complete && problem.previous != nullptr &&
      options_.keep_within > 0.0) {
    const std::optional<ShadowProjection> kept =
        RescaleToHold(*problem.previous, KeptSize(problem, options_), ShadowRays(*problem.samples), kBorder);
    const std::array fresh = {partition.maps[0].projection};
    if (kept && PredictMisclassifiedPixels(*problem.samples, {&*kept, 1}) <=
                    options_.keep_within * PredictMisclassifiedPixels(*problem.samples, fresh)) {
      fit.projection = *kept;
      fit.outcome = FitOutcome::kKeptPrevious;
      fit.evaluations = partition.maps[0].evaluations;
      return fit;
    }
  }
  fit.projection = partition.maps[0].projection;
  for (const SingleMapFit& map : partition.maps) {
    fit.evaluations += map.evaluations;
    if (&map != &partition.maps[0]) fit.further_projections.push_back(map.projection);
    if (map.complete) continue;
    fit.outcome = FitOutcome::kFallback;
    fit.note =
        "receivers span a half space or more as seen from the light; the map holds the part around its axis";
  }
  return fit;
}

}  // namespace shadowfit
