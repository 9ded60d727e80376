#pragma once

#include <glm/glm.hpp>
#include <optional>
#include <span>

#include "core/math/shadow_projection.h"

namespace shadowfit {

/// The same homography scaled so that its axis row has unit length.
glm::dmat3 WithUnitAxis(const glm::dmat3& texel_from_ray);

/// The previous frame's projection, made to serve this frame (TR-07-07, section 2.3, step 5): its axis,
/// rotation and skew stay. Texel centres move as little as they can, for each of the map's two axes in turn:
///
///   1. Where all rays lie in the map along this axis, nothing changes.
///   2. Where they fit into its length, the map moves by whole texels: every centre stays on the surfaces
///   that
///      it is on.
///   3. Else texels grow by the least power of kScaleStep with which all rays fit into the map with `border`
///   (a
///      fraction of its length) free on each side, and the centre nearest to the rays' middle stays a centre.
///      Steps are coarse so that the next ones are far between.
///
/// Then the map has `size`, whatever it had before. None where the axis does not see all rays, or there is
/// none.
std::optional<ShadowProjection> RescaleToHold(const ShadowProjection& previous, MapSize size,
                                              std::span<const glm::dvec3> rays, double border);

inline constexpr double kScaleStep = 1.03;

}  // namespace shadowfit
