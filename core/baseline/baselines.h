#pragma once

#include <memory>

#include "core/fit/light_problem.h"
#include "core/fit/options.h"

namespace shadowfit {

/// The published ways of making a light matrix without an optimizer: kNormal, kFocused, kLispsm,
/// kPlaneOptimal or kSphereStable; null for the other methods. Thread-safe and without state.
///
/// Common to all: matrices are finite, have w > 0 on every hull ray and a positive determinant of
/// texel_from_ray. Normal, Focused, LiSPSM and SphereStable contain every hull ray; PlaneOptimal, as
/// published, only those whose image on its plane lies inside the screen. Where hull rays span a hemisphere,
/// no single map has these properties: the answer is a stated fallback (FitOutcome::kFallback) that serves
/// the cone holding most of them.
std::unique_ptr<LightMatrixMethod> MakeBaseline(Method method);

}  // namespace shadowfit
