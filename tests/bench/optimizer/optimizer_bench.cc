// Time from a decoded frame to a light matrix, one thread, one light of the plaza seen through 180x180
// samples: by the paper's optimizer and by the default one, with the number of boundary samples and of
// objective evaluations; and by the default one again with the answer for the same light one step of a walk
// before ("default_warm"; `kept` is 1 where that answer stays). Beside them the method `normal`, which has no
// optimizer; the samples alone, which all methods begin with; and the bare read of the two buffers, the least
// that any method can take. Then a frame of 32 lights on one thread and on two.
//
// Repetitions of all benchmarks are interleaved at random, so that a busy moment of the machine does not fall
// on one of them: read the medians, and their ratios.

#include <benchmark/benchmark.h>
#include <tbb/task_arena.h>

#include <cmath>
#include <cstdio>
#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include "core/fit/frame_optimizer.h"
#include "core/frame/frame_sampler.h"
#include "core/reference/study_setup.h"
#include "core/reference/view_study.h"
#include "core/scene/procedural.h"

namespace shadowfit {
namespace {

constexpr MapSize kScreen{750, 750};
constexpr MapSize kSamples{180, 180};
constexpr MapSize kMap{400, 400};

/// Between two frames: the demo's walk takes 48 frames for a tenth of a turn around what it looks at.
constexpr double kStepDegrees = 36.0 / 47.0;

/// One frame with the memory that its request borrows.
struct Prepared {
  std::string name;
  LightStudy study;
  FrameRequest request;
  FrameRequest warm_request;  ///< With the answer for the frame before.
};

struct Study {
  ViewStudy view;
  std::vector<std::unique_ptr<Prepared>> lights;
  std::vector<uint32_t> bits_of_all;
  FrameRequest all_lights;
};

/// 32 lights around the view: point lights and, every fourth, a sun.
std::vector<Light> LightsAround(const glm::dvec3& ws_center) {
  std::vector<Light> lights;
  for (int i = 0; i < kMaxLights; ++i) {
    // A golden angle apart, from low to high.
    const double azimuth = 2.399963 * i;
    const double elevation = 0.25 + 1.1 * i / kMaxLights;
    const glm::dvec3 towards(std::cos(azimuth) * std::cos(elevation), std::sin(azimuth) * std::cos(elevation),
                             std::sin(elevation));
    if (i % 4 == 3) {
      lights.emplace_back(DirectionalLight{-towards});
    } else {
      lights.emplace_back(PointLight{ws_center + 80.0 * towards});
    }
  }
  return lights;
}

/// The walker's place one step before.
StandPoint StepBefore(StandPoint stand) {
  const double angle = -kStepDegrees * std::numbers::pi / 180.0;
  const glm::dvec3 out = stand.ws_eye - stand.ws_target;
  stand.ws_eye = stand.ws_target + glm::dvec3(out.x * std::cos(angle) - out.y * std::sin(angle),
                                              out.x * std::sin(angle) + out.y * std::cos(angle), out.z);
  return stand;
}

/// One light as a view shows it; the request borrows from both.
FrameRequest RequestOf(const ViewStudy& view, const LightStudy& light, const Bounds& ws_bounds) {
  FrameRequest request;
  request.camera = {view.camera.view_from_world(), view.camera.clip_from_view(), view.camera.clip_depth()};
  request.depth = view.samples.Depth();
  request.bits = light.Bits(view);
  request.lights = {{1, light.light, kMap, {}}};
  request.screen = kScreen;
  request.ws_scene_bounds = ws_bounds;
  return request;
}

absl::StatusOr<std::unique_ptr<Study>> MakeStudy() {
  absl::StatusOr<Scene> scene = MakePlaza(300'000);
  if (!scene.ok()) return scene.status();
  const absl::StatusOr<TruthScene> truth = TruthScene::Create(*scene);
  if (!truth.ok()) return truth.status();
  const auto view_from = [&](const StandPoint& stand) -> absl::StatusOr<ViewStudy> {
    const absl::StatusOr<Camera> camera = Camera::Create(CameraAt(stand, truth->ws_bounds(), ViewOptions{}));
    if (!camera.ok()) return camera.status();
    return ViewStudy::Create(*truth, *camera, kScreen, kSamples);
  };
  absl::StatusOr<ViewStudy> view = view_from(PlazaStandPoint());
  if (!view.ok()) return view.status();
  const absl::StatusOr<ViewStudy> view_before = view_from(StepBefore(PlazaStandPoint()));
  if (!view_before.ok()) return view_before.status();
  auto study = std::make_unique<Study>(Study{*std::move(view), {}, {}, {}});
  FrameOptimizer optimizer;
  FrameSummary before;
  const std::pair<const char*, Light> lights[] = {
      {"point", PointLight{{30.0, -60.0, 80.0}}},
      {"spot", SpotLight{{10.0, 8.0, 14.0}, {-10.0, -8.0, -14.0}, 0.7}},
      {"directional", DirectionalLight{{-0.4, 0.5, -0.7}}},
  };
  for (const auto& [name, light] : lights) {
    absl::StatusOr<LightStudy> light_study = LightStudy::Create(*truth, study->view, light);
    if (!light_study.ok()) return light_study.status();
    auto prepared = std::make_unique<Prepared>(Prepared{name, *std::move(light_study), {}, {}});
    prepared->request = RequestOf(study->view, prepared->study, truth->ws_bounds());
    const absl::StatusOr<LightStudy> study_before = LightStudy::Create(*truth, *view_before, light);
    if (!study_before.ok()) return study_before.status();
    const absl::Status status = optimizer.Optimize(RequestOf(*view_before, *study_before, truth->ws_bounds()),
                                                   Options{}, Cancellation(), &before);
    if (!status.ok()) return status;
    prepared->warm_request = prepared->request;
    prepared->warm_request.lights[0].previous_clip_from_world = before.lights[0].clip_from_world;
    study->lights.push_back(std::move(prepared));
  }

  FrameRequest& all = study->all_lights;
  all = study->lights[0]->request;
  all.lights.clear();
  for (const Light& light : LightsAround(PlazaStandPoint().ws_target)) {
    const absl::StatusOr<LightStudy> light_study = LightStudy::Create(*truth, study->view, light);
    if (!light_study.ok()) return light_study.status();
    study->bits_of_all.resize(light_study->bits.size());
    for (size_t k = 0; k < light_study->bits.size(); ++k) {
      study->bits_of_all[k] |= light_study->bits[k] << all.lights.size();
    }
    all.lights.push_back({static_cast<uint32_t>(all.lights.size()), light, kMap, {}});
  }
  all.bits = BottomFirst(study->bits_of_all.data(), kSamples.width, kSamples.height);
  return study;
}

void Optimize(benchmark::State& state, const FrameRequest& request, Method method, int threads) {
  FrameOptimizer optimizer;
  FrameSummary summary;
  Options options;
  options.method = method;
  tbb::task_arena arena(threads);
  for (auto _ : state) {
    const absl::Status status =
        arena.execute([&] { return optimizer.Optimize(request, options, Cancellation(), &summary); });
    if (!status.ok()) {
      state.SkipWithError(status.ToString().c_str());
      return;
    }
  }
  const LightSummary& light = summary.lights[0];
  state.counters["boundary_samples"] = light.boundary_samples;
  state.counters["hull_samples"] = light.hull_samples;
  state.counters["evaluations"] = light.evaluations;
  state.counters["sampling_us"] = summary.sampling_seconds * 1e6;
  state.counters["predicted_pixels"] = light.predicted_misclassified_pixels;
  state.counters["kept"] = light.outcome == FitOutcome::kKeptPrevious ? 1 : 0;
}

void TakeSamples(benchmark::State& state, const FrameRequest& request, int threads) {
  FrameSampler sampler;
  FrameExtent extent;
  std::vector<LightSamples> samples;
  tbb::task_arena arena(threads);
  for (auto _ : state) {
    const absl::StatusOr<Camera> camera = Camera::Create(request.camera);
    std::vector<RaySpace> ray_spaces;
    for (const LightRequest& light : request.lights) ray_spaces.push_back(*RaySpace::Create(light.light));
    arena.execute([&] {
      sampler.Sample(*camera, request.depth, request.bits, ray_spaces, request.screen, &extent, &samples);
    });
  }
  size_t boundary = 0;
  size_t hull = 0;
  for (const LightSamples& light : samples) {
    boundary += light.boundary.size() + light.rough_boundary.size();
    hull += light.hull_rays.size();
  }
  state.counters["boundary_samples"] = static_cast<double>(boundary);
  state.counters["hull_samples"] = static_cast<double>(hull);
}

void ReadBuffers(benchmark::State& state, const FrameRequest& request) {
  const auto pixels = static_cast<size_t>(request.depth.width) * static_cast<size_t>(request.depth.height);
  for (auto _ : state) {
    const float* depth = request.depth.bottom_row;
    const uint32_t* bits = request.bits->bottom_row;
    uint32_t sum = 0;
    for (size_t i = 0; i < pixels; ++i) sum += bits[i] + static_cast<uint32_t>(depth[i] > 0.5f);
    benchmark::DoNotOptimize(sum);
  }
  state.SetBytesProcessed(static_cast<int64_t>(state.iterations() * pixels * 8));
}

int Main(int argc, char** argv) {
  absl::StatusOr<std::unique_ptr<Study>> study = MakeStudy();
  if (!study.ok()) {
    std::fprintf(stderr, "%s\n", study.status().ToString().c_str());
    return 1;
  }
  const auto add = [](const std::string& name, auto&& function) {
    benchmark::RegisterBenchmark(name.c_str(), function)
        ->Unit(benchmark::kMicrosecond)
        ->UseRealTime()
        ->Repetitions(9)
        ->ReportAggregatesOnly();
  };
  for (const std::unique_ptr<Prepared>& light : (*study)->lights) {
    const FrameRequest* request = &light->request;
    for (const Method method : {Method::kPaper, Method::kDefault, Method::kNormal}) {
      add(light->name + "/" + std::string(MethodName(method)),
          [request, method](benchmark::State& state) { Optimize(state, *request, method, 1); });
    }
    const FrameRequest* warm = &light->warm_request;
    add(light->name + "/default_warm",
        [warm](benchmark::State& state) { Optimize(state, *warm, Method::kDefault, 1); });
    add(light->name + "/samples", [request](benchmark::State& state) { TakeSamples(state, *request, 1); });
    add(light->name + "/read_buffers", [request](benchmark::State& state) { ReadBuffers(state, *request); });
  }
  for (const int threads : {1, 2}) {
    add("32_lights/default/threads:" + std::to_string(threads), [&study, threads](benchmark::State& state) {
      Optimize(state, (*study)->all_lights, Method::kDefault, threads);
    });
    add("32_lights/samples/threads:" + std::to_string(threads),
        [&study, threads](benchmark::State& state) { TakeSamples(state, (*study)->all_lights, threads); });
  }
  std::string interleave = "--benchmark_enable_random_interleaving=true";
  std::vector<char*> arguments(argv, argv + argc);
  arguments.push_back(interleave.data());
  int count = static_cast<int>(arguments.size());
  benchmark::Initialize(&count, arguments.data());
  benchmark::RunSpecifiedBenchmarks();
  return 0;
}

}  // namespace
}  // namespace shadowfit

int main(int argc, char** argv) { return shadowfit::Main(argc, argv); }
