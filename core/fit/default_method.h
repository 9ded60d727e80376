#pragma once

#include "core/fit/light_problem.h"
#include "core/fit/options.h"

namespace shadowfit {

/// The best matrices that this library knows: the `edge` metric (expected misclassified pixels) minimised
/// over the axis and the enclosing parallelogram together, in whitened ray coordinates; and several maps
/// where one cannot serve the light, or where they are predicted to serve it better at the same number of
/// texels (map_partition.h).
class DefaultMethod : public LightMatrixMethod {
 public:
  explicit DefaultMethod(DefaultOptions options) : options_(options) {}
  absl::StatusOr<LightFit> Fit(const LightProblem& problem) const override;

 private:
  DefaultOptions options_;
};

}  // namespace shadowfit
