#pragma once

#include <optional>
#include <span>

#include "core/fit/light_problem.h"
#include "core/fit/options.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

/// Of some methods' single maps the one that the frame predicts to get fewest pixels wrong
/// (PredictWrongPixels()), where those are fewer than `wrong_pixels`.
std::optional<ShadowProjection> BestBaseline(const LightProblem& problem, std::span<const Method> methods,
                                             double wrong_pixels);

}  // namespace shadowfit
