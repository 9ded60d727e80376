#pragma once

#include "core/baseline/image_plane.h"
#include "core/fit/light_problem.h"

namespace shadowfit {

/// The frustum that a light has by itself, before any camera is thought of: what "Normal" renders with and
/// what the other baselines begin from.
struct LightFrustum {
  PlaneMap plane;  ///< Orthonormal; its w is the light's axis.
  EnclosingRectangle extents;
  FitOutcome outcome = FitOutcome::kFitted;
  const char* note = "";
};

/// Spot: the square frustum around the cone. Directional: the square around the scene's bounds, across the
/// light's direction. Point: the square frustum about the line to the centre of the scene's bounds that
/// contains them. Every one contains all hull rays.
///
/// A point light inside the bounds, or so near that they span almost a hemisphere, has no such frustum, nor
/// has a spot of almost 180 degrees. Stated fallback: the square frustum about the smallest cone that
/// encloses the hull rays (the bounds, where there are none); where these span a hemisphere themselves, about
/// a cone that holds most of them.
LightFrustum NormalFrustum(const LightProblem& problem);

}  // namespace shadowfit
