// Time of every baseline, and of the paper's optimizer beside them, for one light of the plaza seen through
// 180x180 samples. Sampling, which all methods share, is timed on its own.
//
// Repetitions of all benchmarks are interleaved at random, so that a busy moment of the machine does not fall
// on one method: read the medians, and their ratios.

#include <benchmark/benchmark.h>

#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "core/fit/method_factory.h"
#include "core/frame/frame_sampler.h"
#include "core/reference/study_setup.h"
#include "core/reference/view_study.h"
#include "core/scene/procedural.h"

namespace shadowfit {
namespace {

constexpr MapSize kScreen{750, 750};
constexpr MapSize kSamples{180, 180};
constexpr MapSize kMap{400, 400};

/// One light's problem with all that it borrows.
struct Prepared {
  std::string name;
  Light light;
  std::vector<RaySpace> ray_spaces;
  std::vector<uint32_t> bits;
  std::vector<LightSamples> samples;
  FrameExtent extent;
  LightProblem problem;
};

struct Study {
  ViewStudy view;
  std::vector<std::unique_ptr<Prepared>> lights;
};

absl::StatusOr<Study> MakeStudy() {
  absl::StatusOr<Scene> scene = MakePlaza(100'000);
  if (!scene.ok()) return scene.status();
  const absl::StatusOr<TruthScene> truth = TruthScene::Create(*scene);
  if (!truth.ok()) return truth.status();
  absl::StatusOr<Camera> camera =
      Camera::Create(CameraAt(PlazaStandPoint(), truth->ws_bounds(), ViewOptions{}));
  if (!camera.ok()) return camera.status();
  Study study{ViewStudy::Create(*truth, *camera, kScreen, kSamples), {}};
  const std::pair<const char*, Light> lights[] = {
      {"point", PointLight{{30.0, -60.0, 80.0}}},
      {"spot", SpotLight{{10.0, 8.0, 14.0}, {-10.0, -8.0, -14.0}, 0.7}},
      {"directional", DirectionalLight{{-0.4, 0.5, -0.7}}},
  };
  for (const auto& [name, light] : lights) {
    absl::StatusOr<LightStudy> light_study = LightStudy::Create(*truth, study.view, light);
    if (!light_study.ok()) return light_study.status();
    auto prepared = std::make_unique<Prepared>();
    prepared->name = name;
    prepared->light = light;
    prepared->ray_spaces.push_back(light_study->ray_space);
    prepared->bits = std::move(light_study->bits);
    FrameSampler().Sample(study.view.camera, study.view.samples.Depth(),
                          BottomFirst(prepared->bits.data(), kSamples.width, kSamples.height),
                          prepared->ray_spaces, kScreen, &prepared->extent, &prepared->samples);
    LightProblem& problem = prepared->problem;
    problem.light = &prepared->light;
    problem.ray_space = prepared->ray_spaces.data();
    problem.samples = prepared->samples.data();
    problem.map_size = kMap;
    problem.nearest_ndc_depth = prepared->extent.nearest_ndc_depth;
    problem.farthest_ndc_depth = prepared->extent.farthest_ndc_depth;
    problem.ws_scene_bounds = truth->ws_bounds();
    study.lights.push_back(std::move(prepared));
  }
  return study;
}

void BenchFit(benchmark::State& state, const Prepared& prepared, Method method) {
  Options options;
  options.method = method;
  const std::unique_ptr<LightMatrixMethod> fitter = MakeMethod(options);
  bool fallback = false;
  while (state.KeepRunning()) {
    absl::StatusOr<LightFit> fit = fitter->Fit(prepared.problem);
    if (!fit.ok()) {
      state.SkipWithError(std::string(fit.status().message()).c_str());
      break;
    }
    fallback = fit->outcome == FitOutcome::kFallback;
    benchmark::DoNotOptimize(fit->projection);
  }
  state.counters["boundary"] = static_cast<double>(prepared.samples[0].boundary.size());
  state.counters["hull"] = static_cast<double>(prepared.samples[0].hull_rays.size());
  state.counters["fallback"] = fallback ? 1.0 : 0.0;
}

void BenchSampling(benchmark::State& state, const ViewStudy& view, const Prepared& prepared) {
  FrameSampler sampler;
  FrameExtent extent;
  std::vector<LightSamples> samples;
  while (state.KeepRunning()) {
    sampler.Sample(view.camera, view.samples.Depth(),
                   BottomFirst(prepared.bits.data(), kSamples.width, kSamples.height), prepared.ray_spaces,
                   kScreen, &extent, &samples);
    benchmark::DoNotOptimize(samples.data());
  }
}

int Run(int argc, char** argv) {
  absl::StatusOr<Study> study = MakeStudy();
  if (!study.ok()) {
    std::fprintf(stderr, "%s\n", std::string(study.status().message()).c_str());
    return 1;
  }
  for (const std::unique_ptr<Prepared>& light : study->lights) {
    light->problem.camera = &study->view.camera;
    benchmark::RegisterBenchmark(
        (light->name + "/sampling").c_str(),
        [&study, &light](benchmark::State& state) { BenchSampling(state, study->view, *light); });
    for (const Method method : {Method::kNormal, Method::kFocused, Method::kLispsm, Method::kPlaneOptimal,
                                Method::kSphereStable, Method::kPaper}) {
      benchmark::RegisterBenchmark(
          (light->name + "/" + std::string(MethodName(method))).c_str(),
          [&light, method](benchmark::State& state) { BenchFit(state, *light, method); });
    }
  }
  // Defaults that the command line can override.
  std::vector<std::string> arguments = {argv[0],
                                        "--benchmark_enable_random_interleaving=true",
                                        "--benchmark_repetitions=7",
                                        "--benchmark_min_time=0.02",
                                        "--benchmark_report_aggregates_only=true",
                                        "--benchmark_time_unit=us"};
  arguments.insert(arguments.end(), argv + 1, argv + argc);
  std::vector<char*> pointers;
  pointers.reserve(arguments.size());
  for (std::string& argument : arguments) pointers.push_back(argument.data());
  int count = static_cast<int>(pointers.size());
  benchmark::Initialize(&count, pointers.data());
  if (benchmark::ReportUnrecognizedArguments(count, pointers.data())) return 1;
  benchmark::RunSpecifiedBenchmarks();
  return 0;
}

}  // namespace
}  // namespace shadowfit

int main(int argc, char** argv) { return shadowfit::Run(argc, argv); }
