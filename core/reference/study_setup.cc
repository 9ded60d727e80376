#include "core/reference/study_setup.h"

#include <algorithm>
#include <cmath>
#include <glm/ext/matrix_clip_space.hpp>
#include <glm/ext/matrix_transform.hpp>
#include <numbers>
#include <utility>

#include "core/scene/random.h"

namespace shadowfit {
namespace {

constexpr std::pair<LightPlacement, std::string_view> kPlacements[] = {
    {LightPlacement::kNear, "near"},
    {LightPlacement::kDistant, "distant"},
    {LightPlacement::kDirectional, "directional"},
    {LightPlacement::kInside, "inside"},
};

/// Right-handed axes with the third one up.
glm::dmat3 AxesAround(const glm::dvec3& ws_up) {
  const glm::dvec3 z = glm::normalize(ws_up);
  const glm::dvec3 x =
      glm::normalize(glm::cross(std::abs(z.x) < 0.9 ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 1, 0), z));
  return {x, glm::cross(z, x), z};
}

/// Half the diagonal of the bounds at right angles to the vertical.
double HorizontalRadius(const Bounds& ws_bounds, const glm::dvec3& ws_up) {
  const glm::dvec3 diagonal = ws_bounds.max - ws_bounds.min;
  return 0.5 * glm::length(diagonal - ws_up * glm::dot(ws_up, diagonal));
}

/// How much a view shows: the share of pixels that see anything, up to where the sky shows enough, the spread
/// of distances in octaves, and a fine for walls before the nose.
double ViewScore(const VisibleSurface& surface, const glm::dvec3& ws_eye, double eye_height) {
  double count = 0.0;
  double close = 0.0;
  double sum = 0.0;
  double sum_of_squares = 0.0;
  for (size_t i = 0; i < surface.size(); ++i) {
    if (surface.primitive[i] == kNoPrimitive) continue;
    const double distance = glm::length(surface.ws_point[i] - ws_eye);
    const double octaves = std::log2(distance / eye_height);
    count += 1.0;
    close += distance < 0.7 * eye_height ? 1.0 : 0.0;
    sum += octaves;
    sum_of_squares += octaves * octaves;
  }
  if (count == 0.0) return -1.0;
  const double mean = sum / count;
  const double spread = std::sqrt(std::max(0.0, sum_of_squares / count - mean * mean));
  const auto pixels = static_cast<double>(surface.size());
  return std::min(count / pixels, 0.8) + 0.3 * spread - 3.0 * close / pixels;
}

}  // namespace

std::string_view LightPlacementName(LightPlacement placement) {
  return std::ranges::find(kPlacements, placement, [](const auto& p) { return p.first; })->second;
}

std::optional<LightPlacement> LightPlacementFromName(std::string_view name) {
  const auto* found = std::ranges::find(kPlacements, name, [](const auto& p) { return p.second; });
  if (found == std::end(kPlacements)) return std::nullopt;
  return found->first;
}

std::vector<Light> PlaceLights(LightPlacement placement, int count, uint64_t seed, const Bounds& ws_bounds,
                               const glm::dvec3& ws_up) {
  const glm::dmat3 axes = AxesAround(ws_up);
  const double radius = HorizontalRadius(ws_bounds, axes[2]);
  const glm::dvec3 center = ws_bounds.Center();
  const glm::dvec3 extent = glm::abs(glm::transpose(axes) * (ws_bounds.max - ws_bounds.min));
  const glm::dvec3 foot = center - 0.5 * extent.z * axes[2];
  std::vector<Light> lights;
  for (int i = 0; i < count; ++i) {
    Random random(seed * 0x9e3779b97f4a7c15u + static_cast<uint64_t>(i));
    if (placement == LightPlacement::kInside) {
      const double x = random.Uniform(-0.45, 0.45);
      const double y = random.Uniform(-0.45, 0.45);
      const double z = random.Uniform(0.0, 0.45);
      lights.emplace_back(PointLight{center + axes * (extent * glm::dvec3(x, y, z))});
      continue;
    }
    // Equal heights cut equal areas from a sphere (Archimedes).
    const double height = random.Uniform(std::sin(std::numbers::pi / 180.0), 1.0);
    const double angle = random.Uniform(0.0, 2.0 * std::numbers::pi);
    const double across = std::sqrt(1.0 - height * height);
    const glm::dvec3 up = axes * glm::dvec3(across * std::cos(angle), across * std::sin(angle), height);
    switch (placement) {
      case LightPlacement::kNear:
        lights.emplace_back(PointLight{foot + 1.2 * radius * up});
        break;
      case LightPlacement::kDistant:
        lights.emplace_back(PointLight{foot + 5.0 * radius * up});
        break;
      default:
        lights.emplace_back(DirectionalLight{-up});
    }
  }
  return lights;
}

