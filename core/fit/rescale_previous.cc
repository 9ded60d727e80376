#include "core/fit/rescale_previous.h"

#include <algorithm>
#include <cmath>

#include "core/budget/texel_budget.h"

namespace shadowfit {
namespace {

/// Of texel coordinates: u becomes scale * u + shift.
struct AxisChange {
  double scale = 1.0;
  double shift = 0.0;
};

/// `low` to `high` must come to lie within 0 to `texels`.
AxisChange ChangeOf(double low, double high, int texels, double border) {
  if (low >= 0.0 && high <= texels) return {};
  const double middle = 0.5 * (low + high);
  const double least = std::ceil(-low);
  const double most = std::floor(texels - high);
  if (least <= most) return {1.0, std::clamp(std::round(0.5 * texels - middle), least, most)};
  AxisChange change;
  const double wanted = (1.0 - 2.0 * border) * texels / (high - low);
  change.scale = std::pow(kScaleStep, std::floor(std::log(wanted) / std::log(kScaleStep)));
  const auto center_of = [](double u) { return std::floor(u) + 0.5; };
  change.shift = center_of(0.5 * texels) - change.scale * center_of(middle);
  // A map of few texels has no room for that.
  if (change.scale * low + change.shift < border * texels ||
      change.scale * high + change.shift > (1.0 - border) * texels) {
    change.shift = 0.5 * texels - change.scale * middle;
  }
  return change;
}

}  // namespace

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
  const AxisChange x = ChangeOf(low.x, high.x, previous.size.width, border);
  const AxisChange y = ChangeOf(low.y, high.y, previous.size.height, border);
  const glm::dmat3 adjust(glm::dvec3(x.scale, 0, 0), glm::dvec3(0, y.scale, 0),
                          glm::dvec3(x.shift, y.shift, 1));
  const ShadowProjection held{adjust * previous.texel_from_ray, previous.size};
  return held.size == size ? held : Resized(held, size);
}

}  // namespace shadowfit
