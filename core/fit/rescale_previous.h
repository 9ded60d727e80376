#pragma once

#include <glm/glm.hpp>
#include <optional>
#include <span>

#include "core/math/shadow_projection.h"

namespace shadowfit {

/// The same homography scaled so that its axis row has unit length.
glm::dmat3 WithUnitAxis(const glm::dmat3& texel_from_ray);

/// The previous frame's projection, made to serve this frame (TR-07-07, section 2.3, step 5): its axis,
/// rotation and skew stay; where some ray falls outside the map's inner part, or the map's size changed,
/// scale and shift are chosen anew so that all rays fall into the map with `border` (a fraction) free on each
/// side. Unchanged where all rays lie in the map. None where the axis does not see all rays, or there is
/// none.
std::optional<ShadowProjection> RescaleToHold(const ShadowProjection& previous, MapSize size,
                                              std::span<const glm::dvec3> rays, double border);

}  // namespace shadowfit
