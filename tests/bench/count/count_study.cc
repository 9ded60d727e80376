// Is there a better map beside the default's? A descent on the count of wrong pixels itself, which needs the
// truth and some hundred shadow maps a light, looks for one:
//
//   study_count [scene [placement [lights [evaluations [aspect]]]]]       (plaza near 24 150 0)
//
// NLopt's Nelder-Mead moves the map's axis (two numbers), the shape of its texels (two; with aspect 1 their
// proportions at an equal number of texels, too), the map always being the smallest that holds what the
// default's must hold: the samples in shadow with their footprints. The count jumps with every texel that
// moves, and a descent finds what a certain grid of texels happens to get right. So it gets the mean of two
// offsets of the texels, and is judged by four others.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <nlopt.hpp>
#include <optional>
#include <string>
#include <vector>

#include "core/fit/frame_optimizer.h"
#include "core/frame/frame_sampler.h"
#include "core/reference/study_setup.h"
#include "core/reference/view_study.h"
#include "tests/support/study_scene.h"

namespace shadowfit {
namespace {

constexpr MapSize kScreen{750, 750};
constexpr MapSize kSamples{180, 180};
constexpr MapSize kMap{400, 400};

/// Offsets of the texels, of their side.
using Offsets = std::vector<glm::dvec2>;
const Offsets kSearched = {{-0.5, -0.5}, {-0.13, 0.21}};
const Offsets kJudged = {{-0.37, -0.21}, {0.09, 0.33}, {0.27, -0.39}, {0.41, 0.17}};

/// One light's counts, and maps around that of the default method.
class LightCounts {
 public:
  LightCounts(const TruthScene& truth, const ViewStudy& view, const LightStudy& light, bool free_aspect)
      : truth_(truth), view_(view), light_(light), free_aspect_(free_aspect) {}

  /// The method's own map; none where it needs several or has nothing to fit.
  std::optional<ShadowProjection> Fit(Method method) const {
    const FrameRequest request = testing::RequestFor(truth_, view_, light_, kMap);
    Options options;
    options.method = method;
    options.standard.free_aspect = free_aspect_;
    options.standard.divide_where_needed = false;
    options.standard.hold_all_shadow = true;
    FrameSummary summary;
    if (!FrameOptimizer().Optimize(request, options, Cancellation(), &summary).ok()) return std::nullopt;
    if (summary.lights[0].outcome != FitOutcome::kFitted) return std::nullopt;
    return summary.lights[0].projection;
  }

  double Count(const ShadowProjection& map, const Offsets& offsets) const {
    double sum = 0.0;
    for (const glm::dvec2& offset : offsets) {
      glm::dmat3 shift(1.0);
      shift[2] = {offset, 1.0};
      ShadowProjection shifted = map;
      shifted.texel_from_ray = shift * map.texel_from_ray;
      const absl::StatusOr<int> wrong = WrongPixels(truth_, view_, light_, {&shifted, 1});
      sum += wrong.ok() ? *wrong : kNoMap;
    }
    return sum / static_cast<double>(offsets.size());
  }

  /// The best map that the descent found from `start` on.
  ShadowProjection Descend(const ShadowProjection& start, int evaluations) {
    SampleHull();
    const int parameters = free_aspect_ ? 5 : 4;
    nlopt::opt search(nlopt::LN_NELDERMEAD, static_cast<unsigned>(parameters));
    search.set_maxeval(evaluations);
    search.set_initial_step(std::vector<double>(static_cast<size_t>(parameters), 0.12));
    auto count_at = [&](const std::vector<double>& at) {
      const std::optional<ShadowProjection> map = MapAt(start, at);
      return map ? Count(*map, kSearched) : kNoMap;
    };
    search.set_min_objective([](const std::vector<double>& at, std::vector<double>& /*gradient*/,
                                void* function) { return (*static_cast<decltype(count_at)*>(function))(at); },
                             &count_at);
    std::vector<double> at(static_cast<size_t>(parameters), 0.0);
    double least = 0.0;
    search.optimize(at, least);
    return MapAt(start, at).value_or(start);
  }

 private:
  static constexpr double kNoMap = 1e9;

  void SampleHull() {
    FrameExtent extent;
    std::vector<LightSamples> samples;
    FrameSampler().Sample(view_.camera, view_.samples.Depth(), light_.Bits(view_), {&light_.ray_space, 1},
                          kScreen, &extent, &samples);
    for (size_t i = 0; i < samples[0].hull_rays.size(); ++i) {
      if (samples[0].hull_in_shadow[i] == 0) continue;
      hull_.push_back(samples[0].hull_rays[i]);
      for (int corner = 0; corner < 4; ++corner) hull_.push_back(samples[0].FootprintCorner(i, corner));
    }
  }

