#pragma once

#include "absl/status/statusor.h"
#include "core/fit/light_problem.h"

namespace shadowfit {

/// The light's own frustum, whatever the camera sees: see NormalFrustum.
absl::StatusOr<LightFit> FitNormal(const LightProblem& problem);

/// Normal with a frustum limiting step (TR-07-07, section 3): the view frustum, from the nearest to the
/// farthest visible depth, projected on the light's image plane, cut to the extents of the light's own
/// frustum, and the minimum-area rectangle around what is left, long side to the map's long side.
absl::StatusOr<LightFit> FitFocused(const LightProblem& problem);

/// M. Wimmer, D. Scherzer, W. Purgathofer, "Light space perspective shadow maps", 2004: a perspective along
/// the view direction's image on the light's plane, whose strength is set by one length n. Point and spot
/// lights are warped after their own perspective. The formulae are in the source.
absl::StatusOr<LightFit> FitLispsm(const LightProblem& problem);

/// H. Chong, S. J. Gortler, "A lixel for every pixel", 2004: the matrix under which one plane, that of most
/// visible receivers, is sampled as the camera samples it. The derivation is in the source.
absl::StatusOr<LightFit> FitPlaneOptimal(const LightProblem& problem);

/// A sphere around the visible slice of the view frustum, seen from the light in a fixed orientation and
/// moved by whole texels: turning or moving the camera makes no shadow edge crawl, at the price of texels.
absl::StatusOr<LightFit> FitSphereStable(const LightProblem& problem);

}  // namespace shadowfit
