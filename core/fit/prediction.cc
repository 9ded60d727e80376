#include "core/fit/prediction.h"

#include "core/fit/metric.h"

namespace shadowfit {
namespace {

/// The expected misclassified pixels of samples, each under the first map that holds it; none where no map
/// does.
double OfSamples(const BoundarySamples& samples, std::span<const ShadowProjection> projections) {
  if (projections.size() == 1) {
    return EdgeMetric(samples, projections[0].texel_from_ray);
  }
  double sum = 0.0;
  for (size_t i = 0; i < samples.size(); ++i) {
    for (const ShadowProjection& projection : projections) {
      if (!projection.Holds(samples.Ray(i))) continue;
      sum += EdgeMetricOfSample(samples, i, projection.texel_from_ray);
      break;
    }
  }
  return sum;
}

}  // namespace

double PredictMisclassifiedPixels(const LightSamples& samples,
                                  std::span<const ShadowProjection> projections) {
  return kUnsampled *
         (OfSamples(samples.boundary, projections) + OfSamples(samples.rough_boundary, projections));
}

}  // namespace shadowfit
