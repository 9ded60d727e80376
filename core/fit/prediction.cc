#include "core/fit/prediction.h"

#include <algorithm>
#include <limits>

#include "core/fit/metric.h"

namespace shadowfit {
namespace {

/// The expected misclassified pixels of samples, each under the first map that holds it; none where no map
/// does.
double OfSamples(const BoundarySamples& samples, std::span<const ShadowProjection> projections,
                 double most_per_sample) {
  if (projections.size() == 1) {
    return EdgeMetric(samples, projections[0].texel_from_ray, most_per_sample);
  }
  double sum = 0.0;
  for (size_t i = 0; i < samples.size(); ++i) {
    for (const ShadowProjection& projection : projections) {
      if (!projection.Holds(samples.Ray(i))) continue;
      sum += std::min(EdgeMetricOfSample(samples, i, projection.texel_from_ray), most_per_sample);
      break;
    }
  }
  return sum;
}

}  // namespace

double PredictMisclassifiedPixels(const LightSamples& samples,
                                  std::span<const ShadowProjection> projections) {
  const double reliable = OfSamples(samples.boundary, projections, std::numeric_limits<double>::infinity());
  const double rough = OfSamples(samples.rough_boundary, projections, samples.MostWrongPixels());
  return kUnsampled * (reliable + kRoughWeight * rough);
}

}  // namespace shadowfit
