#pragma once

#include <glm/glm.hpp>
#include <span>

#include "core/math/shadow_projection.h"

namespace shadowfit {

/// An affine map of the image plane onto a shadow map: texel = linear * v + offset.
struct TexelFromPlane {
  glm::dmat2 linear{1.0};
  glm::dvec2 offset{0.0};
};

/// TR-07-07's affine fit (section 2.3): the minimum-area rectangle around the convex polygon (vertices
/// counter-clockwise), with the heuristic shear of its figure 3 where `skew` is set, mapped long side to long
/// side. `border` is the fraction of the map's width and height that stays free on each side. Never mirrors.
/// Polygons without area are widened a little, so that the map is always regular; the polygon must not be
/// empty.
TexelFromPlane FitMinimumArea(std::span<const glm::dvec2> polygon, MapSize size, bool skew, double border);

/// The homography whose image-plane part is `affine`, over the plane (b1, b2, axis).
glm::dmat3 TexelFromRay(const TexelFromPlane& affine, const glm::dvec3& b1, const glm::dvec3& b2,
                        const glm::dvec3& axis);

}  // namespace shadowfit
