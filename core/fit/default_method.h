#pragma once

#include "core/fit/light_problem.h"
#include "core/fit/options.h"

namespace shadowfit {

/// The best matrix that this library knows: the `edge` metric (expected misclassified pixels) minimised over
/// the axis and the enclosing parallelogram together, in whitened ray coordinates.
class DefaultMethod : public LightMatrixMethod {
 public:
  explicit DefaultMethod(DefaultOptions options) : options_(options) {}
  absl::StatusOr<LightFit> Fit(const LightProblem& problem) const override;

 private:
  DefaultOptions options_;
};

}  // namespace shadowfit
