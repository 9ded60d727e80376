#include "core/fit/prediction.h"

#include <algorithm>

#include "core/fit/metric.h"

namespace shadowfit {
namespace {

/// The expected misclassified pixels of samples, each under the first map that holds it; none where no map
/// does.
double OfHeld(const BoundarySamples& samples, std::span<const ShadowProjection> projections) {
  double sum = 0.0;
  for (size_t i = 0; i < samples.size(); ++i) {
    const auto map = std::find_if(projections.begin(), projections.end(),
                                  [&](const ShadowProjection& p) { return p.Holds(samples.Ray(i)); });
    if (map != projections.end()) sum += EdgeMetricOfSample(samples, i, map->texel_from_ray);
  }
  return sum;
}

}  // namespace

double PredictMisclassifiedPixels(const LightSamples& samples,
                                  std::span<const ShadowProjection> projections) {
  if (projections.size() > 1) return PredictHeldPixels(samples, projections);
  const glm::dmat3& texel_from_ray = projections[0].texel_from_ray;
  return UnseenFactor(samples) *
         (EdgeMetric(samples.boundary, texel_from_ray) + EdgeMetric(samples.rough_boundary, texel_from_ray));
}

bool HoldShadow(const LightSamples& samples, std::span<const ShadowProjection> projections) {
  for (size_t i = 0; i < samples.hull_rays.size(); ++i) {
    if (samples.hull_in_shadow[i] == 0) continue;
    const auto holds = [&](const ShadowProjection& map) { return map.Holds(samples.hull_rays[i], 0.5); };
    if (std::none_of(projections.begin(), projections.end(), holds)) return false;
  }
  return true;
}

double PredictHeldPixels(const LightSamples& samples, std::span<const ShadowProjection> projections) {
  return UnseenFactor(samples) *
         (OfHeld(samples.boundary, projections) + OfHeld(samples.rough_boundary, projections));
}

}  // namespace shadowfit
