// A sphere around the visible slice of the view frustum looks the same from every side, so a window around
// its image keeps its size while the camera turns, and its texels stay where they are if the window moves by
// whole texels only. The size may not drift either: it is rounded up to the next step of a ladder, so that
// small changes of the visible depth range leave it alone.
//
// Directional lights: the image of a sphere of radius R is a disc of radius R, wherever it is. Spots: the
// image plane is the spot's own; the sphere's image grows as it comes nearer, which the ladder absorbs in
// part; a window as large as the spot's own frustum is that frustum, which never moves. Point lights have no
// orientation of their own: of 26 fixed ones, towards the neighbours of a cell in a cubic lattice, the one
// nearest to the sphere serves.

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "core/baseline/light_frustum.h"
#include "core/baseline/methods.h"

namespace shadowfit {
namespace {

// Steps of the ladder per doubling: a window is at most 9 % larger than its content.
constexpr double kStepsPerDoubling = 8.0;
// Tangent of the half angle beyond which a point light's window is not worth having: 80 degrees.
constexpr double kWidestTangent = 5.671281819617709;

struct Sphere {
  glm::dvec3 ws_center{0.0};
  double radius = 0.0;
};

/// The smallest sphere around the view frustum's slice whose centre lies on the line through the middles of
/// its near and far end. Computed in view space, so that its radius has the same bits wherever the camera is.
std::optional<Sphere> SphereAroundView(const LightProblem& problem) {
  const Camera& camera = *problem.camera;
  const glm::dmat4 view_from_clip = glm::inverse(camera.clip_from_view());
  std::array<glm::dvec3, 8> corners;
  glm::dvec3 ends[2] = {glm::dvec3(0.0), glm::dvec3(0.0)};
  for (size_t i = 0; i < 8; ++i) {
    const double depth = i < 4 ? problem.nearest_ndc_depth : problem.farthest_ndc_depth;
    const glm::dvec4 p =
        view_from_clip * glm::dvec4((i & 1) != 0 ? 1.0 : -1.0, (i & 2) != 0 ? 1.0 : -1.0, depth, 1.0);
    corners[i] = glm::dvec3(p) / p.w;
    if (!std::isfinite(corners[i].x + corners[i].y + corners[i].z)) return std::nullopt;
    ends[i / 4] += 0.25 * corners[i];
  }
  // Squared distance of corner i from ends[0] + t axis: a_i - 2 t b_i + t^2 |axis|^2. The greatest over the
  // corners is least at the vertex of one of the parabolas or where two of them meet.
  const glm::dvec3 axis = ends[1] - ends[0];
  const double axis_squared = glm::dot(axis, axis);
  std::array<double, 8> a;
  std::array<double, 8> b;
  for (size_t i = 0; i < 8; ++i) {
    const glm::dvec3 from_end = corners[i] - ends[0];
    a[i] = glm::dot(from_end, from_end);
    b[i] = glm::dot(from_end, axis);
  }
  double best_t = 0.0;
  double best_squared = HUGE_VAL;
  const auto consider = [&](double t) {
    if (!(t >= 0.0 && t <= 1.0)) return;
    double squared = 0.0;
    for (size_t i = 0; i < 8; ++i) squared = std::max(squared, a[i] - 2.0 * t * b[i] + t * t * axis_squared);
    if (squared < best_squared) {
      best_squared = squared;
      best_t = t;
    }
  };
  consider(0.0);
  consider(1.0);
  for (size_t i = 0; i < 8; ++i) {
    consider(b[i] / axis_squared);
    for (size_t j = 0; j < i; ++j) consider((a[i] - a[j]) / (2.0 * (b[i] - b[j])));
  }
  Sphere sphere;
  const glm::dvec3 vs_center = ends[0] + best_t * axis;
  const glm::dvec4 ws_center = glm::inverse(camera.view_from_world()) * glm::dvec4(vs_center, 1.0);
  sphere.ws_center = glm::dvec3(ws_center) / ws_center.w;
  sphere.radius = std::sqrt(best_squared);
  if (!std::isfinite(sphere.radius + glm::length(sphere.ws_center))) return std::nullopt;
  return sphere;
}

/// The next step of the ladder. Values that rounding alone lifts above a step stay on it.
double RoundUpToStep(double value) {
  return std::exp2(std::ceil(kStepsPerDoubling * std::log2(value) - 1e-6) / kStepsPerDoubling);
}

/// A square window of the plane around `center`, moved to the next whole texel of the lattice that begins at
/// the plane's origin. `half_side` counts one texel less than the map has, which is what the move needs.
ShadowProjection SnappedWindow(const PlaneMap& plane, const glm::dvec2& center, double half_side,
                               MapSize size) {
  const glm::dvec2 texel(2.0 * half_side / (size.width - 1), 2.0 * half_side / (size.height - 1));
  const glm::dvec2 corner = glm::floor((center - half_side) / texel);
  const glm::dvec3 axes[2] = {plane.x, plane.y};
  glm::dvec3 rows[2];
  for (int i = 0; i < 2; ++i) rows[i] = axes[i] / texel[i] - corner[i] * plane.w;
  return {glm::transpose(glm::dmat3(rows[0], rows[1], plane.w)), size};
}

/// The interval of x / w over a sphere in front of the plane w = 0: its two tangents from the origin in the
/// (x, w) plane.
glm::dvec2 TangentInterval(double x, double w, double radius) {
  const double root = radius * std::sqrt(std::max(x * x + w * w - radius * radius, 0.0));
  return glm::dvec2(x * w - root, x * w + root) / (w * w - radius * radius);
}

absl::StatusOr<LightFit> Normal(const LightProblem& problem, const char* note) {
  absl::StatusOr<LightFit> fit = FitNormal(problem);
  if (!fit.ok() || fit->outcome == FitOutcome::kFallback) return fit;
  fit->outcome = FitOutcome::kFallback;
  fit->note = note;
  return fit;
}

/// Of 26 fixed directions the one nearest to `direction`.
glm::dvec3 NearestLatticeDirection(const glm::dvec3& direction) {
  glm::dvec3 best(0.0, 0.0, 1.0);
  double most = -HUGE_VAL;
  for (int i = 0; i < 27; ++i) {
    if (i == 13) continue;
    const glm::dvec3 candidate = glm::normalize(glm::dvec3(i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1));
    if (const double cosine = glm::dot(candidate, direction); cosine > most) {
      most = cosine;
      best = candidate;
    }
  }
  return best;
}

}  // namespace

absl::StatusOr<LightFit> FitSphereStable(const LightProblem& problem) {
  const RaySpace& ray_space = *problem.ray_space;
  if (problem.map_size.width < 2 || problem.map_size.height < 2) {
    return Normal(problem, "a map of one texel a side has nothing to snap to: the light's own frustum");
  }
  const std::optional<Sphere> sphere = SphereAroundView(problem);
  if (!sphere || !(sphere->radius > 0.0)) {
    return Normal(problem,
                  "the visible slice of the view frustum has no finite extent: the light's own frustum");
  }

  LightFit fit;
  const glm::dvec3 center = ray_space.RayFromPoint(sphere->ws_center);
  if (ray_space.is_directional()) {
    const PlaneMap plane = UprightPlane(ray_space, {0.0, 0.0, 1.0});
    fit.projection =
        SnappedWindow(plane, plane.Project(center), RoundUpToStep(sphere->radius), problem.map_size);
    return fit;
  }

  const bool spot = ray_space.cos_outer().has_value();
  const glm::dvec3 axis = spot ? glm::dvec3(0.0, 0.0, 1.0) : NearestLatticeDirection(center);
  const PlaneMap plane = UprightPlane(ray_space, axis);
  const double w = glm::dot(plane.w, center);
  double half_side = HUGE_VAL;
  glm::dvec2 middle(0.0);
  if (w > sphere->radius) {
    const glm::dvec2 x = TangentInterval(glm::dot(plane.x, center), w, sphere->radius);
    const glm::dvec2 y = TangentInterval(glm::dot(plane.y, center), w, sphere->radius);
    half_side = RoundUpToStep(0.5 * std::max(x[1] - x[0], y[1] - y[0]));
    middle = 0.5 * glm::dvec2(x[0] + x[1], y[0] + y[1]);
  }
  if (spot) {
    const LightFrustum frustum = NormalFrustum(problem);
    if (frustum.outcome == FitOutcome::kFallback || !(half_side < 0.5 * frustum.extents.width)) {
      return FitNormal(problem);
    }
  } else if (!(half_side < kWidestTangent)) {
    return Normal(
        problem, "the light is inside the sphere around the view or too near to it: the light's own frustum");
  }
  fit.projection = SnappedWindow(plane, middle, half_side, problem.map_size);
  return fit;
}

}  // namespace shadowfit
