#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/glm.hpp>
#include <limits>
#include <optional>
#include <vector>

#include "core/math/ray_space.h"
#include "core/scene/scene.h"

namespace shadowfit::oracle {

/// Shadow rays by brute force in extended precision, with the numerical bounds that shadow_masks.h states:
/// what is closer to an edge or a surface than those is not decided.
using Real = long double;
struct Vec {
  Real x, y, z;
};
inline Vec operator-(const Vec& a, const Vec& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Real Dot(const Vec& a, const Vec& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec Cross(const Vec& a, const Vec& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
inline Real Length(const Vec& a) { return std::sqrt(Dot(a, a)); }
inline Vec ToVec(const glm::dvec3& v) { return {v.x, v.y, v.z}; }

inline constexpr Real kRoundoff = 0x1p-24L;

struct Triangle {
  glm::vec3 corners[3];
  int material = 0;
};

inline std::vector<Triangle> Flatten(const Scene& scene) {
  std::vector<Triangle> triangles;
  for (const Instance& instance : scene.instances) {
    const Mesh& mesh = scene.meshes[static_cast<size_t>(instance.mesh)];
    for (const glm::uvec3& t : mesh.triangles) {
      Triangle& out = triangles.emplace_back();
      out.material = mesh.material;
      for (int i = 0; i < 3; ++i) {
        out.corners[i] = instance.world_from_object * glm::vec4(mesh.positions[t[i]], 1.0f);
      }
    }
  }
  return triangles;
}

enum class Answer {
  kBlocked,
  kClear,
  kOnSurface,  ///< Clear: the point lies on this triangle, within the bound.
  kUnsure,
};

/// Does the triangle block the light's ray to the point? Planes nearer to the point than least_bound
/// certainly do not, those further than most_bound certainly may. `reach` is how far points are from their
/// centre, `displacement` how far the point may be from where the ray starts.
inline Answer Blocks(const Triangle& triangle, const Light& light, const glm::dvec3& ws_point,
                     Real least_bound, Real most_bound, Real reach, Real displacement = 0) {
  std::array<Vec, 3> v;
  Vec r{};
  Real turn, plane_d;
  Vec edge[3], plane;
  const auto* directional = std::get_if<DirectionalLight>(&light);
  if (directional != nullptr) {
    // Parallel rays: the cone becomes a prism along the light.
    const Vec d = ToVec(glm::normalize(directional->ws_direction));
    for (size_t i = 0; i < 3; ++i) v[i] = ToVec(glm::dvec3(triangle.corners[i])) - ToVec(ws_point);
    plane = Cross(v[1] - v[0], v[2] - v[0]);
    turn = Dot(plane, d) < 0 ? -1 : 1;
    if (std::abs(Dot(plane, d)) <= 1e-15L * Length(v[1] - v[0]) * Length(v[2] - v[0])) return Answer::kClear;
    Real worst = std::numeric_limits<Real>::infinity();
    for (size_t i = 0; i < 3; ++i) {
      const Vec along = v[(i + 1) % 3] - v[i];
      const Vec side = Cross(d, along);
      const Real length = Length(side);
      if (length == 0) return Answer::kUnsure;
      // Signed distance of the point's ray from the edge's line.
      worst = std::min(worst, -turn * Dot(side, v[i]) / length);
    }
    const Real tolerance = 8 * kRoundoff * reach + displacement;
    if (worst < -tolerance) return Answer::kClear;
    // Distance of the point behind the plane.
    const Real height = turn * -Dot(plane, v[0]) / Length(plane);
    if (height < -most_bound) return Answer::kClear;
    if (worst > tolerance && height > most_bound) return Answer::kBlocked;
    return worst > tolerance && std::abs(height) <= least_bound ? Answer::kOnSurface : Answer::kUnsure;
  }
  const Vec origin = std::holds_alternative<PointLight>(light)
                         ? ToVec(std::get<PointLight>(light).ws_position)
                         : ToVec(std::get<SpotLight>(light).ws_position);
  for (size_t i = 0; i < 3; ++i) v[i] = ToVec(glm::dvec3(triangle.corners[i])) - origin;
  r = ToVec(ws_point) - origin;
  plane = Cross(v[1] - v[0], v[2] - v[0]);
  plane_d = Dot(plane, v[0]);
  if (std::abs(plane_d) <= 1e-15L * Length(v[1] - v[0]) * Length(v[2] - v[0]) * Length(v[0])) {
    return Answer::kClear;
  }
  turn = plane_d < 0 ? -1 : 1;
  Real worst = std::numeric_limits<Real>::infinity();
  for (size_t i = 0; i < 3; ++i) {
    edge[i] = Cross(v[i], v[(i + 1) % 3]);
    const Real length = Length(edge[i]);
    if (length == 0) return Answer::kUnsure;
    worst = std::min(worst, turn * Dot(edge[i], r) / length / Length(r));
  }
  const Real tolerance = 8 * kRoundoff + displacement / Length(r);
  if (worst < -tolerance) return Answer::kClear;
  const Real height = turn * (Dot(plane, r) - plane_d) / Length(plane);
  if (height < -most_bound) return Answer::kClear;
  if (worst > tolerance && height > most_bound) return Answer::kBlocked;
  return worst > tolerance && std::abs(height) <= least_bound ? Answer::kOnSurface : Answer::kUnsure;
}

}  // namespace shadowfit::oracle
