#include "core/fit/ray_hull.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>

#include "core/fit/outer_samples.h"
#include "core/math/convex_hull.h"
#include "core/math/enclosing_cone.h"

namespace shadowfit {
namespace {

/// Centres a directional light's plane coordinates on their box and scales its half diagonal to one.
glm::dmat3 NormalizePlane(std::span<const glm::dvec3> rays) {
  glm::dvec2 low(1e300);
  glm::dvec2 high(-1e300);
  for (const glm::dvec3& r : rays) {
    low = glm::min(low, glm::dvec2(r));
    high = glm::max(high, glm::dvec2(r));
  }
  const glm::dvec2 center = 0.5 * (low + high);
  const double radius = 0.5 * glm::length(high - low);
  const double scale = radius > 0.0 ? 1.0 / radius : 1.0;
  return {glm::dvec3(scale, 0, 0), glm::dvec3(0, scale, 0), glm::dvec3(-scale * center, 1.0)};
}

/// The axis, among the coordinate axes and the mean direction, that keeps most rays within the reduced cone.
glm::dvec3 BestReducedAxis(std::span<const glm::dvec3> rays) {
  glm::dvec3 mean(0.0);
  for (const glm::dvec3& r : rays) {
    if (const double length = glm::length(r); length > 0.0) mean += r / length;
  }
  std::vector<glm::dvec3> candidates = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
  if (glm::length(mean) > 1e-9) candidates.push_back(glm::normalize(mean));
  const double threshold = std::cos(kReducedHalfAngle);
  glm::dvec3 best = candidates.back();
  size_t most = 0;
  for (const glm::dvec3& axis : candidates) {
    const auto kept = static_cast<size_t>(std::count_if(rays.begin(), rays.end(), [&](const glm::dvec3& r) {
      return glm::dot(axis, r) > threshold * glm::length(r);
    }));
    if (kept > most) {
      most = kept;
      best = axis;
    }
  }
  return best;
}

/// Of rays in front of a plane.
std::vector<glm::dvec3> HullVertices(const ImagePlane& plane, const std::vector<glm::dvec3>& rays) {
  std::vector<glm::dvec2> projected;
  projected.reserve(rays.size());
  for (const glm::dvec3& r : rays) projected.push_back(plane.Project(r));
  std::vector<glm::dvec3> vertices;
  for (const int index : ConvexHull2(projected)) vertices.push_back(rays[static_cast<size_t>(index)]);
  return vertices;
}

}  // namespace

ImagePlane ImagePlane::About(const glm::dvec3& axis) {
  const glm::dvec3 a = glm::abs(axis);
  const glm::dvec3 helper = a.x <= a.y && a.x <= a.z ? glm::dvec3(1, 0, 0)
                            : a.y <= a.z             ? glm::dvec3(0, 1, 0)
                                                     : glm::dvec3(0, 0, 1);
  const glm::dvec3 b1 = glm::normalize(glm::cross(helper, axis));
  return {b1, glm::cross(axis, b1), axis};
}

std::optional<ImagePlane> ImagePlane::Facing(std::span<const glm::dvec3> rays) {
  constexpr size_t kProbes = 64;
  // Farther from the axis the projection stretches too much to trust its rounding.
  constexpr double kLeastCosine = 0.05;
  glm::dvec3 mean(0.0);
  for (size_t i = 0; i < rays.size(); i += 1 + rays.size() / kProbes) {
    if (const double length = glm::length(rays[i]); length > 0.0) mean += rays[i] / length;
  }
  const double length = glm::length(mean);
  if (!(length > 0.0) || !std::isfinite(length)) return std::nullopt;
  const glm::dvec3 axis = mean / length;
  for (const glm::dvec3& r : rays) {
    if (!(glm::dot(axis, r) > kLeastCosine * glm::length(r))) return std::nullopt;
  }
  return About(axis);
}

RayHull MakeRayHull(const RaySpace& ray_space, std::span<const glm::dvec3> rays) {
  // Extreme cameras unproject to infinity: such rays have no place in any map, and a visible point at the
  // light itself has no ray.
  std::vector<glm::dvec3> normalized;
  normalized.reserve(rays.size());
  for (const glm::dvec3& r : rays) {
    const double squared = glm::dot(r, r);
    if (squared > 0.0 && std::isfinite(squared)) normalized.push_back(r);
  }
  RayHull hull;
  if (ray_space.is_directional()) {
    if (!normalized.empty()) hull.normalized_from_ray = NormalizePlane(normalized);
    for (glm::dvec3& r : normalized) r = hull.normalized_from_ray * r;
    std::erase_if(normalized, [](const glm::dvec3& r) { return !std::isfinite(glm::length(r)); });
  }
  // Only the vertices of their hull matter to the cone; it takes longer than the hull.
  if (const std::optional<ImagePlane> front = ImagePlane::Facing(normalized)) {
    normalized = HullVertices(*front, normalized);
  }
  std::optional<EnclosingCone> cone = SmallestEnclosingCone(normalized);
  if (!cone || cone->cos_half_angle < 1e-4) {
    hull.complete = false;
    hull.reduced_axis = BestReducedAxis(normalized);
    std::erase_if(normalized, [&](const glm::dvec3& r) { return !hull.Keeps(r); });
    // Many are left, all in front of the axis that kept them: their hull's vertices have the same cone.
    normalized = HullVertices(ImagePlane::About(hull.reduced_axis), normalized);
    cone = SmallestEnclosingCone(normalized);
    // Nothing that a map could hold: any regular map serves.
    if (!cone) {
      normalized = {hull.axis};
      cone = EnclosingCone{};
    }
  }
  hull.axis = cone->axis;
  hull.cos_half_angle = cone->cos_half_angle;
  hull.vertices = HullVertices(ImagePlane::About(hull.axis), normalized);
  if (hull.vertices.empty()) hull.vertices.push_back(hull.axis);
  return hull;
}

bool RayHull::Keeps(const glm::dvec3& normalized_ray) const {
  return complete ||
         glm::dot(reduced_axis, normalized_ray) > std::cos(kReducedHalfAngle) * glm::length(normalized_ray);
}

namespace {

RayHull MakeOwnRayHull(const LightProblem& problem, HullOf hull_of) {
  const LightSamples& samples = *problem.samples;
  const bool with_footprints = hull_of == HullOf::kShadow;
  std::vector<int32_t> chosen = OuterSamples(samples, *problem.ray_space, hull_of);
  std::vector<glm::dvec3> rays;
  const auto hull_of_chosen = [&] {
    rays.clear();
    rays.reserve((with_footprints ? 4 : 1) * chosen.size());
    for (const int32_t index : chosen) {
      const auto i = static_cast<size_t>(index);
      // The middle of four corners is no vertex.
      const glm::dvec3 reach = samples.hull_rays_dx1[i] + samples.hull_rays_dx2[i];
      if (!with_footprints || !std::isfinite(reach.x + reach.y + reach.z)) {
        rays.push_back(samples.hull_rays[i]);
        continue;
      }
      for (int corner = 0; corner < 4; ++corner) rays.push_back(samples.FootprintCorner(i, corner));
    }
    if (rays.empty()) {
      for (const glm::dvec3& corner : problem.ws_scene_bounds.Corners()) {
        rays.push_back(problem.ray_space->RayFromPoint(corner));
      }
    }
    return MakeRayHull(*problem.ray_space, rays);
  };
  RayHull hull = hull_of_chosen();
  if (!hull.complete) {
    // A part of the samples is kept, which inner samples are a part of too.
    std::vector<int32_t> all = HullSamples(samples, hull_of);
    if (chosen.size() < all.size()) {
      chosen = std::move(all);
      hull = hull_of_chosen();
    }
  }
  if (hull_of == HullOf::kShadow) hull.shadow_samples = std::move(chosen);
  return hull;
}

}  // namespace

RayHull MakeRayHull(const LightProblem& problem, HullOf hull_of) {
  if (problem.hulls == nullptr) return MakeOwnRayHull(problem, hull_of);
  std::optional<RayHull>& hull =
      hull_of == HullOf::kShadow ? problem.hulls->of_shadow : problem.hulls->of_samples;
  if (!hull) hull = MakeOwnRayHull(problem, hull_of);
  return *hull;
}

RayHull MakeFitHull(const LightProblem& problem) {
  RayHull hull = MakeRayHull(problem, HullOf::kShadow);
  if (hull.complete) return hull;
  RayHull tight = MakeRayHull(problem, HullOf::kSamples);
  if (!tight.complete) return hull;
  tight.shadow_samples = std::move(hull.shadow_samples);
  return tight;
}

}  // namespace shadowfit
