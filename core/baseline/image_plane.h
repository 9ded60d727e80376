#pragma once

#include <glm/glm.hpp>
#include <span>

#include "core/math/enclosing_rectangle.h"
#include "core/math/ray_space.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

/// A homography from ray coordinates to plane coordinates v that is not yet fitted to a map:
///
///   v = (x.r, y.r) / (w.r),   valid where w.r > 0.
///
/// Fitting it adds an affine map from v to texels and leaves the valid side as it is.
struct PlaneMap {
  glm::dvec3 x;
  glm::dvec3 y;
  glm::dvec3 w;

  glm::dvec2 Project(const glm::dvec3& r) const {
    return glm::dvec2(glm::dot(x, r), glm::dot(y, r)) / glm::dot(w, r);
  }
  /// A ray through plane coordinates, for orthonormal x, y, w; its own w.r is 1.
  glm::dvec3 RayThrough(const glm::dvec2& v) const { return x * v.x + y * v.y + w; }
};

/// World up; what a map's v axis follows where the light lets it.
inline constexpr glm::dvec3 kWsUp{0.0, 0.0, 1.0};

/// The image plane of unit distance across an axis (unit, in ray coordinates): orthonormal and right-handed,
/// y the image of world up, or of world Y where the light looks along world up. Directional lights have the
/// one axis (0,0,1).
PlaneMap UprightPlane(const RaySpace& ray_space, const glm::dvec3& axis);

/// Maps a rectangle of the plane onto a map, width to width. The outermost half texel of the map stays
/// outside the rectangle, so that a lookup on the rectangle's rim rounds to a texel of the map. A rectangle
/// without area is given one. The result has a positive determinant whatever the plane's handedness.
ShadowProjection MapRectangle(const PlaneMap& plane, const EnclosingRectangle& rectangle, MapSize size);

/// The same with the rectangle's longer side along the map's longer side (TR-07-07, section 2.3).
ShadowProjection MapLongSideToLongSide(const PlaneMap& plane, EnclosingRectangle rectangle, MapSize size);

/// True where every ray in front of the plane lies inside the rectangle, to within 1e-9 of its sides (its
/// border in the map is wider). Needs no division: methods find their rectangle from the few vertices that it
/// must hold and check the many rays that should be inside.
bool InFrontMeansInside(const PlaneMap& plane, const EnclosingRectangle& rectangle,
                        std::span<const glm::dvec3> rays);

}  // namespace shadowfit
