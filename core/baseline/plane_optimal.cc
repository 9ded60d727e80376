// A lixel for every pixel, in this library's terms.
//
// Every light ray r meets the plane n.X + c = 0 in one point, whose homogeneous coordinates M r are linear in
// r. The camera's picture of that point, the rows (x, y, w) of clip_from_world times M r, is therefore a
// homography of ray coordinates: the light matrix that agrees with the camera's picture wherever receivers
// lie on the plane. There a texel is a pixel, up to the scale of the map.
//
//   point, spot   X = L + t D, D = R^T r, t = -(n.L + c) / (n.D):
//                 M r = [ (n.D) L - (n.L + c) D ; n.D ]
//   directional   X = A + t d, A = a1 r1/r3 + a2 r2/r3, t = -(n.A + c) / (n.d):
//                 M r = [ (n.d) A r3 - (n.A r3 + c r3) d ; (n.d) r3 ]
//
// Both are scaled so that the last coordinate is positive where the light, travelling forwards, meets the
// plane. Off the plane a receiver is drawn where its ray meets the plane, which may be outside the picture,
// or behind the eye: the picture is not enlarged for that, as published ("Dueling frusta" is where it costs
// most), but w <= 0 on a hull ray rules the method out.

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "core/baseline/dominant_plane.h"
#include "core/baseline/image_plane.h"
#include "core/baseline/methods.h"

