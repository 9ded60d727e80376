// Which neighbouring samples with different bits stand for wrong pixels, against Embree:
//
//   study_edges [scene [placement [lights [views]]]]       (plaza near 24 12)
//
// Every crossing, a shadowed sample beside one that is not, is put into a class: whether the surface goes on
// (continuous) or not, what the other sample is (lit; facing away from the light, so that its bit means
// nothing; at a terminator), whether anything lit is seen around the first one, and how many of its
// neighbours go on with its surface in the same light. Wrong pixels of the default method's map are counted
// in the square of one sample around each crossing, shared where squares overlap, and set beside what the
// `edge` metric expects there if the crossing is an edge. The ratios of a class to those of "continuous, lit"
// are the sampler's chances.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <string>
#include <vector>

#include "core/fit/frame_optimizer.h"
#include "core/fit/metric.h"
#include "core/reference/shadow_map_test.h"
#include "core/reference/study_setup.h"
#include "core/reference/view_study.h"
#include "tests/support/study_scene.h"

namespace shadowfit {
namespace {

constexpr int kScreen = 750;
constexpr int kSamples = 180;
constexpr double kPixelsPerSample = static_cast<double>(kScreen) / kSamples;
constexpr MapSize kMap{400, 400};

struct Class {
  double crossings = 0.0;
  double expected = 0.0;  ///< Pixels, were they all edges.
  double wrong = 0.0;
};

/// A class's crossing and the pixels, [x, x + size) by [y, y + size), around it.
struct Crossing {
  std::string name;
  int x = 0, y = 0;
  double expected = 0.0;
};
constexpr int kSquare = 4;

/// One light's samples with all that is known of them.
class SampleField {
 public:
  SampleField(const Camera& camera, const ViewStudy& view, const LightStudy& light)
      : camera_(camera), surface_(view.samples), light_(light), cosine_(surface_.size(), -1.0) {
    for (size_t i = 0; i < surface_.size(); ++i) {
      if (!Visible(i)) continue;
      const auto ray = light.ray_space.WorldRay(light.ray_space.RayFromPoint(surface_.ws_point[i]));
      cosine_[i] = -glm::dot(glm::normalize(ray.direction), surface_.ws_normal[i]);
    }
  }

  std::vector<Crossing> Crossings(const ShadowProjection& map) const {
    std::vector<Crossing> crossings;
    for (int y = 1; y + 1 < kSamples; ++y) {
      for (int x = 1; x + 1 < kSamples; ++x) {
        const size_t here = At(x, y);
        if (!Towards(here) || !Shadowed(here)) continue;
        const std::array<size_t, 4> beside = {At(x - 1, y), At(x + 1, y), At(x, y - 1), At(x, y + 1)};
        int supports = 0;
        for (const size_t k : beside) supports += Continuous(here, k) && Shadowed(k) ? 1 : 0;
        for (size_t k = 0; k < 4; ++k) {
          if (!Visible(beside[k]) || Shadowed(beside[k])) continue;
          Crossing crossing;
          crossing.name = NameOf(x, y, here, beside[k]) + ", supports " + std::to_string(supports);
          // The middle of the two samples.
          const double mx = x + 0.5 + (k == 0 ? -0.5 : k == 1 ? 0.5 : 0.0);
          const double my = y + 0.5 + (k == 2 ? -0.5 : k == 3 ? 0.5 : 0.0);
          crossing.x = static_cast<int>(mx * kPixelsPerSample) - kSquare / 2;
          crossing.y = static_cast<int>(my * kPixelsPerSample) - kSquare / 2;
          crossing.expected = Expected(x, y, k < 2 ? glm::dvec2(1, 0) : glm::dvec2(0, 1), map);
          crossings.push_back(crossing);
        }
      }
    }
    return crossings;
  }

