// A sphere that holds all receivers looks the same from every side, so a window around its image keeps its
// size while the camera turns, and its texels stay where they are if the window moves by whole texels only.
// The sphere must not depend on what the camera happens to see: it is that around the view frustum, as far as
// the scene's bounds reach from the viewer, or that around the bounds themselves, whichever is smaller. While
// the viewer walks, the reach changes a little; so the size is rounded up to the next step of a ladder.
// Where the caller gives no bounds these are of what is visible, and the window is only as stable as they
// are.
//
// Directional lights: the image of a sphere of radius R is a disc of radius R, wherever it is. Other lights:
// the image of a sphere grows as it comes nearer, so the one around the bounds, which stays, is preferred.
// Spots: the image plane is the spot's own; a window as large as the spot's own frustum is that frustum,
// which never moves. Point lights have no orientation of their own: of 26 fixed ones, towards the neighbours
// of a cell in a cubic lattice, the one nearest to the sphere serves. One that is within the stable spheres
// gets a window around what is visible, which breathes; one that is within that, its own frustum.

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <vector>

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

/// The view frustum's corners in view space between two NDC depths; the four nearer ones first.
std::optional<std::array<glm::dvec3, 8>> SliceCorners(const Camera& camera, double near_ndc, double far_ndc) {
  const glm::dmat4 view_from_clip = glm::inverse(camera.clip_from_view());
  std::array<glm::dvec3, 8> corners;
  for (size_t i = 0; i < 8; ++i) {
    const glm::dvec4 p = view_from_clip * glm::dvec4((i & 1) != 0 ? 1.0 : -1.0, (i & 2) != 0 ? 1.0 : -1.0,
                                                     i < 4 ? near_ndc : far_ndc, 1.0);
    corners[i] = glm::dvec3(p) / p.w;
    if (!std::isfinite(corners[i].x + corners[i].y + corners[i].z)) return std::nullopt;
  }
  return corners;
}

/// The smallest sphere around a slice of the view frustum whose centre lies on the line through the middles
/// of its near and far end. Computed in view space, so that its radius has the same bits wherever the camera
/// is.
std::optional<Sphere> SphereAround(const std::array<glm::dvec3, 8>& corners, const Camera& camera) {
  glm::dvec3 ends[2] = {glm::dvec3(0.0), glm::dvec3(0.0)};
  for (size_t i = 0; i < 8; ++i) ends[i / 4] += 0.25 * corners[i];
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
  if (!std::isfinite(sphere.radius + glm::length(sphere.ws_center)) || !(sphere.radius > 0.0))
    return std::nullopt;
  return sphere;
}

/// Around what is visible: small, but it breathes as the camera turns.
std::optional<Sphere> SphereAroundVisible(const LightProblem& problem) {
  const auto corners = SliceCorners(*problem.camera, problem.nearest_ndc_depth, problem.farthest_ndc_depth);
  return corners ? SphereAround(*corners, *problem.camera) : std::nullopt;
}

/// Around the view frustum from its near plane to where the scene's bounds end in any direction.
std::optional<Sphere> SphereAroundView(const LightProblem& problem) {
  const Camera& camera = *problem.camera;
  const double near_ndc = NearNdc(camera.clip_depth());
  const double far_ndc = FarNdc(camera.clip_depth());
  // The far plane may be infinitely far away; another depth tells the directions of the frustum's edges.
  std::optional<std::array<glm::dvec3, 8>> corners =
      SliceCorners(camera, near_ndc, glm::mix(near_ndc, far_ndc, 0.5));
  if (!corners) return std::nullopt;
  double reach = 0.0;
  for (const glm::dvec3& ws_corner : problem.ws_scene_bounds.Corners()) {
    const glm::dvec4 vs_corner = camera.view_from_world() * glm::dvec4(ws_corner, 1.0);
    reach = std::max(reach, glm::length(glm::dvec3(vs_corner) / vs_corner.w));
  }
  const double steps = kStepsPerDoubling * std::log2(reach);
  reach = std::exp2(std::ceil(steps - 1e-6) / kStepsPerDoubling);
  if (const auto visible = SliceCorners(camera, near_ndc, problem.farthest_ndc_depth)) {
    reach = std::max(reach, std::abs((*visible)[4].z));  // Bounds may be wrong.
  }
  if (const auto whole = SliceCorners(camera, near_ndc, far_ndc))
    reach = std::min(reach, std::abs((*whole)[4].z));
  for (size_t i = 0; i < 4; ++i) {
    const glm::dvec3 edge = (*corners)[i + 4] - (*corners)[i];
    const double along = (reach - std::abs((*corners)[i].z)) / std::abs(edge.z);
    (*corners)[i + 4] = (*corners)[i] + std::max(along, 0.0) * edge;
    if (!std::isfinite(along)) return std::nullopt;
  }
  return SphereAround(*corners, camera);
}

