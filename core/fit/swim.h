#pragma once

#include <optional>

#include "core/frame/light_samples.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

/// The swim of a shadow map from one frame to the next: how far its texel centres move on the receivers, in
/// the mean over the shadow's edge, in pixels of the final screen. It is what is seen of a change of the
/// matrix: where texel centres stay on their receivers, every stair of an edge stays as well.
///
/// Let the light stand still, with u0 = P(H0 r) the texel coordinates before and u1 = P(H1 r) those after of
/// a ray r (P divides by the third component). A sample's texel had its centre at c0 = floor(u0) + 1/2, which
/// is the ray H0^-1 (c0, 1), and that ray's place in the new map is
///
///   p = P(H1 H0^-1 (c0, 1)),
///
/// exactly and for whatever receiver it falls on. Texel centres have no names from one frame to the next: the
/// eye takes the nearest new one for the old. A step of one texel moves a point of the screen by a column of
/// J^-1, J = du1/dx the sample's Jacobian (TexelJacobian), so the sample's motion is the distance from p to
/// the lattice of centres,
///
///   min over integers k of |J^-1 (p - 1/2 - k)|     pixels,
///
/// which is 0 for a map shifted by whole texels, and half a texel's larger side at most for texels that
/// appear square. The mean weighs samples by the length of edge that they stand for.
///
/// None where no sample lies in both maps.
std::optional<double> MeanSwim(const LightSamples& samples, const ShadowProjection& previous,
                               const ShadowProjection& current);

/// The least length of G (e - k) over vectors k of integers: how far G e is from the lattice of G's columns.
double DistanceToLattice(const glm::dmat2& basis, const glm::dvec2& e);

}  // namespace shadowfit
