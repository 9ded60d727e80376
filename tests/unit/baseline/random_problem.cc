#include "tests/unit/baseline/random_problem.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>

namespace shadowfit::testing {
namespace {

struct Hit {
  const Disc* disc;
  double depth;  ///< Along the pixel's ray, in units of its direction.
};

glm::dvec3 OnDiscPlane(const Disc& disc, const glm::dvec3& from, const glm::dvec3& to) {
  const double t = glm::dot(disc.ws_normal, disc.ws_center - from) / glm::dot(disc.ws_normal, to - from);
  return from + t * (to - from);
}

}  // namespace

CameraMatrices MakeCamera(const ProblemSetup& setup) {
  const glm::dvec3 forward = glm::normalize(setup.ws_target - setup.ws_eye);
  const glm::dvec3 helper = std::abs(forward.z) > 0.99 ? glm::dvec3(0, 1, 0) : glm::dvec3(0, 0, 1);
  const glm::dvec3 right = glm::normalize(glm::cross(forward, helper));
  const glm::dvec3 up = glm::cross(right, forward);
  CameraMatrices matrices;
  matrices.clip_depth = setup.clip_depth;
  matrices.view_from_world = glm::transpose(glm::dmat4(
      glm::dvec4(right, -glm::dot(right, setup.ws_eye)), glm::dvec4(up, -glm::dot(up, setup.ws_eye)),
      glm::dvec4(-forward, glm::dot(forward, setup.ws_eye)), glm::dvec4(0, 0, 0, 1)));
  const double near_ndc = NearNdc(setup.clip_depth);
  const double far_ndc = FarNdc(setup.clip_depth);
  const double n = setup.near_plane;
  glm::dvec4 rows[4] = {{}, {}, {}, {0, 0, -1, 0}};
  if (setup.orthographic) {
    const double f = 100.0;
    rows[0].x = 0.2 / setup.aspect;
    rows[1].y = 0.2;
    const double slope = (far_ndc - near_ndc) / (f - n);
    rows[2] = {0, 0, -slope, near_ndc - slope * n};
    rows[3] = {0, 0, 0, 1};
  } else {
    const double f = 1000.0;
    const double cotangent = 1.0 / std::tan(0.5 * setup.fov_y);
    rows[0].x = cotangent / setup.aspect;
    rows[1].y = cotangent;
    // ndc = A + B / depth.
    const double b = (far_ndc - near_ndc) / (1.0 / f - 1.0 / n);
    rows[2] = {0, 0, -(near_ndc - b / n), b};
  }
  matrices.clip_from_view = glm::transpose(glm::dmat4(rows[0], rows[1], rows[2], rows[3]));
  return matrices;
}

OwnedProblem::OwnedProblem(const ProblemSetup& setup)
    : setup_(setup),
      camera_(Camera::Create(MakeCamera(setup)).value()),
      ray_space_(RaySpace::Create(setup.light).value()) {
  problem_.camera = &camera_;
  problem_.light = &setup_.light;
  problem_.ray_space = &ray_space_;
  problem_.samples = &samples_;
  problem_.map_size = setup.map_size;

  const double near_ndc = NearNdc(setup.clip_depth);
  const double far_ndc = FarNdc(setup.clip_depth);
  double nearest = far_ndc;
  double farthest = near_ndc;
  const auto nearer = [&](double a, double b) { return (a - b) * (far_ndc - near_ndc) < 0.0; };
  for (int y = 0; y < setup.pixels_y; ++y) {
    for (int x = 0; x < setup.pixels_x; ++x) {
      const auto pixel_ray = [&](double px, double py) {
        const glm::dvec2 ndc(px * 2.0 / setup.pixels_x - 1.0, py * 2.0 / setup.pixels_y - 1.0);
        const glm::dvec4 a = camera_.WsFromNdc({ndc, near_ndc});
        const glm::dvec4 b = camera_.WsFromNdc({ndc, glm::mix(near_ndc, far_ndc, 0.5)});
        return std::array<glm::dvec3, 2>{glm::dvec3(a) / a.w, glm::dvec3(b) / b.w};
      };
      const auto [from, to] = pixel_ray(x + 0.5, y + 0.5);
      const Disc* seen = nullptr;
      double seen_t = HUGE_VAL;
      for (const Disc& disc : setup_.discs) {
        const double t =
            glm::dot(disc.ws_normal, disc.ws_center - from) / glm::dot(disc.ws_normal, to - from);
        if (!(t > 0.0 && t < seen_t)) continue;
        if (glm::distance(from + t * (to - from), disc.ws_center) > disc.radius) continue;
        seen = &disc;
        seen_t = t;
      }
      if (seen == nullptr) continue;
      const glm::dvec3 ws_point = from + seen_t * (to - from);
      const glm::dvec4 clip = camera_.clip_from_world() * glm::dvec4(ws_point, 1.0);
      const double depth = clip.z / clip.w;
      if (!nearer(depth, far_ndc)) continue;
      if (nearer(depth, nearest)) nearest = depth;
      if (nearer(farthest, depth)) farthest = depth;
      const double to_light = glm::dot(seen->ws_normal, ray_space_.TowardsLight(ws_point));
      const double to_eye = glm::dot(seen->ws_normal, camera_.TowardsViewer(ws_point));
      if (!(to_light * to_eye > 0.0) || !ray_space_.Illuminates(ws_point)) continue;

      const glm::dvec3 ray = ray_space_.RayFromPoint(ws_point);
      samples_.hull_rays.push_back(ray);
      samples_.hull_along_ray.push_back(ray_space_.AlongRay(ws_point));
      const double h = 1e-3;
      const auto on_plane = [&](double px, double py) {
        const auto [a, b] = pixel_ray(px, py);
        return OnDiscPlane(*seen, a, b);
      };
      const glm::dvec3 dx1 = (on_plane(x + 0.5 + h, y + 0.5) - on_plane(x + 0.5 - h, y + 0.5)) / (2.0 * h);
      const glm::dvec3 dx2 = (on_plane(x + 0.5, y + 0.5 + h) - on_plane(x + 0.5, y + 0.5 - h)) / (2.0 * h);
      const glm::dvec3 dr1 = ray_space_.RayFromVector(dx1);
      const glm::dvec3 dr2 = ray_space_.RayFromVector(dx2);
      const double angle = 0.7 * x + 1.3 * y;
      samples_.boundary.Add(ray, dr1, dr2, ray_space_.AlongRay(ws_point), {std::cos(angle), std::sin(angle)},
                            1.0);
      samples_.hull_in_shadow.push_back(1);
      samples_.hull_rays_dx1.push_back(dr1);
      samples_.hull_rays_dx2.push_back(dr2);
    }
  }
  if (nearer(farthest, nearest)) {  // Nothing seen.
    nearest = near_ndc;
    farthest = glm::mix(near_ndc, far_ndc, 0.99);
  }
  samples_.source = samples_.hull_rays.empty() ? SampleSource::kNone : SampleSource::kShadowBoundary;
  problem_.nearest_ndc_depth = nearest;
  problem_.farthest_ndc_depth = farthest;

  if (setup.scene_bounds) {
    for (const Disc& disc : setup.discs) {
      const glm::dvec3 n = disc.ws_normal;
      const glm::dvec3 reach = disc.radius * glm::sqrt(glm::max(1.0 - n * n, glm::dvec3(0.0)));
      problem_.ws_scene_bounds.Add(disc.ws_center - reach);
      problem_.ws_scene_bounds.Add(disc.ws_center + reach + glm::dvec3(0, 0, 5));
    }
  } else {
    for (int i = 0; i < 8; ++i) {
      const glm::dvec4 p = camera_.WsFromNdc(
          {(i & 1) != 0 ? 1.0 : -1.0, (i & 2) != 0 ? 1.0 : -1.0, (i & 4) != 0 ? farthest : nearest});
      problem_.ws_scene_bounds.Add(glm::dvec3(p) / p.w);
    }
  }
}

ProblemSetup RandomSetup(std::mt19937_64& random) {
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  const auto between = [&](double a, double b) { return a + (b - a) * unit(random); };
  const auto direction = [&] {
    const double z = between(-1.0, 1.0);
    const double angle = between(0.0, 2.0 * std::numbers::pi);
    const double r = std::sqrt(1.0 - z * z);
    return glm::dvec3(r * std::cos(angle), r * std::sin(angle), z);
  };
  ProblemSetup setup;
  setup.ws_eye = {between(-20, 20), between(-20, 20), between(0.2, 8.0)};
  setup.ws_target = setup.ws_eye + direction() * glm::dvec3(1, 1, 0.6) - glm::dvec3(0, 0, 0.3);
  setup.fov_y = between(0.3, 1.8);
  setup.aspect = between(0.5, 2.0);
  setup.near_plane = std::pow(10.0, between(-2.0, 0.0));
  setup.orthographic = unit(random) < 0.1;
  setup.clip_depth = std::array{ClipDepth::kNegativeOneToOne, ClipDepth::kZeroToOne,
                                ClipDepth::kReversedZeroToOne}[random() % 3];
  const int sizes[] = {1, 2, 16, 300, 512, 2048};
  setup.map_size = {sizes[random() % 6], sizes[random() % 6]};
  setup.scene_bounds = unit(random) < 0.6;
  setup.pixels_x = 12;
  setup.pixels_y = 9;
  for (int i = 0; i < 3; ++i) {
    setup.discs.push_back({setup.ws_eye + glm::dvec3(between(-12, 12), between(-12, 12), between(-3, 3)),
                           direction(), between(0.3, 4.0)});
  }
  glm::dvec3 up = direction();
  up.z = std::abs(up.z) + 0.02;
  const double distances[] = {0.5, 8.0, 60.0, 400.0};
  const glm::dvec3 position =
      setup.ws_eye + distances[random() % 4] * (unit(random) < 0.8 ? up : direction());
  switch (random() % 3) {
    case 0:
      setup.light = PointLight{position};
      break;
    case 1:
      setup.light = SpotLight{position, setup.ws_eye + 6.0 * direction() - position, between(0.05, 1.5)};
      break;
    default:
      setup.light = DirectionalLight{-up * between(0.01, 50.0)};
      break;
  }
  return setup;
}

}  // namespace shadowfit::testing
