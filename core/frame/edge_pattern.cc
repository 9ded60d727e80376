#include "core/frame/edge_pattern.h"

#include <bit>
#include <cmath>
#include <numbers>

namespace shadowfit {
namespace {

/// A window has the structure of an edge where the eigenvalues of its structure tensor differ by at least
/// this share of their sum.
constexpr double kLeastCoherence = 0.5;

/// A texture's least share of neighbours that differ; a corner's is at most a quarter.
constexpr double kLeastDifferences = 0.3;

EdgeDirection DirectionOf(unsigned pattern, const glm::dvec2& scale) {
  const auto value = [pattern](int column, int row) {
    return static_cast<double>((pattern >> (3 * row + column)) & 1u);
  };
  double xx = 0.0;
  double xy = 0.0;
  double yy = 0.0;
  for (int row = 0; row < 2; ++row) {
    for (int column = 0; column < 2; ++column) {
      const double v00 = value(column, row);
      const double v10 = value(column + 1, row);
      const double v01 = value(column, row + 1);
      const double v11 = value(column + 1, row + 1);
      const double gx = 0.5 * (v10 + v11 - v00 - v01);
      const double gy = 0.5 * (v01 + v11 - v00 - v10);
      xx += gx * gx;
      xy += gx * gy;
      yy += gy * gy;
    }
  }
  const double angle = 0.5 * std::atan2(2.0 * xy, xx - yy);
  const glm::dvec2 normal(std::cos(angle), std::sin(angle));
  const double stretch = glm::length(glm::dvec2(-normal.y, normal.x) * scale);
  return {glm::normalize(normal / scale), stretch * 0.5 / (std::abs(normal.x) + std::abs(normal.y))};
}

}  // namespace

EdgeDirections::EdgeDirections(const glm::dvec2& scale) {
  for (unsigned pattern = 0; pattern < directions_.size(); ++pattern) {
    directions_[pattern] = DirectionOf(pattern, scale);
  }
}

bool IsTexture(uint32_t window) {
  // The lower left bits of all 2x2 quads, four a row, and those beside, above and across from them.
  constexpr uint32_t kQuads = 0xFu | 0xFu << 5 | 0xFu << 10 | 0xFu << 15;
  const uint32_t v00 = window & kQuads;
  const uint32_t v10 = window >> 1 & kQuads;
  const uint32_t v01 = window >> 5 & kQuads;
  const uint32_t v11 = window >> 6 & kQuads;
  constexpr double kNeighbours = 32.0;
  const int differences = std::popcount(v00 ^ v10) + std::popcount(v00 ^ v01);
  if (differences < kLeastDifferences * kNeighbours) return false;
  // With d = v11 - v00 and e = v10 - v01 a quad's gradient is (d + e, d - e), so that the sums of its
  // products are xx - yy = 4 sum de, xy = sum d^2 - sum e^2 and xx + yy = 2 (sum d^2 + sum e^2).
  const int dd = std::popcount(v11 ^ v00);
  const int ee = std::popcount(v10 ^ v01);
  const uint32_t d_up = v11 & ~v00;
  const uint32_t d_down = v00 & ~v11;
  const uint32_t e_up = v10 & ~v01;
  const uint32_t e_down = v01 & ~v10;
  const int de = std::popcount(d_up & e_up) + std::popcount(d_down & e_down) - std::popcount(d_up & e_down) -
                 std::popcount(d_down & e_up);
  const double sum = 2.0 * (dd + ee);
  // The eigenvalues differ by the root of (xx - yy)^2 + (2 xy)^2.
  return std::hypot(4.0 * de, 2.0 * (dd - ee)) < kLeastCoherence * sum;
}

TextureEdge TextureEdgeOf(size_t index, double extents, bool directional, const glm::dvec3& ray,
                          const glm::dvec3& ray_dx1, const glm::dvec3& ray_dx2) {
  // The light's picture: of a directional light the first two ray coordinates, else the plane across the ray.
  glm::dvec3 b1(1.0, 0.0, 0.0);
  glm::dvec3 b2(0.0, 1.0, 0.0);
  if (!directional) {
    const glm::dvec3 helper = std::abs(ray.x) < std::abs(ray.z) ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 0, 1);
    b1 = glm::normalize(glm::cross(helper, ray));
    b2 = glm::normalize(glm::cross(ray, b1));
  }
  const glm::dvec2 a1(glm::dot(b1, ray_dx1), glm::dot(b2, ray_dx1));
  const glm::dvec2 a2(glm::dot(b1, ray_dx2), glm::dot(b2, ray_dx2));
  // Multiples of the golden angle.
  const double angle = static_cast<double>(index) * (std::numbers::pi * std::numbers::phi);
  const glm::dvec2 m(std::cos(angle), std::sin(angle));
  const glm::dvec2 across(glm::dot(m, a1), glm::dot(m, a2));
  const double size = glm::length(across);
  const double c = 0.5 * std::numbers::pi * kTextureEdges * extents / (glm::length(a1) + glm::length(a2));
  if (!(size > 0.0) || !std::isfinite(c * size)) return {{1.0, 0.0}, extents};
  return {across / size, c * size};
}

}  // namespace shadowfit
