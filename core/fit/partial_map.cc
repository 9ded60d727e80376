#include "core/fit/partial_map.h"

#include "core/fit/best_baseline.h"
#include "core/fit/prediction.h"
#include "core/fit/trim_shadow.h"

namespace shadowfit {

PartialMap FitPartialMap(const LightProblem& problem, const DefaultOptions& options,
                         const ShadowProjection& first) {
  constexpr Method kBaselines[] = {Method::kNormal, Method::kFocused, Method::kLispsm, Method::kPlaneOptimal,
                                   Method::kPaper};
  PartialMap best{first, 0};
  const double predicted = PredictWrongPixels(problem, {&first, 1}).Total();
  best.projection = BestBaseline(problem, kBaselines, predicted).value_or(first);
  best.evaluations = TrimShadow(problem, options, {&best.projection, 1}).evaluations;
  return best;
}

}  // namespace shadowfit