  /// `start` with its axis tilted and its texels sheared, in coordinates that are -1 to 1 over it, and fitted
  /// to the hull again.
  std::optional<ShadowProjection> MapAt(const ShadowProjection& start, const std::vector<double>& at) const {
    glm::dmat3 normalized(1.0);
    normalized[0][0] = 2.0 / start.size.width;
    normalized[1][1] = 2.0 / start.size.height;
    normalized[2] = {-1.0, -1.0, 1.0};
    const glm::dmat3 bent({1.0, at[1], at[2]}, {at[0], 1.0, at[3]}, {0.0, 0.0, 1.0});
    const glm::dmat3 plane_from_ray = bent * normalized * start.texel_from_ray;
    glm::dvec2 low(1e300);
    glm::dvec2 high(-1e300);
    for (const glm::dvec3& ray : hull_) {
      const glm::dvec3 p = plane_from_ray * ray;
      if (!(p.z > 0.0)) return std::nullopt;
      low = glm::min(low, glm::dvec2(p) / p.z);
      high = glm::max(high, glm::dvec2(p) / p.z);
    }
    if (!(high.x > low.x && high.y > low.y)) return std::nullopt;
    ShadowProjection map = start;
    if (free_aspect_) {
      map.size.width = std::clamp(static_cast<int>(std::lround(start.size.width * std::exp(at[4]))), 1,
                                  static_cast<int>(kMap.texels()));
      map.size.height = static_cast<int>(kMap.texels()) / map.size.width;
    }
    const glm::dvec2 scale = glm::dvec2(map.size.width, map.size.height) / (high - low);
    const glm::dmat3 texel_from_plane({scale.x, 0.0, 0.0}, {0.0, scale.y, 0.0}, {-low * scale, 1.0});
    map.texel_from_ray = texel_from_plane * plane_from_ray;
    return map;
  }

  const TruthScene& truth_;
  const ViewStudy& view_;
  const LightStudy& light_;
  const bool free_aspect_;
  std::vector<glm::dvec3> hull_;
};

int Run(const std::string& scene_name, LightPlacement placement, int lights, int evaluations, bool aspect) {
  const absl::StatusOr<TruthScene> truth = testing::LoadTruth(scene_name);
  if (!truth.ok()) {
    std::fprintf(stderr, "%s\n", truth.status().ToString().c_str());
    return 1;
  }
  const ViewOptions view_options;
  std::vector<StandPoint> stand_points = FindStandPoints(*truth, 1, 1, view_options);
  if (const std::optional<StandPoint> own = ProceduralStandPoint(scene_name)) stand_points = {*own};
  if (stand_points.empty()) {
    std::fprintf(stderr, "%s: no floor to stand on\n", scene_name.c_str());
    return 1;
  }
  const absl::StatusOr<Camera> camera =
      Camera::Create(CameraAt(stand_points[0], truth->ws_bounds(), view_options));
  if (!camera.ok()) {
    std::fprintf(stderr, "%s\n", camera.status().ToString().c_str());
    return 1;
  }
  const ViewStudy view = ViewStudy::Create(*truth, *camera, kScreen, kSamples);

  std::printf(
      "wrong pixels, mean of four offsets of the texels: light, paper, default, descent on the count\n");
  std::array<double, 3> sums{};
  for (const Light& light : PlaceLights(placement, lights, 1, truth->ws_bounds(), view_options.ws_up)) {
    const absl::StatusOr<LightStudy> study = LightStudy::Create(*truth, view, light);
    if (!study.ok()) continue;
    LightCounts counts(*truth, view, *study, aspect);
    const std::optional<ShadowProjection> paper = counts.Fit(Method::kPaper);
    const std::optional<ShadowProjection> standard = counts.Fit(Method::kDefault);
    if (!paper || !standard) continue;
    const std::array<double, 3> counted = {counts.Count(*paper, kJudged), counts.Count(*standard, kJudged),
                                           counts.Count(counts.Descend(*standard, evaluations), kJudged)};
    std::printf("%8.0f %8.0f %8.0f\n", counted[0], counted[1], counted[2]);
    std::fflush(stdout);
    for (size_t k = 0; k < sums.size(); ++k) sums[k] += counted[k];
  }
  std::printf("all: paper %.0f, default %+.1f %%, descent on the count %+.1f %%\n", sums[0],
              100.0 * (sums[1] / sums[0] - 1.0), 100.0 * (sums[2] / sums[0] - 1.0));
  return 0;
}

}  // namespace
}  // namespace shadowfit

int main(int argc, char** argv) {
  const std::string scene = argc > 1 ? argv[1] : "plaza";
  const std::string placement_name = argc > 2 ? argv[2] : "near";
  const auto placement = shadowfit::LightPlacementFromName(placement_name);
  const int lights = argc > 3 ? std::atoi(argv[3]) : 24;
  const int evaluations = argc > 4 ? std::atoi(argv[4]) : 150;
  const bool aspect = argc > 5 && std::atoi(argv[5]) != 0;
  if (!placement || lights < 1 || evaluations < 1) {
    std::fprintf(stderr,
                 "placement %s: near, distant, directional or inside; lights and evaluations: at least 1\n",
                 placement_name.c_str());
    return 2;
  }
  return shadowfit::Run(scene, *placement, lights, evaluations, aspect);
}