namespace shadowfit {
namespace {

// A receiver counts as on the plane within this share of its distance from the eye: what the eye sees as
// flat.
constexpr double kTolerance = 0.01;
// The least sine of the angle at which light may meet the plane, and the least height of the eye above the
// plane in units of its distance from the samples.
constexpr double kLeastSine = 1e-3;
constexpr double kLeastHeight = 1e-4;
constexpr size_t kMostReceivers = 512;

absl::StatusOr<LightFit> Focused(const LightProblem& problem, const char* note) {
  absl::StatusOr<LightFit> fit = FitFocused(problem);
  if (!fit.ok() || fit->outcome == FitOutcome::kFallback) return fit;
  fit->outcome = FitOutcome::kFallback;
  fit->note = note;
  return fit;
}

/// Boundary samples where there are any that make a plane; hull samples otherwise. Evenly thinned out: a
/// plane needs no more.
std::vector<PlaneSample> Receivers(const LightProblem& problem) {
  const LightSamples& samples = *problem.samples;
  const BoundarySamples& boundary = samples.boundary;
  std::vector<PlaneSample> receivers;
  if (boundary.size() >= 3) {
    const size_t stride = (boundary.size() + kMostReceivers - 1) / kMostReceivers;
    for (size_t i = 0; i < boundary.size(); i += stride) {
      receivers.push_back(
          {problem.ray_space->PointFromRay(boundary.Ray(i), boundary.q[i]), boundary.length[i]});
    }
  } else {
    const size_t stride = (samples.hull_rays.size() + kMostReceivers - 1) / kMostReceivers;
    for (size_t i = 0; i < samples.hull_rays.size(); i += stride) {
      receivers.push_back({problem.ray_space->PointFromRay(samples.hull_rays[i], samples.hull_along_ray[i])});
    }
  }
  const glm::dvec4 eye = problem.camera->ws_eye();
  Bounds bounds;
  for (const PlaneSample& receiver : receivers) bounds.Add(receiver.ws_position);
  const double diameter = bounds.empty() ? 0.0 : glm::distance(bounds.min, bounds.max);
  for (PlaneSample& receiver : receivers) {
    // An orthographic eye is at no distance: the size of what it sees stands in.
    const double distance =
        eye.w != 0.0 ? glm::distance(receiver.ws_position, glm::dvec3(eye) / eye.w) : diameter;
    receiver.tolerance = std::max(kTolerance * distance, 1e-9);
    receiver.weight = std::max(receiver.weight, 1e-9);
  }
  return receivers;
}

/// The rows of a homography: row . M r for each of the clip rows x, y and w.
PlaneMap CameraImageOfPlane(const LightProblem& problem, const glm::dvec3& n, double c) {
  const RaySpace& ray_space = *problem.ray_space;
  const glm::dmat3 ws_from_ray = glm::transpose(ray_space.linear());
  glm::dvec3 columns[3];  // The first three coordinates of M r, by ray coordinate.
  glm::dvec3 last;        // The fourth.
  if (ray_space.is_directional()) {
    const glm::dvec3 d = ray_space.ws_direction();
    const double sign = glm::dot(n, d) < 0.0 ? -1.0 : 1.0;
    const double nd = sign * glm::dot(n, d);
    for (int i = 0; i < 2; ++i) columns[i] = nd * ws_from_ray[i] - sign * glm::dot(n, ws_from_ray[i]) * d;
    columns[2] = -sign * c * d;
    last = {0.0, 0.0, nd};
  } else {
    const glm::dvec3 light = ray_space.ws_position();
    const double height = glm::dot(n, light) + c;
    // Rays that meet the plane run against the side that the light is on.
    const double sign = height > 0.0 ? -1.0 : 1.0;
    for (int i = 0; i < 3; ++i) {
      const double nd = glm::dot(n, ws_from_ray[i]);
      columns[i] = sign * (nd * light - height * ws_from_ray[i]);
      last[i] = sign * nd;
    }
  }
  const glm::dmat4 clip_rows = glm::transpose(problem.camera->clip_from_world());
  const auto row = [&](const glm::dvec4& clip_row) {
    return glm::dvec3(glm::dot(glm::dvec3(clip_row), columns[0]), glm::dot(glm::dvec3(clip_row), columns[1]),
                      glm::dot(glm::dvec3(clip_row), columns[2])) +
           clip_row.w * last;
  };
  return {row(clip_rows[0]), row(clip_rows[1]), row(clip_rows[3])};
}

}  // namespace

absl::StatusOr<LightFit> FitPlaneOptimal(const LightProblem& problem) {
  const RaySpace& ray_space = *problem.ray_space;
  const std::vector<glm::dvec3>& hull_rays = problem.samples->hull_rays;

  // 1. The plane.
  const std::vector<PlaneSample> receivers = Receivers(problem);
  const std::optional<glm::dvec4> plane = DominantPlane(receivers);
  if (!plane) return Focused(problem, "the visible receivers determine no plane: focused");
  const glm::dvec3 n(*plane);
  const double c = plane->w;

  // 2. Light and eye: off the plane, on the same side of it.
  glm::dvec3 center(0.0);
  for (const PlaneSample& receiver : receivers) {
    center += receiver.ws_position / static_cast<double>(receivers.size());
  }
  const glm::dvec3 to_light = ray_space.TowardsLight(center);
  const double light_sine = glm::dot(n, to_light) / glm::length(to_light);
  const glm::dvec3 to_eye = problem.camera->TowardsViewer(center);
  const double eye_sine = glm::dot(n, to_eye) / glm::length(to_eye);
  if (!(std::abs(light_sine) > kLeastSine))
    return Focused(problem, "the light lies in the receivers' plane: focused");
  if (!(std::abs(eye_sine) > kLeastHeight))
    return Focused(problem, "the eye lies in the receivers' plane: focused");
  if (light_sine * eye_sine < 0.0) {
    return Focused(problem, "light and eye are on different sides of the receivers' plane: focused");
  }

  // 3. The homography, valid if all receivers' rays meet the plane before the eye.
  const PlaneMap image = CameraImageOfPlane(problem, n, c);
  double least_w = HUGE_VAL;
  double greatest_w = 0.0;
  for (const glm::dvec3& ray : hull_rays) {
    const double w = glm::dot(image.w, ray);
    least_w = std::min(least_w, w);
    greatest_w = std::max(greatest_w, w);
  }
  if (!(least_w > 1e-9 * greatest_w)) {
    return Focused(problem, "some receivers' light rays meet the receivers' plane behind the eye: focused");
  }

  // 4. The part of the picture that rays fall into. The camera's axes stay the map's. The shadow between the
  // outermost samples and their neighbours lies in the footprints of these samples.
  glm::dvec2 low(1.0);
  glm::dvec2 high(-1.0);
  glm::ivec4 outermost(-1);  // Samples at low x, low y, high x, high y.
  for (size_t i = 0; i < hull_rays.size(); ++i) {
    const glm::dvec2 ndc = image.Project(hull_rays[i]);
    if (!(std::max(std::abs(ndc.x), std::abs(ndc.y)) <= 1.0)) continue;
    for (int axis = 0; axis < 2; ++axis) {
      if (outermost[axis] < 0 || ndc[axis] < low[axis]) {
        low[axis] = ndc[axis];
        outermost[axis] = static_cast<int>(i);
      }
      if (outermost[axis + 2] < 0 || ndc[axis] > high[axis]) {
        high[axis] = ndc[axis];
        outermost[axis + 2] = static_cast<int>(i);
      }
    }
  }
  for (int k = 0; k < 16 && outermost[0] >= 0; ++k) {
    const auto i = static_cast<size_t>(outermost[k / 4]);
    // A whole pixel around it: the derivatives are of first order, and the clamp takes what is too much.
    const glm::dvec3 ray = hull_rays[i] + (problem.samples->FootprintCorner(i, k % 4) - hull_rays[i]) /
                                              LightSamples::kFootprintReach;
    if (!(glm::dot(image.w, ray) > 0.0)) continue;
    const glm::dvec2 ndc = glm::clamp(image.Project(ray), -1.0, 1.0);
    low = glm::min(low, ndc);
    high = glm::max(high, ndc);
  }
  if (outermost[0] < 0)
    return Focused(problem, "no receiver's light ray meets the receivers' plane on the screen: focused");
  LightFit fit;
  fit.projection =
      MapRectangle(image, {0.5 * (low + high), {1.0, 0.0}, high.x - low.x, high.y - low.y}, problem.map_size);
  return fit;
}

}  // namespace shadowfit