 private:
  static size_t At(int x, int y) { return static_cast<size_t>(y) * kSamples + static_cast<size_t>(x); }
  bool Visible(size_t i) const { return surface_.primitive[i] != kNoPrimitive; }
  bool Shadowed(size_t i) const { return (light_.bits[i] & 1u) != 0; }
  bool Towards(size_t i) const { return cosine_[i] > 0.0005; }
  bool Continuous(size_t a, size_t b) const {
    if (!Visible(a) || !Visible(b)) return false;
    const glm::dvec3 step = surface_.ws_point[b] - surface_.ws_point[a];
    const double off = std::min(std::abs(glm::dot(surface_.ws_normal[a], step)),
                                std::abs(glm::dot(surface_.ws_normal[b], step)));
    return off < 0.3 * glm::length(step) + 1e-9;
  }

  std::string NameOf(int x, int y, size_t here, size_t other) const {
    const bool continuous = Continuous(here, other);
    std::string name = continuous ? "continuous, " : "discontinuous, ";
    if (!Towards(other)) {
      bool lit = false;
      for (int dy = -1; dy <= 1; ++dy) {
        for (int dx = -1; dx <= 1; ++dx) {
          const size_t near = At(x + dx, y + dy);
          lit = lit || (Visible(near) && Towards(near) && !Shadowed(near));
        }
      }
      return name + (lit ? "away, some lit" : "away, none lit");
    }
    if (continuous && 2.0 * cosine_[here] - cosine_[other] <= 0.0) return name + "terminator";
    return name + "lit";
  }

  /// The `edge` metric of an edge across one pair of samples.
  double Expected(int x, int y, const glm::dvec2& normal, const ShadowProjection& map) const {
    const size_t i = At(x, y);
    // Where the rays of nearby screen points meet the sample's plane.
    const auto ray_at = [&](double sx, double sy) {
      const glm::dvec2 ndc(2.0 * sx / kSamples - 1.0, 2.0 * sy / kSamples - 1.0);
      const glm::dvec4 near = camera_.WsFromNdc({ndc, -1.0});
      const glm::dvec4 far = camera_.WsFromNdc({ndc, 0.9});
      const glm::dvec3 origin = glm::dvec3(near) / near.w;
      const glm::dvec3 direction = glm::dvec3(far) / far.w - origin;
      const double t = glm::dot(surface_.ws_normal[i], surface_.ws_point[i] - origin) /
                       glm::dot(surface_.ws_normal[i], direction);
      return light_.ray_space.RayFromPoint(origin + t * direction);
    };
    constexpr double kStep = 1e-3;
    const glm::dvec2 s(x + 0.5, y + 0.5);
    const double scale = 1.0 / (2.0 * kStep * kPixelsPerSample);
    BoundarySamples edge;
    edge.Add(ray_at(s.x, s.y), scale * (ray_at(s.x + kStep, s.y) - ray_at(s.x - kStep, s.y)),
             scale * (ray_at(s.x, s.y + kStep) - ray_at(s.x, s.y - kStep)), 0.0, normal, kPixelsPerSample);
    // Squares hold no more wrong pixels than they have.
    return std::min(EdgeMetricOfSample(edge, 0, map.texel_from_ray), double(kSquare * kSquare));
  }

