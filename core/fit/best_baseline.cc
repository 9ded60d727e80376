#include "core/fit/best_baseline.h"

#include "absl/status/statusor.h"
#include "core/fit/method_factory.h"
#include "core/fit/prediction.h"

namespace shadowfit {

std::optional<ShadowProjection> BestBaseline(const LightProblem& problem, std::span<const Method> methods,
                                             double wrong_pixels) {
  std::optional<ShadowProjection> best;
  for (const Method method : methods) {
    Options options;
    options.method = method;
    const absl::StatusOr<LightFit> fit = MakeMethod(options)->Fit(problem);
    if (!fit.ok()) continue;
    const std::span<const ShadowProjection> map(&fit->projection, 1);
    // Most get more wrong at the edges that they hold alone. False for NaN.
    if (!(PredictHeldPixels(*problem.samples, map) < wrong_pixels)) continue;
    const double predicted = PredictWrongPixels(problem, map).Total();
    if (!(predicted < wrong_pixels)) continue;
    wrong_pixels = predicted;
    best = fit->projection;
  }
  return best;
}

}  // namespace shadowfit
