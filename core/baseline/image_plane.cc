#include "core/baseline/image_plane.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace shadowfit {
namespace {

// Shortest side of a rectangle, relative to its longest and to its distance from the plane's origin, and
// absolutely. Thinner ones (a single ray, a line of rays) would only make texels of the size of rounding
// errors.
constexpr double kThinnest = 1e-6;
constexpr double kThinnestAbsolute = 1e-9;

/// Texels that stay free on each side; tiny maps cannot spare half a texel.
double BorderTexels(int size) { return std::min(0.5, size / 16.0); }

}  // namespace

PlaneMap UprightPlane(const RaySpace& ray_space, const glm::dvec3& axis) {
  for (const glm::dvec3& ws_up : {kWsUp, glm::dvec3(0.0, 1.0, 0.0), glm::dvec3(1.0, 0.0, 0.0)}) {
    glm::dvec3 up = ray_space.RayFromVector(ws_up);
    up -= glm::dot(up, axis) * axis;
    const double length = glm::length(up);
    // Within three degrees of the axis the image of up would spin with the light's slightest move.
    if (length < 0.05) continue;
    up /= length;
    return {glm::cross(up, axis), up, axis};
  }
  // Not reached: of three orthogonal directions at most one lies near the axis.
  return {glm::dvec3(1.0, 0.0, 0.0), glm::dvec3(0.0, 1.0, 0.0), axis};
}

ShadowProjection MapRectangle(const PlaneMap& plane, const EnclosingRectangle& rectangle, MapSize size) {
  const double longest = std::max(rectangle.width, rectangle.height);
  const double reach = longest + std::abs(rectangle.center.x) + std::abs(rectangle.center.y);
  const double shortest = std::max(kThinnest * reach, kThinnestAbsolute);
  const glm::dvec2 extent(std::max(rectangle.width, shortest), std::max(rectangle.height, shortest));
  const glm::dvec2 axes[2] = {rectangle.axis, {-rectangle.axis.y, rectangle.axis.x}};
  const int texels[2] = {size.width, size.height};

  glm::dvec3 rows[3];
  for (int i = 0; i < 2; ++i) {
    const double texels_per_unit = (texels[i] - 2.0 * BorderTexels(texels[i])) / extent[i];
    // u = texels_per_unit (axis.v - axis.center) + size / 2, times w.
    rows[i] = texels_per_unit * (axes[i].x * plane.x + axes[i].y * plane.y) +
              (0.5 * texels[i] - texels_per_unit * glm::dot(axes[i], rectangle.center)) * plane.w;
  }
  rows[2] = plane.w;
  if (glm::dot(glm::cross(plane.x, plane.y), plane.w) < 0.0) {
    rows[0] = double(size.width) * plane.w - rows[0];  // u -> width - u.
  }
  const double axis_length = glm::length(plane.w);
  return {glm::transpose(glm::dmat3(rows[0], rows[1], rows[2]) / axis_length), size};
}

ShadowProjection MapLongSideToLongSide(const PlaneMap& plane, EnclosingRectangle rectangle, MapSize size) {
  if ((rectangle.width >= rectangle.height) != (size.width >= size.height)) {
    rectangle.axis = {-rectangle.axis.y, rectangle.axis.x};
    std::swap(rectangle.width, rectangle.height);
  }
  return MapRectangle(plane, rectangle, size);
}

bool InFrontMeansInside(const PlaneMap& plane, const EnclosingRectangle& rectangle,
                        std::span<const glm::dvec3> rays) {
  // |axis . (v - center)| <= half, times w.
  const glm::dvec2 x_axis = rectangle.axis;
  const glm::dvec2 y_axis(-x_axis.y, x_axis.x);
  const glm::dvec3 x = x_axis.x * plane.x + x_axis.y * plane.y - glm::dot(x_axis, rectangle.center) * plane.w;
  const glm::dvec3 y = y_axis.x * plane.x + y_axis.y * plane.y - glm::dot(y_axis, rectangle.center) * plane.w;
  const double half_width = 0.5 * rectangle.width * (1.0 + 1e-9);
  const double half_height = 0.5 * rectangle.height * (1.0 + 1e-9);
  for (const glm::dvec3& ray : rays) {
    const double w = glm::dot(plane.w, ray);
    if (!(w > 0.0)) continue;
    if (!(std::abs(glm::dot(x, ray)) <= half_width * w && std::abs(glm::dot(y, ray)) <= half_height * w))
      return false;
  }
  return true;
}

}  // namespace shadowfit