  const Camera& camera_;
  const VisibleSurface& surface_;
  const LightStudy& light_;
  std::vector<double> cosine_;
};

int Run(int argc, char** argv) {
  const std::string scene_name = argc > 1 ? argv[1] : "plaza";
  const auto placement = LightPlacementFromName(argc > 2 ? argv[2] : "near");
  const int light_count = argc > 3 ? std::atoi(argv[3]) : 24;
  const int view_count = argc > 4 ? std::atoi(argv[4]) : 12;
  if (!placement || light_count < 1 || view_count < 1) {
    std::fprintf(stderr, "study_edges [scene [near|distant|directional|inside [lights [views]]]]\n");
    return 2;
  }
  const absl::StatusOr<TruthScene> truth = testing::LoadTruth(scene_name);
  if (!truth.ok()) {
    std::fprintf(stderr, "%s\n", truth.status().ToString().c_str());
    return 1;
  }
  const ViewOptions view_options;
  std::vector<Camera> cameras;
  std::vector<ViewStudy> views;
  for (const StandPoint& stand_point : FindStandPoints(*truth, view_count, 1, view_options)) {
    const absl::StatusOr<Camera> camera =
        Camera::Create(CameraAt(stand_point, truth->ws_bounds(), view_options));
    if (!camera.ok()) continue;
    cameras.push_back(*camera);
    views.push_back(ViewStudy::Create(*truth, *camera, {kScreen, kScreen}, {kSamples, kSamples}));
  }
  if (views.empty()) {
    std::fprintf(stderr, "%s: no floor to stand on\n", scene_name.c_str());
    return 1;
  }

  std::map<std::string, Class> classes;
  double all_wrong = 0.0;
  double wrong_beside = 0.0;
  const std::vector<Light> lights =
      PlaceLights(*placement, light_count, 1, truth->ws_bounds(), view_options.ws_up);
  for (size_t i = 0; i < lights.size(); ++i) {
    const Camera& camera = cameras[i % cameras.size()];
    const ViewStudy& view = views[i % views.size()];
    const absl::StatusOr<LightStudy> study = LightStudy::Create(*truth, view, lights[i]);
    if (!study.ok()) continue;
    const FrameRequest request = testing::RequestFor(*truth, view, *study, kMap);
    Options options;
    options.standard.divide_where_needed = false;
    options.standard.hold_all_shadow = true;
    FrameSummary summary;
    if (!FrameOptimizer().Optimize(request, options, Cancellation(), &summary).ok()) continue;
    const ShadowProjection& map = summary.lights[0].projection;
    const absl::StatusOr<ShadowMask> mask =
        ShadowFromMaps(*truth, view.screen, study->screen, study->ray_space, {&map, 1});
    if (!mask.ok()) continue;

    const std::vector<Crossing> crossings = SampleField(camera, view, *study).Crossings(map);
    const auto for_square = [](const Crossing& crossing, const auto& visit) {
      for (int y = std::max(0, crossing.y); y < std::min(kScreen, crossing.y + kSquare); ++y) {
        for (int x = std::max(0, crossing.x); x < std::min(kScreen, crossing.x + kSquare); ++x) {
          visit(static_cast<size_t>(y) * kScreen + static_cast<size_t>(x));
        }
      }
    };
    std::vector<int> squares(study->screen.size(), 0);
    for (const Crossing& crossing : crossings) for_square(crossing, [&](size_t pixel) { ++squares[pixel]; });
    for (const Crossing& crossing : crossings) {
      Class& its = classes[crossing.name];
      its.crossings += 1.0;
      its.expected += crossing.expected;
      for_square(crossing, [&](size_t pixel) {
        if (study->screen[pixel] != (*mask)[pixel]) its.wrong += 1.0 / squares[pixel];
      });
    }
    for (size_t pixel = 0; pixel < squares.size(); ++pixel) {
      if (study->screen[pixel] == (*mask)[pixel]) continue;
      all_wrong += 1.0;
      wrong_beside += squares[pixel] > 0 ? 1.0 : 0.0;
    }
  }
  std::printf("%s, %zu lights in %zu views: %.0f wrong pixels, %.0f %% of them beside crossings\n",
              scene_name.c_str(), lights.size(), views.size(), all_wrong,
              100.0 * wrong_beside / std::max(1.0, all_wrong));
  std::printf("%-48s %10s %10s %10s %16s\n", "crossing", "number", "expected", "wrong", "wrong/expected");
  for (const auto& [name, its] : classes) {
    std::printf("%-48s %10.0f %10.0f %10.0f %16.2f\n", name.c_str(), its.crossings, its.expected, its.wrong,
                its.wrong / its.expected);
  }
  return 0;
}

}  // namespace
}  // namespace shadowfit

int main(int argc, char** argv) { return shadowfit::Run(argc, argv); }
