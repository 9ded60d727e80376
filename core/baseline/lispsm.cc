// Light space perspective shadow maps, in this library's terms.
//
// The paper's light space has its y axis along the light and its z axis along the image of the view
// direction on the light's plane. A perspective frustum P with view direction z is set around the body B,
// all that can be seen and lit; its centre of projection C lies a distance n before B, and n rules how strong
// the warp is. On the light's image plane, with s the coordinate along the image of the view direction and x
// the one across,
//
//   u ~ (x - x_eye) / (s - s_C),   v ~ -1 / (s - s_C),   s_C = s_near - n,
//
// a homography of ray coordinates, fitted to B with an axis-aligned box as P's planes are. The optimal n
// makes the perspective error on the near plane and on the far plane of B equal:
//
//   n = d / (sqrt(z1/z0) - 1),   d = s_far - s_near,
//
// where z0 and z1 are the eye's depths of two points at equal depth along the light, at s_near and at s_far,
// the first at the near depth of B. With gamma the angle between view and light, z1 = z0 + d sin(gamma) for a
// directional light, so that n = (z0 + sqrt(z0 z1)) / sin(gamma): the paper's n_opt = z_n + sqrt(z_n z_f) for
// an overhead light, growing to infinity (no warp, Focused) as the light turns into the view direction.
//
// For point and spot lights all this happens on the image plane after the light's own perspective.

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/baseline/light_frustum.h"
#include "core/baseline/methods.h"
#include "core/baseline/view_body.h"

