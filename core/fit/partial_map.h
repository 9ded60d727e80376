#pragma once

#include "core/fit/light_problem.h"
#include "core/fit/options.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

struct PartialMap {
  ShadowProjection projection;
  double predicted = 0.0;  ///< Wrong pixels.
  int evaluations = 0;
};

/// One map for a light of whose shadow no single map holds all. Which part is worth most shows when it is
/// counted: `first` and the baselines' maps each hold some part; the best of them, as the frame predicts
/// (PredictWrongPixels()), is fitted to what it holds, and its sides are moved where that pays
/// (TrimShadow()). Never predicted worse than any of them, nor, with a free aspect, than with a fixed one.
/// `problem.sampler` must be given.
PartialMap FitPartialMap(const LightProblem& problem, const DefaultOptions& options,
                         const ShadowProjection& first);

}  // namespace shadowfit
