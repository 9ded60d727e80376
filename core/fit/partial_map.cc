#include "core/fit/partial_map.h"

#include "core/fit/best_baseline.h"
#include "core/fit/prediction.h"
#include "core/fit/single_map_fit.h"
#include "core/fit/trim_shadow.h"

namespace shadowfit {
namespace {

PartialMap TrimBest(const LightProblem& problem, const DefaultOptions& options,
                    const ShadowProjection& first) {
  constexpr Method kBaselines[] = {Method::kNormal, Method::kFocused, Method::kLispsm, Method::kPlaneOptimal,
                                   Method::kPaper};
  const double predicted = PredictWrongPixels(problem, {&first, 1}).Total();
  PartialMap best{BestBaseline(problem, kBaselines, predicted).value_or(first)};
  const TrimmedShadow trimmed = TrimShadow(problem, options, {&best.projection, 1});
  best.predicted = trimmed.predicted.Total();
  best.evaluations = trimmed.evaluations;
  return best;
}

}  // namespace

PartialMap FitPartialMap(const LightProblem& problem, const DefaultOptions& options,
                         const ShadowProjection& first) {
  PartialMap best = TrimBest(problem, options, first);
  if (!options.free_aspect) return best;
  // Cuts of a map that may change its sides lead elsewhere, and not always to a better one.
  DefaultOptions fixed_aspect = options;
  fixed_aspect.free_aspect = false;
  const SingleMapFit fixed_first = FitSingleMap(problem, fixed_aspect);
  const PartialMap fixed = TrimBest(problem, fixed_aspect, fixed_first.projection);
  const int evaluations = best.evaluations + fixed_first.evaluations + fixed.evaluations;
  if (fixed.predicted < best.predicted) best = fixed;
  best.evaluations = evaluations;
  return best;
}

}  // namespace shadowfit