namespace shadowfit {
namespace {

// n in units of the body's length beyond which the warp is less than one in a thousand over the whole map.
constexpr double kStraight = 1e3;

absl::StatusOr<LightFit> Focused(const LightProblem& problem, const char* note) {
  absl::StatusOr<LightFit> fit = FitFocused(problem);
  if (!fit.ok() || fit->outcome == FitOutcome::kFallback) return fit;
  fit->outcome = FitOutcome::kFallback;
  fit->note = note;
  return fit;
}

}  // namespace

absl::StatusOr<LightFit> FitLispsm(const LightProblem& problem) {
  const Camera& camera = *problem.camera;
  const RaySpace& ray_space = *problem.ray_space;
  const LightFrustum frustum = NormalFrustum(problem);
  const PlaneMap& plane = frustum.plane;

  // 1. The body: view frustum, scene and light frustum have it in common.
  ViewBody body(camera, problem.nearest_ndc_depth, problem.farthest_ndc_depth);
  body.ClipToBounds(problem.ws_scene_bounds);
  body.ClipToFrustum(ray_space, frustum);
  const std::vector<glm::dvec3> vertices = body.Vertices();
  if (vertices.empty()) {
    return Focused(problem, "view frustum, scene and light frustum have nothing in common: focused");
  }

  // 2. Eye depth is clip w up to scale, of which only ratios are used.
  const glm::dvec4 depth_row = glm::transpose(camera.clip_from_world())[3];
  const glm::dvec3 depth_gradient(depth_row);
  const auto eye_depth = [&](const glm::dvec3& p) { return glm::dot(depth_gradient, p) + depth_row.w; };
  double nearest_depth = HUGE_VAL;
  double nearest_w = HUGE_VAL;
  double farthest_w = 0.0;
  for (const glm::dvec3& vertex : vertices) {
    nearest_depth = std::min(nearest_depth, eye_depth(vertex));
    const double w = glm::dot(plane.w, ray_space.RayFromPoint(vertex));
    nearest_w = std::min(nearest_w, w);
    farthest_w = std::max(farthest_w, w);
  }
  if (!(glm::length(depth_gradient) > 0.0)) {
    return Focused(problem, "an orthographic camera has no perspective to follow: focused");
  }
  if (!(nearest_depth > 0.0)) return Focused(problem, "the view reaches behind the eye: focused");

  // 3. The view direction's image at the near point of the view axis.
  const glm::dvec4 axis_near = camera.WsFromNdc({0.0, 0.0, problem.nearest_ndc_depth});
  const glm::dvec4 axis_far = camera.WsFromNdc({0.0, 0.0, FarNdc(camera.clip_depth())});
  const glm::dvec3 ws_axis_near = glm::dvec3(axis_near) / axis_near.w;
  // p_far - p_near up to a positive factor, also for a far plane at infinity (w = 0).
  const glm::dvec3 ws_view = glm::normalize(glm::dvec3(axis_far) - axis_far.w * ws_axis_near);
  const double view_slope = glm::dot(depth_gradient, ws_view);
  if (!(view_slope > 0.0)) return Focused(problem, "the view axis does not run away from the eye: focused");
  const glm::dvec3 ws_near_point =
      ws_axis_near + ((nearest_depth - eye_depth(ws_axis_near)) / view_slope) * ws_view;
  const glm::dvec3 near_ray = ray_space.RayFromPoint(ws_near_point);
  const double near_w = glm::dot(plane.w, near_ray);
  if (!(near_w > 1e-6 * farthest_w)) {
    return Focused(problem, "the view axis begins behind the light: focused");
  }
  const glm::dvec2 near_image = plane.Project(near_ray);
  const glm::dvec3 view_ray = ray_space.RayFromVector(ws_view);
  // Derivative of (x.r, y.r) / (w.r), times w.r.
  const glm::dvec2 view_image = glm::dvec2(glm::dot(plane.x, view_ray), glm::dot(plane.y, view_ray)) -
                                near_image * glm::dot(plane.w, view_ray);
  const double view_image_length = glm::length(view_image);
  if (view_image_length < 1e-6) return Focused(problem, "the view runs along the light: focused");
  const glm::dvec2 along = view_image / view_image_length;
  const glm::dvec2 across(along.y, -along.x);

  // 4. Extents of the body along and across. Visible samples are in the body; those that rounding, or a
  // caller's bounds, leave outside stretch it.
  const std::vector<glm::dvec3>& hull_rays = problem.samples->hull_rays;
  std::vector<glm::dvec2> image;
  image.reserve(vertices.size());
  double s_near = HUGE_VAL;
  double s_far = -HUGE_VAL;
  for (const glm::dvec3& vertex : vertices) {
    image.push_back(plane.Project(ray_space.RayFromPoint(vertex)));
    s_near = std::min(s_near, glm::dot(along, image.back()));
    s_far = std::max(s_far, glm::dot(along, image.back()));
  }
  const glm::dvec3 along_row = along.x * plane.x + along.y * plane.y;
  for (const glm::dvec3& ray : hull_rays) {
    const double w = glm::dot(plane.w, ray);
    const double s_times_w = glm::dot(along_row, ray);
    if (!(w > 0.0) || (s_times_w >= s_near * w && s_times_w <= s_far * w)) continue;
    s_near = std::min(s_near, s_times_w / w);
    s_far = std::max(s_far, s_times_w / w);
  }
  const double d = s_far - s_near;
  const double x_eye = glm::dot(across, near_image);
  if (!(d > 1e-9 * (std::abs(s_near) + std::abs(s_far)))) {
    return Focused(problem, "the view has no length on the light's plane: focused");
  }

  // 5. z1 - z0. One step along s at light depth t is t times a unit vector in the world; a directional light
  // has no t. The first point lies where the ray at s_near reaches the near depth, as far as the body reaches
  // along the light.
  const glm::dvec3 ws_along = glm::transpose(ray_space.linear()) * along_row;
  double t = 1.0;
  if (!ray_space.is_directional()) {
    const RaySpace::WsRay ray = ray_space.WorldRay(plane.RayThrough(along * s_near + across * x_eye));
    const double slope = glm::dot(depth_gradient, ray.direction);
    t = (nearest_depth - eye_depth(ray.origin)) / slope;
    // A ray within the near plane's direction meets it anywhere.
    if (!std::isfinite(t)) t = near_w;
    t = std::clamp(t, nearest_w, farthest_w);
  }
  const double z0 = nearest_depth;
  const double z1 = z0 + t * d * glm::dot(depth_gradient, ws_along);
  if (!(z1 > z0))
    return Focused(problem, "the view's depth falls along its image on the light's plane: focused");
  const double n = d / (std::sqrt(z1 / z0) - 1.0);
  if (!(n < kStraight * d)) return Focused(problem, "the view runs almost along the light: focused");

  // 6. The warp, and the box.
  const double s_center = s_near - n;
  const PlaneMap warped = {across.x * plane.x + across.y * plane.y - x_eye * plane.w, -plane.w,
                           along_row - s_center * plane.w};
  for (glm::dvec2& v : image) {
    const double w = glm::dot(along, v) - s_center;
    v = glm::dvec2(glm::dot(across, v) - x_eye, -1.0) / w;
  }
  EnclosingRectangle box = RectangleAlong(image, {1.0, 0.0});
  if (!InFrontMeansInside(warped, box, hull_rays)) {
    for (const glm::dvec3& ray : hull_rays) {
      if (glm::dot(plane.w, ray) > 0.0) image.push_back(warped.Project(ray));
    }
    box = RectangleAlong(image, {1.0, 0.0});
  }
  LightFit fit;
  fit.projection = MapRectangle(warped, box, problem.map_size);
  fit.outcome = frustum.outcome;
  fit.note = frustum.note;
  return fit;
}

}  // namespace shadowfit
