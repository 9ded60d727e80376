#include "core/fit/partial_map.h"

#include <cmath>
#include <memory>

#include "absl/status/statusor.h"
#include "core/fit/method_factory.h"
#include "core/fit/prediction.h"
#include "core/fit/trim_shadow.h"

namespace shadowfit {

PartialMap FitPartialMap(const LightProblem& problem, const DefaultOptions& options,
                         const ShadowProjection& first) {
  PartialMap best{first, 0};
  double least = PredictWrongPixels(problem, {&first, 1}).Total();
  for (const Method method :
       {Method::kNormal, Method::kFocused, Method::kLispsm, Method::kPlaneOptimal, Method::kPaper}) {
    Options baseline;
    baseline.method = method;
    const absl::StatusOr<LightFit> fit = MakeMethod(baseline)->Fit(problem);
    if (!fit.ok()) continue;
    const double predicted = PredictWrongPixels(problem, {&fit->projection, 1}).Total();
    if (!std::isfinite(predicted) || !(predicted < least)) continue;
    least = predicted;
    best.projection = fit->projection;
  }
  best.evaluations = TrimShadow(problem, options, {&best.projection, 1});
  return best;
}

}  // namespace shadowfit
