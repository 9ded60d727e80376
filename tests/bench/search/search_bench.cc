// The default search for the axis beside NLopt's BOBYQA and DIRECT-L on the same objective and the same two
// variables: for lights of the plaza seen through 180x180 samples, the time and the evaluations that each
// takes to the value that the default search ends at (within 0.1 %), all three from the whitened samples on.
// And how far the default search is from the best matrix that there is, certified to 1 % (certify.h), and how
// long that proof takes.
//
//   bench_search [lights of each kind]
//
// The objective is EdgeFit::Evaluate over all samples, the best parallelogram at an axis; the variables chart
// the axes that see the hull, as the default search does, so that no constraint is left. BOBYQA starts where
// the default search starts, at the hull's centroid; DIRECT-L divides the square that the default search's
// rings span. Each ends at the value, or gives up after kMostEvaluations.
//
// Times are processor time of one thread, the least of three runs. Flops are those of gathering the covectors
// alone, 17 for each sample and evaluation, and so a lower bound; the peak beside them is measured.

#include <time.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <nlopt.hpp>
#include <string>
#include <vector>

#include "core/fit/axis_search.h"
#include "core/fit/certify.h"
#include "core/fit/edge_fit.h"
#include "core/fit/ray_hull.h"
#include "core/fit/rescale_previous.h"
#include "core/fit/whitened_samples.h"
#include "core/frame/frame_sampler.h"
#include "core/reference/study_setup.h"
#include "core/reference/view_study.h"
#include "core/scene/procedural.h"

