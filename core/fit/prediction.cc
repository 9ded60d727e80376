#include "core/fit/prediction.h"

#include <algorithm>

#include "core/fit/metric.h"

namespace shadowfit {
namespace {

/// The expected misclassified pixels of one sample under the first map that holds it; none where no map does.
double OfSample(const BoundarySamples& samples, size_t i, std::span<const ShadowProjection> projections) {
  if (projections.size() == 1) return EdgeMetricOfSample(samples, i, projections[0].texel_from_ray);
  for (const ShadowProjection& projection : projections) {
    if (projection.Holds(samples.Ray(i))) return EdgeMetricOfSample(samples, i, projection.texel_from_ray);
  }
  return 0.0;
}

}  // namespace

double PredictMisclassifiedPixels(const LightSamples& samples,
                                  std::span<const ShadowProjection> projections) {
  double reliable = 0.0;
  for (size_t i = 0; i < samples.boundary.size(); ++i) reliable += OfSample(samples.boundary, i, projections);
  const double most = samples.pixels_per_sample / 3.0;
  double rough = 0.0;
  for (size_t i = 0; i < samples.rough_boundary.size(); ++i) {
    rough += std::min(OfSample(samples.rough_boundary, i, projections), most);
  }
  return kUnsampled * (reliable + 0.5 * rough);
}

}  // namespace shadowfit
