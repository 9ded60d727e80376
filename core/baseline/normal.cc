#include "core/baseline/light_frustum.h"
#include "core/baseline/methods.h"

namespace shadowfit {

absl::StatusOr<LightFit> FitNormal(const LightProblem& problem) {
  const LightFrustum frustum = NormalFrustum(problem);
  LightFit fit;
  fit.projection = MapRectangle(frustum.plane, frustum.extents, problem.map_size);
  fit.outcome = frustum.outcome;
  fit.note = frustum.note;
  return fit;
}

}  // namespace shadowfit