CameraMatrices CameraAt(const StandPoint& stand_point, const Bounds& ws_bounds, const ViewOptions& options) {
  CameraMatrices matrices;
  matrices.view_from_world = glm::lookAtRH(stand_point.ws_eye, stand_point.ws_target, options.ws_up);
  const double far = options.far > 0.0
                         ? options.far
                         : std::max(4.0 * HorizontalRadius(ws_bounds, options.ws_up), 2.0 * options.near);
  matrices.clip_from_view = glm::perspectiveRH_NO(options.vertical_fov, options.aspect, options.near, far);
  return matrices;
}

std::vector<StandPoint> FindStandPoints(const TruthScene& scene, int count, uint64_t seed,
                                        const ViewOptions& options) {
  constexpr int kPlacesAView = 12;
  constexpr int kAttemptsAView = 400;
  constexpr int kDirections = 12;
  constexpr int kPreview = 24;
  std::vector<StandPoint> found;
  const Bounds& bounds = scene.ws_bounds();
  if (bounds.empty()) return found;
  const glm::dmat3 axes = AxesAround(options.ws_up);
  const glm::dvec3 extent = glm::abs(glm::transpose(axes) * (bounds.max - bounds.min));
  for (int view = 0; view < count; ++view) {
    Random random(seed * 0xd1342543de82ef95u + static_cast<uint64_t>(view));
    std::optional<StandPoint> best;
    double best_score = 0.0;
    int places = 0;
    for (int attempt = 0; attempt < kAttemptsAView && places < kPlacesAView; ++attempt) {
      // From a random height, so that floors under roofs are found too.
      const double x = random.Uniform(-0.3, 0.3);
      const double y = random.Uniform(-0.3, 0.3);
      const double z = random.Uniform(-0.5, 0.5);
      const glm::dvec3 start = bounds.Center() + axes * (extent * glm::dvec3(x, y, z));
      const auto floor = scene.FirstHit(start + 1e-6 * extent.z * axes[2], -axes[2]);
      if (!floor || glm::dot(floor->ws_normal, axes[2]) < 0.8) continue;
      const glm::dvec3 ws_eye = floor->ws_point + options.eye_height * axes[2];
      bool is_clear = true;
      for (int i = 0; i < 8 && is_clear; ++i) {
        const double angle = i * std::numbers::pi / 4.0;
        const auto wall = scene.FirstHit(ws_eye, std::cos(angle) * axes[0] + std::sin(angle) * axes[1]);
        is_clear = !wall || wall->distance > 0.4 * options.eye_height;
      }
      if (!is_clear) continue;
      ++places;
      for (int i = 0; i < kDirections; ++i) {
        const double angle = (i + 0.5) * 2.0 * std::numbers::pi / kDirections;
        const glm::dvec3 ahead = std::cos(angle) * axes[0] + std::sin(angle) * axes[1] - 0.07 * axes[2];
        const StandPoint stand_point{ws_eye, ws_eye + ahead};
        const absl::StatusOr<Camera> camera = Camera::Create(CameraAt(stand_point, bounds, options));
        if (!camera.ok()) continue;
        const double score =
            ViewScore(scene.RenderSurface(*camera, kPreview, kPreview), ws_eye, options.eye_height);
        if (score > best_score) {
          best_score = score;
          best = stand_point;
        }
      }
    }
    if (best) found.push_back(*best);
  }
  return found;
}

}  // namespace shadowfit
