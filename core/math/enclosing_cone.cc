#include "core/math/enclosing_cone.h"

#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

namespace shadowfit {
namespace {

// Containment is judged with a slack of some ulps, so that a cone's own support stays inside it.
constexpr double kSlack = 1e-13;

EnclosingCone Through(const glm::dvec3& a, const glm::dvec3& b) {
  const glm::dvec3 sum = a + b;
  const double length = glm::length(sum);
  if (length < 1e-12) return {a, 0.0};  // Opposite rays: no cone below a half space.
  const glm::dvec3 axis = sum / length;
  return {axis, glm::dot(axis, a)};
}

EnclosingCone Through(const glm::dvec3& a, const glm::dvec3& b, const glm::dvec3& c) {
  // The circle through three unit vectors lies in the plane through their tips; its normal is the cone's
  // axis.
  glm::dvec3 normal = glm::cross(b - a, c - a);
  const double length = glm::length(normal);
  if (length < 1e-15) {
    // Two of the three coincide: the widest pair rules.
    const EnclosingCone pairs[3] = {Through(a, b), Through(b, c), Through(a, c)};
    const EnclosingCone* widest = &pairs[0];
    for (const EnclosingCone& pair : pairs) {
      if (pair.cos_half_angle < widest->cos_half_angle) widest = &pair;
    }
    return *widest;
  }
  normal /= length;
  const double cosine = glm::dot(normal, a);
  return cosine >= 0.0 ? EnclosingCone{normal, cosine} : EnclosingCone{-normal, -cosine};
}

bool Contains(const EnclosingCone& cone, const glm::dvec3& direction) {
  return glm::dot(cone.axis, direction) >= cone.cos_half_angle - kSlack;
}

bool ContainsFirst(const EnclosingCone& cone, const std::vector<glm::dvec3>& directions, size_t count) {
  constexpr double kTolerance = 1e-9;
  for (size_t i = 0; i < count; ++i) {
    if (glm::dot(cone.axis, directions[i]) < cone.cos_half_angle - kTolerance) return false;
  }
  return true;
}

/// A small multiplicative generator: the shuffle only has to be independent of the order of the input.
uint64_t NextRandom(uint64_t& state) {
  state = state * 6364136223846793005ULL + 1442695040888963407ULL;
  return state >> 33;
}

}  // namespace

std::optional<EnclosingCone> SmallestEnclosingCone(std::span<const glm::dvec3> rays) {
  std::vector<glm::dvec3> directions;
  directions.reserve(rays.size());
  for (const glm::dvec3& ray : rays) {
    const double length = glm::length(ray);
    if (length > 0.0 && std::isfinite(length)) directions.push_back(ray / length);
  }
  if (directions.empty()) return std::nullopt;
  uint64_t state = 0x9e3779b97f4a7c15ULL;
  for (size_t i = directions.size() - 1; i > 0; --i) {
    std::swap(directions[i], directions[NextRandom(state) % (i + 1)]);
  }
  // Welzl's incremental construction, as for the smallest circle in the plane: whenever a ray falls outside,
  // it is on the rim of the smallest cone of all rays so far.
  EnclosingCone cone{directions[0], 1.0};
  for (size_t i = 1; i < directions.size(); ++i) {
    if (Contains(cone, directions[i])) continue;
    cone = {directions[i], 1.0};
    for (size_t j = 0; j < i; ++j) {
      if (Contains(cone, directions[j])) continue;
      cone = Through(directions[i], directions[j]);
      for (size_t k = 0; k < j; ++k) {
        if (!Contains(cone, directions[k])) cone = Through(directions[i], directions[j], directions[k]);
      }
      // Rays that span a half space or more break the construction's premise: what it makes then does not
      // contain them. Found here, before the loops run into cubic time.
      if (!ContainsFirst(cone, directions, j)) return std::nullopt;
    }
  }
  double smallest = 1.0;
  for (const glm::dvec3& direction : directions)
    smallest = std::min(smallest, glm::dot(cone.axis, direction));
  if (!(smallest > 1e-9)) return std::nullopt;
  cone.cos_half_angle = smallest;
  return cone;
}

}  // namespace shadowfit
