#include "core/baseline/light_frustum.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <span>
#include <vector>

#include "core/fit/ray_hull.h"

namespace shadowfit {
namespace {

// The widest half angle of the light's own frustum, 80 degrees, as a cosine: beyond it a square map spends
// almost all of its texels on the rim.
constexpr double kCosWidest = 0.17364817766693033;

// The same for a frustum that is bound to contain the samples: 89.4 degrees, short of dividing by nothing.
constexpr double kCosWidestFallback = 0.01;

constexpr char kInsideBounds[] =
    "the light is too near to the scene's bounds for one frustum around them: frustum around the visible "
    "samples instead";
constexpr char kSpotTooWide[] =
    "the spot is too wide for one frustum: frustum around the visible samples instead";
constexpr char kHemisphere[] =
    "the visible samples span a hemisphere or more: frustum around a cone that holds most of them";

/// Half the side of the square around the plane's origin that holds the rays in front of the plane.
double HalfSide(const PlaneMap& plane, std::span<const glm::dvec3> rays) {
  double half_side = 0.0;
  for (const glm::dvec3& ray : rays) {
    if (!(glm::dot(plane.w, ray) > 0.0)) continue;
    const glm::dvec2 v = glm::abs(plane.Project(ray));
    half_side = std::max({half_side, v.x, v.y});
  }
  return half_side;
}

EnclosingRectangle Square(double half_side) {
  return {glm::dvec2(0.0), glm::dvec2(1.0, 0.0), 2.0 * half_side, 2.0 * half_side};
}

bool AllWithin(const glm::dvec3& axis, double cos_half_angle, std::span<const glm::dvec3> rays) {
  return std::all_of(rays.begin(), rays.end(), [&](const glm::dvec3& ray) {
    const double w = glm::dot(axis, ray);
    return w > 0.0 && w * w > cos_half_angle * cos_half_angle * glm::dot(ray, ray);
  });
}

/// The fallback of NormalFrustum.
LightFrustum FrustumAroundSamples(const LightProblem& problem, const char* reason) {
  // With the samples' footprints where these still fit into one frustum: the shadow between samples is then
  // inside as well.
  RayHull hull = MakeRayHull(problem, HullOf::kShadow);
  if (!hull.complete || !AllWithin(hull.axis, kCosWidest, hull.vertices)) {
    hull = MakeRayHull(problem, HullOf::kSamples);
  }
  LightFrustum frustum;
  frustum.outcome = FitOutcome::kFallback;
  frustum.note = hull.complete ? reason : kHemisphere;
  frustum.plane = UprightPlane(*problem.ray_space, hull.axis);
  frustum.extents = Square(HalfSide(frustum.plane, hull.vertices));
  return frustum;
}

LightFrustum DirectionalFrustum(const LightProblem& problem, std::span<const glm::dvec3> bounds) {
  LightFrustum frustum;
  frustum.plane = UprightPlane(*problem.ray_space, {0.0, 0.0, 1.0});
  glm::dvec2 low(HUGE_VAL);
  glm::dvec2 high(-HUGE_VAL);
  const auto add = [&](std::span<const glm::dvec3> rays) {
    for (const glm::dvec3& ray : rays) {
      const glm::dvec2 v = frustum.plane.Project(ray);
      low = glm::min(low, v);
      high = glm::max(high, v);
    }
  };
  add(bounds);
  add(problem.samples->hull_rays);
  const double side = std::max(high.x - low.x, high.y - low.y);
  frustum.extents = {0.5 * (low + high), {1.0, 0.0}, side, side};
  return frustum;
}

}  // namespace

LightFrustum NormalFrustum(const LightProblem& problem) {
  const RaySpace& ray_space = *problem.ray_space;
  const std::vector<glm::dvec3>& hull_rays = problem.samples->hull_rays;
  std::array<glm::dvec3, 8> bounds = problem.ws_scene_bounds.Corners();
  for (glm::dvec3& corner : bounds) corner = ray_space.RayFromPoint(corner);

  if (ray_space.is_directional()) return DirectionalFrustum(problem, bounds);

  LightFrustum frustum;
  if (ray_space.cos_outer()) {
    const glm::dvec3 axis(0.0, 0.0, 1.0);  // RaySpace turns the spot's axis there.
    const double cosine = *ray_space.cos_outer();
    if (cosine < kCosWidestFallback || !AllWithin(axis, kCosWidestFallback, hull_rays)) {
      return FrustumAroundSamples(problem, kSpotTooWide);
    }
    frustum.plane = UprightPlane(ray_space, axis);
    const double tangent = std::sqrt(1.0 - cosine * cosine) / cosine;
    // Samples lie in the cone; the maximum only absorbs the rounding of those on its rim.
    frustum.extents = Square(std::max(tangent, HalfSide(frustum.plane, hull_rays)));
    return frustum;
  }

  const glm::dvec3 to_center = ray_space.RayFromPoint(problem.ws_scene_bounds.Center());
  const double distance = glm::length(to_center);
  const glm::dvec3 axis = distance > 0.0 ? to_center / distance : ray_space.RayFromVector(-kWsUp);
  if (!AllWithin(axis, kCosWidest, bounds) || !AllWithin(axis, kCosWidest, hull_rays)) {
    return FrustumAroundSamples(problem, kInsideBounds);
  }
  frustum.plane = UprightPlane(ray_space, axis);
  frustum.extents = Square(std::max(HalfSide(frustum.plane, bounds), HalfSide(frustum.plane, hull_rays)));
  return frustum;
}

}  // namespace shadowfit
