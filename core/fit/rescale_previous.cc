#include "core/fit/rescale_previous.h"

#include <algorithm>
#include <cmath>

namespace shadowfit {

glm::dmat3 WithUnitAxis(const glm::dmat3& texel_from_ray) {
  const glm::dvec3 axis(texel_from_ray[0][2], texel_from_ray[1][2], texel_from_ray[2][2]);
  return texel_from_ray / glm::length(axis);
}

std::optional<ShadowProjection> RescaleToHold(const ShadowProjection& previous, MapSize size,
                                              std::span<const glm::dvec3> rays, double border) {
  if (rays.empty()) return std::nullopt;
  const glm::dvec3 axis = previous.Axis();
  glm::dvec2 low(1e300);
  glm::dvec2 high(-1e300);
  for (const glm::dvec3& r : rays) {
    if (!(glm::dot(axis, r) > 1e-4 * glm::length(r))) return std::nullopt;
    const glm::dvec2 u(previous.TexelFromRay(r));
    low = glm::min(low, u);
    high = glm::max(high, u);
  }
  if (!std::isfinite(low.x + low.y + high.x + high.y)) return std::nullopt;
  const bool inside = low.x >= 0.0 && low.y >= 0.0 && high.x <= size.width && high.y <= size.height;
  if (inside && previous.size == size) return previous;
  const glm::dvec2 texels(size.width, size.height);
  // A thousandth of the old map keeps rays on one line from making a singular map.
  const glm::dvec2 extent =
      glm::max(high - low, glm::dvec2(previous.size.width, previous.size.height) * 1e-3);
  const glm::dvec2 center = 0.5 * (low + high);
  const glm::dvec2 scale = (1.0 - 2.0 * border) * texels / extent;
  const glm::dvec2 shift = 0.5 * texels - scale * center;
  const glm::dmat3 adjust(glm::dvec3(scale.x, 0, 0), glm::dvec3(0, scale.y, 0), glm::dvec3(shift, 1.0));
  return ShadowProjection{adjust * previous.texel_from_ray, size};
}

}  // namespace shadowfit
