// What the texel budget saves and whether tolerances hold, against Embree, on the plaza:
//
//   bench_budget [triangles [lights of each kind [frames of 16 lights]]]
//
// Budget: frames of 16 lights of very different importance (a sun, lamps all around, spots over the ground
// near and far), 160,000 texels for each light on average: true wrong pixels with equal sizes and with shared
// ones.
//
// Tolerance: each light alone, with the smallest map that is expected to get at most N pixels wrong, for N of
// 0.2 to 2 % of the screen: in how many lights the count stays below N, and the factor on the prediction with
// which nine in ten would.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "core/budget/texel_budget.h"
#include "core/fit/frame_optimizer.h"
#include "core/reference/study_setup.h"
#include "core/reference/view_study.h"
#include "core/scene/procedural.h"

namespace shadowfit {
namespace {

constexpr MapSize kScreen{750, 750};
constexpr MapSize kSamples{180, 180};
constexpr MapSize kMap{400, 400};

double Uniform(std::mt19937& random, double low, double high) {
  return low + (high - low) * (static_cast<double>(random()) / 4294967296.0);
}

struct Study {
  TruthScene truth;
  Camera camera;
  ViewStudy view;
};

absl::StatusOr<std::unique_ptr<Study>> MakeStudy(int triangles) {
  absl::StatusOr<Scene> scene = MakePlaza(triangles);
  if (!scene.ok()) return scene.status();
  absl::StatusOr<TruthScene> truth = TruthScene::Create(*scene);
  if (!truth.ok()) return truth.status();
  absl::StatusOr<Camera> camera =
      Camera::Create(CameraAt(PlazaStandPoint(), truth->ws_bounds(), ViewOptions{}));
  if (!camera.ok()) return camera.status();
  ViewStudy view = ViewStudy::Create(*truth, *camera, kScreen, kSamples);
  return std::make_unique<Study>(Study{*std::move(truth), *camera, std::move(view)});
}

/// A sun, five lamps on the hemisphere and ten spots over the ground.
std::vector<Light> MixedLights(const Study& study, std::mt19937& random) {
  std::vector<Light> lights;
  for (const auto& [placement, count] :
       {std::pair(LightPlacement::kDirectional, 1), std::pair(LightPlacement::kNear, 5)}) {
    for (const Light& light : PlaceLights(placement, count, random(), study.truth.ws_bounds())) {
      lights.push_back(light);
    }
  }
  const Bounds& bounds = study.truth.ws_bounds();
  while (lights.size() < 16) {
    const glm::dvec3 ws_position(Uniform(random, bounds.min.x, bounds.max.x),
                                 Uniform(random, bounds.min.y, bounds.max.y), Uniform(random, 5.0, 14.0));
    const glm::dvec3 ws_direction(Uniform(random, -0.7, 0.7), Uniform(random, -0.7, 0.7), -1.0);
    lights.push_back(SpotLight{ws_position, ws_direction, Uniform(random, 0.25, 0.9)});
  }
  return lights;
}

struct PreparedFrame {
  std::vector<std::unique_ptr<LightStudy>> studies;
  std::vector<uint32_t> bits;
  FrameRequest request;
};

absl::StatusOr<PreparedFrame> Prepare(const Study& study, const std::vector<Light>& lights) {
  PreparedFrame frame;
  frame.request.camera = {study.camera.view_from_world(), study.camera.clip_from_view(),
                          study.camera.clip_depth()};
  frame.request.depth = study.view.samples.Depth();
  frame.request.screen = kScreen;
  frame.request.ws_scene_bounds = study.truth.ws_bounds();
  frame.bits.assign(study.view.samples.size(), 0);
  for (size_t i = 0; i < lights.size(); ++i) {
    absl::StatusOr<LightStudy> made = LightStudy::Create(study.truth, study.view, lights[i]);
    if (!made.ok()) return made.status();
    for (size_t pixel = 0; pixel < frame.bits.size(); ++pixel)
      frame.bits[pixel] |= (made->bits[pixel] & 1u) << i;
    frame.studies.push_back(std::make_unique<LightStudy>(*std::move(made)));
    LightRequest& light = frame.request.lights.emplace_back();
    light.id = static_cast<uint32_t>(i);
    light.light = lights[i];
    light.map_size = kMap;
  }
  frame.request.bits = BottomFirst(frame.bits.data(), kSamples.width, kSamples.height);
  return frame;
}

struct Outcome {
  double predicted = 0.0;
  std::vector<int> wrong;
  std::vector<double> predictions;
  std::vector<MapSize> sizes;
  double texels = 0.0;
  int total = 0;
  bool capped = false;  ///< Some tolerance is not reached.
};

absl::StatusOr<Outcome> Judge(const Study& study, const PreparedFrame& frame, const MapSizing& sizing) {
  Options options;
  options.sizing = sizing;
  FrameSummary summary;
  if (absl::Status status = FrameOptimizer().Optimize(frame.request, options, Cancellation(), &summary);
      !status.ok()) {
    return status;
  }
  Outcome outcome;
  for (size_t i = 0; i < summary.lights.size(); ++i) {
    const LightSummary& light = summary.lights[i];
    const absl::StatusOr<int> wrong =
        WrongPixels(study.truth, study.view, *frame.studies[i], {&light.projection, 1});
    if (!wrong.ok()) return wrong.status();
    outcome.wrong.push_back(*wrong);
    outcome.predictions.push_back(light.predicted_misclassified_pixels);
    outcome.sizes.push_back(light.projection.size);
    outcome.predicted += light.predicted_misclassified_pixels;
    outcome.texels += light.projection.size.texels();
    outcome.total += *wrong;
    outcome.capped = outcome.capped || !light.note.empty();
  }
  return outcome;
}

absl::Status StudyBudget(const Study& study, int frames) {
  std::printf("budget: 16 lights, %.0f texels in all, true wrong pixels\n\n", 16 * kMap.texels());
  std::printf("%5s %9s | %9s %6s | %9s %6s | %9s %6s\n", "frame", "equal", "exact", "", "x8", "", "2^n", "");
  std::mt19937 random(1);
  double equal_sum = 0.0;
  double shared_sum[3] = {};
  for (int f = 0; f < frames; ++f) {
    const absl::StatusOr<PreparedFrame> frame = Prepare(study, MixedLights(study, random));
    if (!frame.ok()) return frame.status();
    const absl::StatusOr<Outcome> equal = Judge(study, *frame, {});
    if (!equal.ok()) return equal.status();
    equal_sum += equal->total;
    std::printf("%5d %9d", f, equal->total);
    for (const SizeRounding rounding :
         {SizeRounding::kExact, SizeRounding::kMultipleOf8, SizeRounding::kPowerOfTwo}) {
      BudgetOptions budget;
      budget.total_texels = equal->texels;
      budget.sides.rounding = rounding;
      const absl::StatusOr<Outcome> shared = Judge(study, *frame, budget);
      if (!shared.ok()) return shared.status();
      shared_sum[static_cast<int>(rounding)] += shared->total;
      std::printf(" | %9d %+5.1f%%", shared->total, 100.0 * (double(shared->total) / equal->total - 1.0));
    }
    std::printf("\n");
    std::fflush(stdout);
  }
  std::printf("%5s %9.0f", "all", equal_sum);
  for (const double sum : shared_sum) std::printf(" | %9.0f %+5.1f%%", sum, 100.0 * (sum / equal_sum - 1.0));
  std::printf("\n\n");
  return absl::OkStatus();
}

absl::Status StudyTolerance(const Study& study, int lights) {
  std::printf("tolerance: shares of lights whose true wrong pixels stay below N\n\n");
  std::printf("%12s %6s %6s %7s %7s   %s\n", "kind", "N", "lights", "kept", "factor",
              "truth over prediction: median, 80 %, 90 %, 95 %, worst; median map side");
  std::vector<double> all_ratios;
  int all_kept = 0;
  for (const LightPlacement placement :
       {LightPlacement::kNear, LightPlacement::kDistant, LightPlacement::kDirectional}) {
    std::vector<PreparedFrame> frames;
    for (const Light& light : PlaceLights(placement, lights, 7, study.truth.ws_bounds())) {
      absl::StatusOr<PreparedFrame> frame = Prepare(study, {light});
      if (!frame.ok()) return frame.status();
      frames.push_back(*std::move(frame));
    }
    for (const double share : {0.002, 0.005, 0.01, 0.02}) {
      ToleranceOptions tolerance;
      tolerance.max_misclassified_pixels = share * kScreen.texels();
      std::vector<double> ratios;
      std::vector<double> sides;
      int kept = 0;
      for (PreparedFrame& frame : frames) {
        frame.request.bits = BottomFirst(frame.bits.data(), kSamples.width, kSamples.height);
        const absl::StatusOr<Outcome> outcome = Judge(study, frame, tolerance);
        if (!outcome.ok()) return outcome.status();
        // Nothing in shadow, or no map large enough.
        if (!(outcome->predictions[0] > 0.0) || outcome->capped) continue;
        ratios.push_back(outcome->wrong[0] / outcome->predictions[0]);
        sides.push_back(std::sqrt(outcome->sizes[0].texels()));
        kept += outcome->wrong[0] <= tolerance.max_misclassified_pixels;
      }
      all_kept += kept;
      if (ratios.empty()) continue;
      all_ratios.insert(all_ratios.end(), ratios.begin(), ratios.end());
      std::sort(ratios.begin(), ratios.end());
      std::sort(sides.begin(), sides.end());
      const auto quantile = [&](double q) {
        return ratios[std::min(ratios.size() - 1,
                               static_cast<size_t>(q * static_cast<double>(ratios.size())))];
      };
      std::printf("%12s %6.0f %6d %6.1f%% %7.2f   %.2f %.2f %.2f %.2f %.2f  %.0f\n",
                  std::string(LightPlacementName(placement)).c_str(), tolerance.max_misclassified_pixels,
                  int(ratios.size()), 100.0 * kept / static_cast<double>(ratios.size()), quantile(0.9),
                  quantile(0.5), quantile(0.8), quantile(0.9), quantile(0.95), ratios.back(),
                  sides[sides.size() / 2]);
      std::fflush(stdout);
    }
  }
  std::sort(all_ratios.begin(), all_ratios.end());
  std::printf("%12s %6s %6d %6.1f%% %7.2f\n", "all", "", int(all_ratios.size()),
              100.0 * all_kept / static_cast<double>(all_ratios.size()),
              all_ratios[all_ratios.size() * 9 / 10]);
  return absl::OkStatus();
}

/// Truth over prediction against the size of texels, by which ToleranceSafety() was fitted.
absl::Status StudySafety(const Study& study, int lights) {
  std::printf("prediction: truth over prediction by texel size (predicted over unit pixels)\n\n");
  struct Point {
    double texel = 0.0;
    double ratio = 0.0;
  };
  std::vector<Point> points;
  for (const LightPlacement placement :
       {LightPlacement::kNear, LightPlacement::kDistant, LightPlacement::kDirectional}) {
    for (const Light& light : PlaceLights(placement, lights, 11, study.truth.ws_bounds())) {
      absl::StatusOr<PreparedFrame> frame = Prepare(study, {light});
      if (!frame.ok()) return frame.status();
      frame->request.bits = BottomFirst(frame->bits.data(), kSamples.width, kSamples.height);
      for (int side = 200; side <= 3200; side *= 2) {
        frame->request.lights[0].map_size = {side, side};
        Options options;
        options.assess_quality = true;
        FrameSummary summary;
        absl::Status status = FrameOptimizer().Optimize(frame->request, options, Cancellation(), &summary);
        if (!status.ok()) return status;
        const LightSummary& fit = summary.lights[0];
        if (!(fit.predicted_misclassified_pixels > 0.0)) continue;
        const absl::StatusOr<int> wrong =
            WrongPixels(study.truth, study.view, *frame->studies[0], {&fit.projection, 1});
        if (!wrong.ok()) return wrong.status();
        points.push_back({fit.predicted_misclassified_pixels / fit.quality->unit_pixels,
                          *wrong / fit.predicted_misclassified_pixels});
      }
    }
  }
  std::sort(points.begin(), points.end(), [](const Point& a, const Point& b) { return a.texel < b.texel; });
  std::printf("%13s %7s  %s\n", "texel, pixels", "lights", "median, 80 %, 90 %, 95 %");
  constexpr size_t kBins = 8;
  for (size_t bin = 0; bin < kBins; ++bin) {
    const size_t begin = bin * points.size() / kBins;
    const size_t end = (bin + 1) * points.size() / kBins;
    if (begin == end) continue;
    std::vector<double> ratios;
    for (size_t i = begin; i < end; ++i) ratios.push_back(points[i].ratio);
    std::sort(ratios.begin(), ratios.end());
    const auto quantile = [&](double q) {
      return ratios[static_cast<size_t>(q * double(ratios.size() - 1))];
    };
    std::printf("%13.3f %7d  %.2f %.2f %.2f %.2f\n", points[(begin + end) / 2].texel, int(ratios.size()),
                quantile(0.5), quantile(0.8), quantile(0.9), quantile(0.95));
  }
  std::printf("\n");
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  const int triangles = argc > 1 ? std::atoi(argv[1]) : 300'000;
  const int lights = argc > 2 ? std::atoi(argv[2]) : 40;
  const int frames = argc > 3 ? std::atoi(argv[3]) : 5;
  const absl::StatusOr<std::unique_ptr<Study>> study = MakeStudy(triangles);
  absl::Status status = study.status();
  if (status.ok() && frames > 0) status = StudyBudget(**study, frames);
  if (status.ok() && lights > 0) status = StudySafety(**study, lights);
  if (status.ok() && lights > 0) status = StudyTolerance(**study, lights);
  if (!status.ok()) std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return status.ok() ? 0 : 1;
}

}  // namespace
}  // namespace shadowfit

int main(int argc, char** argv) { return shadowfit::Main(argc, argv); }
