#pragma once

#include "core/fit/light_problem.h"
#include "core/fit/options.h"

namespace shadowfit {

/// Chong, Gortler: Scene Optimized Shadow Mapping, TR-07-07, Algorithm 1 as published: gradient descent on
/// the axis h3 over fixed angles with the minimum-area affine fit at each, and the 80 % median rule against
/// the previous frame.
///
/// Where the paper is silent: the search starts from the previous frame's axis while that still sees all
/// samples, else from the axis of the smallest cone around them; a directional light's plane coordinates are
/// centred and scaled to a unit disc, so that the angles mean something.
class PaperMethod : public LightMatrixMethod {
 public:
  explicit PaperMethod(PaperOptions options) : options_(std::move(options)) {}
  absl::StatusOr<LightFit> Fit(const LightProblem& problem) const override;

 private:
  PaperOptions options_;
};

}  // namespace shadowfit