/// Around the scene's bounds; none where they do not hold what the map must hold.
std::optional<Sphere> SphereAroundScene(const LightProblem& problem) {
  const Bounds& bounds = problem.ws_scene_bounds;
  const Sphere sphere{bounds.Center(), 0.5 * glm::distance(bounds.min, bounds.max)};
  const LightSamples& samples = *problem.samples;
  for (size_t i = 0; i < samples.hull_rays.size(); ++i) {
    const glm::dvec3 ws_point =
        problem.ray_space->PointFromRay(samples.hull_rays[i], samples.hull_along_ray[i]);
    if (!(glm::distance(ws_point, sphere.ws_center) <= sphere.radius)) return std::nullopt;
  }
  if (!std::isfinite(sphere.radius) || !(sphere.radius > 0.0)) return std::nullopt;
  return sphere;
}

/// Spheres that turning the camera does not change, the better one first: the smaller, but where perspective
/// makes the image of a sphere that moves grow and shrink, the one that stays.
std::vector<Sphere> StableSpheres(const LightProblem& problem) {
  std::vector<Sphere> spheres;
  const std::optional<Sphere> view = SphereAroundView(problem);
  const std::optional<Sphere> scene = SphereAroundScene(problem);
  if (view) spheres.push_back(*view);
  if (scene) {
    const bool first = !view || !problem.ray_space->is_directional() || scene->radius < view->radius;
    spheres.insert(first ? spheres.begin() : spheres.end(), *scene);
  }
  return spheres;
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

/// The window around a sphere's image; none where the sphere is too near to the light or around it.
std::optional<ShadowProjection> WindowAround(const Sphere& sphere, const LightProblem& problem) {
  const RaySpace& ray_space = *problem.ray_space;
  const glm::dvec3 center = ray_space.RayFromPoint(sphere.ws_center);
  if (ray_space.is_directional()) {
    const PlaneMap plane = UprightPlane(ray_space, {0.0, 0.0, 1.0});
    return SnappedWindow(plane, plane.Project(center), RoundUpToStep(sphere.radius), problem.map_size);
  }
  const bool spot = ray_space.cos_outer().has_value();
  const glm::dvec3 axis = spot ? glm::dvec3(0.0, 0.0, 1.0) : NearestLatticeDirection(center);
  const PlaneMap plane = UprightPlane(ray_space, axis);
  const double w = glm::dot(plane.w, center);
  if (!(w > sphere.radius)) return std::nullopt;
  const glm::dvec2 x = TangentInterval(glm::dot(plane.x, center), w, sphere.radius);
  const glm::dvec2 y = TangentInterval(glm::dot(plane.y, center), w, sphere.radius);
  const double half_side = RoundUpToStep(0.5 * std::max(x[1] - x[0], y[1] - y[0]));
  double widest = kWidestTangent;
  if (spot) widest = 0.5 * NormalFrustum(problem).extents.width;
  if (!(half_side < widest)) return std::nullopt;
  return SnappedWindow(plane, 0.5 * glm::dvec2(x[0] + x[1], y[0] + y[1]), half_side, problem.map_size);
}

}  // namespace

absl::StatusOr<LightFit> FitSphereStable(const LightProblem& problem) {
  if (problem.map_size.width < 2 || problem.map_size.height < 2) {
    return Normal(problem, "a map of one texel a side has nothing to snap to: the light's own frustum");
  }
  const bool spot = problem.ray_space->cos_outer().has_value();
  if (spot && NormalFrustum(problem).outcome == FitOutcome::kFallback) return FitNormal(problem);
  const std::vector<Sphere> stable = StableSpheres(problem);
  LightFit fit;
  for (const Sphere& sphere : stable) {
    if (const auto window = WindowAround(sphere, problem)) {
      fit.projection = *window;
      return fit;
    }
    if (spot) return FitNormal(problem);  // A spot's own frustum never moves.
  }
  const std::optional<Sphere> visible = SphereAroundVisible(problem);
  if (const auto window = visible ? WindowAround(*visible, problem) : std::nullopt) {
    fit.projection = *window;
    return fit;
  }
  if (spot) return FitNormal(problem);
  return Normal(
      problem,
      visible ? "the light is inside the sphere around the view or too near to it: the light's own frustum"
              : "the visible slice of the view frustum has no finite extent: the light's own frustum");
}

}  // namespace shadowfit
