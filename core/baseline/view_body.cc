#include "core/baseline/view_body.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

namespace shadowfit {
namespace {

/// The half space of a ray-space half space h . r >= 0: h G.
glm::dvec4 WorldPlane(const RaySpace& ray_space, const glm::dvec3& h) {
  return {glm::transpose(ray_space.linear()) * h, glm::dot(h, ray_space.offset())};
}

/// The face that closes a cut: the points where edges met the cutting plane, in order around their centre.
std::vector<glm::dvec3> ClosingFace(std::vector<glm::dvec3> points, const glm::dvec3& normal) {
  glm::dvec3 center(0.0);
  for (const glm::dvec3& p : points) center += p / static_cast<double>(points.size());
  const glm::dvec3 n = glm::normalize(normal);
  const glm::dvec3 a = glm::abs(n);
  const glm::dvec3 helper = a.x <= a.y && a.x <= a.z ? glm::dvec3(1, 0, 0)
                            : a.y <= a.z             ? glm::dvec3(0, 1, 0)
                                                     : glm::dvec3(0, 0, 1);
  const glm::dvec3 x = glm::cross(helper, n);
  const glm::dvec3 y = glm::cross(n, x);
  const auto angle = [&](const glm::dvec3& p) {
    return std::atan2(glm::dot(p - center, y), glm::dot(p - center, x));
  };
  std::sort(points.begin(), points.end(),
            [&](const glm::dvec3& p, const glm::dvec3& q) { return angle(p) < angle(q); });
  return points;
}

}  // namespace

ViewBody::ViewBody(const Camera& camera, double ndc_depth_a, double ndc_depth_b) {
  std::array<glm::dvec3, 8> corners;
  for (int i = 0; i < 8; ++i) {
    const glm::dvec4 p = camera.WsFromNdc(
        {(i & 1) != 0 ? 1.0 : -1.0, (i & 2) != 0 ? 1.0 : -1.0, (i & 4) != 0 ? ndc_depth_b : ndc_depth_a});
    const glm::dvec3 corner = glm::dvec3(p) / p.w;
    if (!std::isfinite(corner.x + corner.y + corner.z)) return;
    corners[static_cast<size_t>(i)] = corner;
  }
  for (const std::array<size_t, 4>& face : std::array<std::array<size_t, 4>, 6>{
           {{0, 1, 3, 2}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 3, 7, 6}, {0, 2, 6, 4}, {1, 3, 7, 5}}}) {
    faces_.push_back({corners[face[0]], corners[face[1]], corners[face[2]], corners[face[3]]});
  }
}

void ViewBody::Clip(const glm::dvec4& plane) {
  const auto side = [&plane](const glm::dvec3& p) { return glm::dot(glm::dvec3(plane), p) + plane.w; };
  std::vector<glm::dvec3> cut;
  std::vector<std::vector<glm::dvec3>> kept;
  for (const std::vector<glm::dvec3>& face : faces_) {
    // Sutherland, Hodgman: every edge in turn.
    std::vector<glm::dvec3> clipped;
    for (size_t i = 0; i < face.size(); ++i) {
      const glm::dvec3& p = face[i];
      const glm::dvec3& q = face[i + 1 < face.size() ? i + 1 : 0];
      const double at_p = side(p);
      const double at_q = side(q);
      if (at_p >= 0.0) clipped.push_back(p);
      if ((at_p >= 0.0) != (at_q >= 0.0)) {
        const glm::dvec3 crossing = p + (at_p / (at_p - at_q)) * (q - p);
        clipped.push_back(crossing);
        cut.push_back(crossing);
      }
    }
    if (!clipped.empty()) kept.push_back(std::move(clipped));
  }
  if (!cut.empty()) kept.push_back(ClosingFace(std::move(cut), glm::dvec3(plane)));
  faces_ = std::move(kept);
}

void ViewBody::ClipToBounds(const Bounds& bounds) {
  for (int axis = 0; axis < 3; ++axis) {
    glm::dvec4 plane(0.0);
    plane[axis] = 1.0;
    plane.w = -bounds.min[axis];
    Clip(plane);
    plane[axis] = -1.0;
    plane.w = bounds.max[axis];
    Clip(plane);
  }
}

void ViewBody::ClipToFront(const RaySpace& ray_space, const PlaneMap& plane) {
  if (ray_space.is_directional()) return;
  glm::dvec4 front = WorldPlane(ray_space, plane.w);
  double farthest = 0.0;
  for (const std::vector<glm::dvec3>& face : faces_) {
    for (const glm::dvec3& p : face) {
      farthest = std::max(farthest, glm::dot(glm::dvec3(front), p) + front.w);
    }
  }
  front.w -= 1e-6 * farthest;
  Clip(front);
  if (!(farthest > 0.0)) faces_.clear();
}

void ViewBody::ClipToFrustum(const RaySpace& ray_space, const LightFrustum& frustum) {
  ClipToFront(ray_space, frustum.plane);
  // The four sides: +-(v - center) <= half, times w.
  const glm::dvec2 center = frustum.extents.center;
  const glm::dvec2 half = 0.5 * glm::dvec2(frustum.extents.width, frustum.extents.height);
  const glm::dvec3 axes[2] = {frustum.plane.x, frustum.plane.y};
  for (int i = 0; i < 2; ++i) {
    Clip(WorldPlane(ray_space, axes[i] + (half[i] - center[i]) * frustum.plane.w));
    Clip(WorldPlane(ray_space, -axes[i] + (half[i] + center[i]) * frustum.plane.w));
  }
}

std::vector<glm::dvec3> ViewBody::Vertices() const {
  std::vector<glm::dvec3> vertices;
  for (const std::vector<glm::dvec3>& face : faces_) {
    vertices.insert(vertices.end(), face.begin(), face.end());
  }
  return vertices;
}

}  // namespace shadowfit