namespace shadowfit {
namespace {

constexpr MapSize kScreen{750, 750};
constexpr MapSize kSamples{180, 180};
constexpr MapSize kMap{400, 400};
constexpr int kMostEvaluations = 3000;
constexpr double kFlopsPerSample = 17.0;

double ThreadSeconds() {
  timespec time{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

/// Single-precision multiplications and additions a second of one thread, in independent chains of vectors.
double PeakFlops() {
  constexpr int kChains = 12;
  constexpr int kLanes = 8;
  constexpr int kRounds = 2'000'000;
  std::array<std::array<float, kLanes>, kChains> values{};
  const double start = ThreadSeconds();
  for (int round = 0; round < kRounds; ++round) {
    for (auto& chain : values) {
      for (float& value : chain) value = value * 0.999f + 0.5f;
    }
  }
  const double seconds = ThreadSeconds() - start;
  volatile float sink = 0.0f;
  for (const auto& chain : values) sink = sink + chain[0];
  return 2.0 * kChains * kLanes * double(kRounds) / seconds;
}

struct Objective {
  EdgeFit* fit;
  const std::vector<glm::dvec2>* hull;
  double least = 1e300;

  static double Value(const std::vector<double>& y, std::vector<double>&, void* data) {
    auto* self = static_cast<Objective*>(data);
    // BOBYQA's quadratic models do not survive 1e300.
    const double cost = std::min(self->fit->Evaluate(AxisAt(*self->hull, {y[0], y[1]})).cost, 1e9);
    self->least = std::min(self->least, cost);
    return cost;
  }
};

struct Outcome {
  double seconds = 1e300;
  int evaluations = 0;
  double value = 0.0;
  ShadowProjection projection;
};

Outcome Minimize(nlopt::algorithm algorithm, const WhitenedSamples& samples, double target) {
  Outcome outcome;
  for (int run = 0; run < 3; ++run) {
    const double start = ThreadSeconds();
    EdgeFit fit(samples, kMap, false);
    Objective objective{&fit, &samples.hull};
    nlopt::opt optimizer(algorithm, 2);
    optimizer.set_lower_bounds(std::vector<double>{-3.0, -3.0});
    optimizer.set_upper_bounds(std::vector<double>{3.0, 3.0});
    optimizer.set_min_objective(&Objective::Value, &objective);
    optimizer.set_stopval(target);
    optimizer.set_maxeval(kMostEvaluations);
    optimizer.set_xtol_abs(1e-6);
    std::vector<double> y = {0.0, 0.0};
    double value = 0.0;
    try {
      optimizer.optimize(y, value);
    } catch (const std::exception&) {
      // Round-off ends BOBYQA on a crease; what it met counts.
    }
    outcome.seconds = std::min(outcome.seconds, ThreadSeconds() - start);
    outcome.evaluations = fit.evaluations();
    outcome.value = objective.least;
  }
  return outcome;
}

Outcome Default(const WhitenedSamples& probes, const WhitenedSamples& samples) {
  Outcome outcome;
  for (int run = 0; run < 3; ++run) {
    const double start = ThreadSeconds();
    const DefaultOptions options;
    AxisSearch search(probes, kMap, options);
    search.Survey(std::nullopt, std::numeric_limits<double>::infinity());
    const AxisSearchResult found = search.Descend(samples);
    outcome.seconds = std::min(outcome.seconds, ThreadSeconds() - start);
    outcome.evaluations = search.evaluations();
    outcome.projection = {WithUnitAxis(found.texel_from_whitened * samples.whitened_from_ray), found.size};
  }
  return outcome;
}

double Median(std::vector<double> values) {
  if (values.empty()) return 0.0;
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

absl::Status Bench(int lights) {
  absl::StatusOr<Scene> scene = MakePlaza(300'000);
  if (!scene.ok()) return scene.status();
  absl::StatusOr<TruthScene> truth = TruthScene::Create(*scene);
  if (!truth.ok()) return truth.status();
  const absl::StatusOr<Camera> camera =
      Camera::Create(CameraAt(PlazaStandPoint(), truth->ws_bounds(), ViewOptions{}));
  if (!camera.ok()) return camera.status();
  const ViewStudy view = ViewStudy::Create(*truth, *camera, kScreen, kSamples);
  const double peak = PeakFlops();
  std::printf("peak of this program's vectors: %.1f Gflop/s\n\n", peak * 1e-9);
  std::printf("%12s %7s | %9s %6s | %9s %6s %7s | %9s %6s %7s | %s\n", "kind", "samples", "default", "evals",
              "BOBYQA", "evals", "above", "DIRECT-L", "evals", "above", "gap to the best, certificate");
  std::vector<double> bobyqa_ratios;
  std::vector<double> direct_ratios;
  std::vector<double> shares;
  std::vector<double> least_gaps;
  std::vector<double> most_gaps;
  std::vector<double> certify_seconds;
  int uncertified = 0;
  int bobyqa_failed = 0;
  int direct_failed = 0;
  for (const LightPlacement placement :
       {LightPlacement::kNear, LightPlacement::kDistant, LightPlacement::kDirectional}) {
    for (const Light& light : PlaceLights(placement, lights, 5, truth->ws_bounds())) {
      const absl::StatusOr<LightStudy> study = LightStudy::Create(*truth, view, light);
      if (!study.ok()) return study.status();
      FrameSampler sampler;
      FrameExtent extent;
      std::vector<LightSamples> samples;
      sampler.Sample(*camera, view.samples.Depth(), study->Bits(view), {&study->ray_space, 1}, kScreen,
                     &extent, &samples);
      LightProblem problem;
      problem.camera = &*camera;
      problem.light = &light;
      problem.ray_space = &study->ray_space;
      problem.samples = samples.data();
      problem.map_size = kMap;
      problem.nearest_ndc_depth = extent.nearest_ndc_depth;
      problem.farthest_ndc_depth = extent.farthest_ndc_depth;
      problem.ws_scene_bounds = truth->ws_bounds();
      const RayHull hull = MakeFitHull(problem);
      const WhitenedSamples whitened = Whiten(problem, hull);
      const WhitenedSamples probes = WhitenSome(problem, hull, DefaultOptions{}.search_samples);
      Outcome standard = Default(probes, whitened);
      // All minimise the metric's tangent at the map that the search found.
      const WhitenedSamples tangent = TangentAt(
          whitened, *GridOf(standard.projection.texel_from_ray * glm::inverse(whitened.whitened_from_ray)));
      const double start = ThreadSeconds();
      const Certificate certificate =
          Certify(tangent, kMap, false, standard.projection, {0.01, 600.0}, Cancellation());
      certify_seconds.push_back(ThreadSeconds() - start);
      standard.value = certificate.cost;
      const double target = standard.value * 1.001;
      const Outcome bobyqa = Minimize(nlopt::LN_BOBYQA, tangent, target);
      const Outcome direct = Minimize(nlopt::GN_DIRECT_L, tangent, target);
      least_gaps.push_back(certificate.LeastGap());
      most_gaps.push_back(certificate.MostGap());
      uncertified += certificate.complete ? 0 : 1;
      const auto above = [&](const Outcome& outcome) {
        return 100.0 * (outcome.value / standard.value - 1.0);
      };
      std::printf(
          "%12s %7d | %6.3f ms %6d | %6.3f ms %6d %+6.2f%% | %6.3f ms %6d %+6.2f%% | "
          "%.2f to %.2f %%%s, %.2f s, %lld boxes\n",
          std::string(LightPlacementName(placement)).c_str(), int(whitened.x.size()), 1e3 * standard.seconds,
          standard.evaluations, 1e3 * bobyqa.seconds, bobyqa.evaluations, above(bobyqa), 1e3 * direct.seconds,
          direct.evaluations, above(direct), 100.0 * certificate.LeastGap(), 100.0 * certificate.MostGap(),
          certificate.complete ? "" : " (gave up)", certify_seconds.back(),
          static_cast<long long>(certificate.boxes));
      std::fflush(stdout);
      if (bobyqa.value <= target) {
        bobyqa_ratios.push_back(bobyqa.seconds / standard.seconds);
      } else {
        ++bobyqa_failed;
      }
      if (direct.value <= target) {
        direct_ratios.push_back(direct.seconds / standard.seconds);
      } else {
        ++direct_failed;
      }
      const double searched =
          std::min<double>(static_cast<double>(whitened.x.size()), DefaultOptions{}.search_samples);
      shares.push_back(kFlopsPerSample * searched * standard.evaluations / standard.seconds / peak);
    }
  }
  std::printf("\nBOBYQA: %.1f times the default's time in the median, %d of %d lights not to its value\n",
              Median(bobyqa_ratios), bobyqa_failed, 3 * lights);
  std::printf("DIRECT-L: %.1f times the default's time in the median, %d of %d lights not to its value\n",
              Median(direct_ratios), direct_failed, 3 * lights);
  std::printf(
      "certificate: gap at least %.2f %% in the median, %.2f %% at worst, at most %.2f %% and %.2f %%; %.2f "
      "s in the "
      "median, %.2f s at worst; %d of %d lights without\n",
      100.0 * Median(least_gaps), 100.0 * *std::max_element(least_gaps.begin(), least_gaps.end()),
      100.0 * Median(most_gaps), 100.0 * *std::max_element(most_gaps.begin(), most_gaps.end()),
      Median(certify_seconds), *std::max_element(certify_seconds.begin(), certify_seconds.end()), uncertified,
      3 * lights);
  std::printf("default: at least %.1f %% of peak in gathering alone\n", 100.0 * Median(shares));
  return absl::OkStatus();
}

}  // namespace
}  // namespace shadowfit

int main(int argc, char** argv) {
  const absl::Status status = shadowfit::Bench(argc > 1 ? std::atoi(argv[1]) : 10);
  if (!status.ok()) std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return status.ok() ? 0 : 1;
}
