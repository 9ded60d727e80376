// Time of the resolution estimate over full-resolution depth buffers. In each iteration a bare read of the
// same buffer, by the same threads, is timed beside the estimate; the ratio of the medians is what can be
// compared between machines. Histograms, and percentiles below 100, need every pixel: a run with and one
// without tell what they cost.

#include <benchmark/benchmark.h>
#include <tbb/blocked_range.h>
#include <tbb/global_control.h>
#include <tbb/parallel_reduce.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <glm/gtc/matrix_transform.hpp>
#include <vector>

#include "core/resolution/resolution.h"

namespace shadowfit {
namespace {

using Clock = std::chrono::steady_clock;

constexpr double kNear = 0.1;
constexpr double kFar = 100.0;

struct View {
  CameraMatrices camera;
  std::vector<float> pixels;
  int width;
  int height;
};

/// A floor with a field of pillars and balls, and sky above.
View MakeView(int width, int height) {
  View view{.camera = {},
            .pixels = std::vector<float>(static_cast<size_t>(width) * static_cast<size_t>(height)),
            .width = width,
            .height = height};
  view.camera.view_from_world =
      glm::lookAt(glm::dvec3(0.0, 3.0, 8.0), glm::dvec3(0.0, 1.0, 0.0), glm::dvec3(0.0, 1.0, 0.0));
  const double tan_y = 0.5;
  const double tan_x = tan_y * width / height;
  view.camera.clip_from_view =
      glm::frustum(-tan_x * kNear, tan_x * kNear, -tan_y * kNear, tan_y * kNear, kNear, kFar);
  const Camera camera = Camera::Create(view.camera).value();
  const glm::dvec3 eye(0.0, 3.0, 8.0);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const glm::dvec4 far =
          camera.WsFromNdc({-1.0 + (2.0 * x + 1.0) / width, -1.0 + (2.0 * y + 1.0) / height, 1.0});
      const glm::dvec3 direction = glm::dvec3(far) / far.w - eye;
      double t = direction.y < 0.0 ? -eye.y / direction.y : 1.0;
      for (int ball = 0; ball < 25; ++ball) {
        const int column = ball % 5 - 2, row = ball / 5 - 3;
        const glm::dvec3 centre(2.5 * column, 0.6, 2.5 * row);
        const glm::dvec3 to = centre - eye;
        const double a = glm::dot(direction, direction);
        const double b = glm::dot(direction, to);
        const double inside = b * b - a * (glm::dot(to, to) - 0.36);
        if (inside > 0.0) t = std::min(t, (b - std::sqrt(inside)) / a);
      }
      float window = 1.0F;
      if (t < 1.0) {
        const glm::dvec4 clip =
            view.camera.clip_from_view * view.camera.view_from_world * glm::dvec4(eye + t * direction, 1.0);
        window = static_cast<float>(0.5 * clip.z / clip.w + 0.5);
      }
      view.pixels[static_cast<size_t>(y) * static_cast<size_t>(width) + static_cast<size_t>(x)] = window;
    }
  }
  return view;
}

float ReadAll(const std::vector<float>& pixels) {
  return tbb::parallel_reduce(
      tbb::blocked_range<size_t>(0, pixels.size(), 65536), 0.0F,
      [&](const tbb::blocked_range<size_t>& range, float sum) {
        float lanes[64] = {};
        size_t i = range.begin();
        for (; i + 64 <= range.end(); i += 64) {
          for (size_t k = 0; k < 64; ++k) lanes[k] += pixels[i + k];
        }
        for (; i < range.end(); ++i) sum += pixels[i];
        for (const float lane : lanes) sum += lane;
        return sum;
      },
      [](float a, float b) { return a + b; });
}

double Median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Arguments: width, height, lights, threads, and whether to count histograms.
void BM_Estimate(benchmark::State& state) {
  const View view = MakeView(static_cast<int>(state.range(0)), static_cast<int>(state.range(1)));
  const auto light_count = static_cast<int>(state.range(2));
  const tbb::global_control threads(tbb::global_control::max_allowed_parallelism,
                                    static_cast<size_t>(state.range(3)));
  ResolutionRequest request{.camera = view.camera,
                            .depth = BottomFirst(view.pixels.data(), view.width, view.height),
                            .screen = {},
                            .lights = {}};
  const ResolutionLight kinds[4] = {
      {.id = 0, .light = SpotLight{{3.0, 9.0, 4.0}, {-0.3, -1.0, -0.5}, 0.7}, .clip_from_world = {}},
      {.id = 1, .light = DirectionalLight{{0.4, -1.0, 0.3}}, .clip_from_world = {}},
      {.id = 2, .light = SpotLight{{-6.0, 5.0, 0.0}, {1.0, -0.8, -0.1}, 0.9}, .clip_from_world = {}},
      {.id = 3, .light = DirectionalLight{{-0.7, -0.5, -0.3}}, .clip_from_world = {}},
  };
  for (int i = 0; i < light_count; ++i) request.lights.push_back(kinds[i]);
  const ResolutionOptions options{.max_size = kMaxResolution, .histogram = state.range(4) != 0};

  ResolutionEstimator estimator;
  ResolutionSummary summary;
  std::vector<double> reads;
  std::vector<double> estimates;
  for (auto _ : state) {
    const auto start = Clock::now();
    benchmark::DoNotOptimize(ReadAll(view.pixels));
    const auto middle = Clock::now();
    if (!estimator.Estimate(request, options, Cancellation(), &summary).ok()) {
      state.SkipWithError("the estimate failed");
      break;
    }
    const auto end = Clock::now();
    reads.push_back(std::chrono::duration<double>(middle - start).count());
    estimates.push_back(std::chrono::duration<double>(end - middle).count());
    state.SetIterationTime(estimates.back());
  }
  // Per pixel of the picture, for all maps: sums and differences of neighbours (5), two rises (4), their
  // extremes and those of depth (8). Per block of 32x8 pixels and map: bounds (150). Per pixel that a map
  // visits: a corner's three coordinates (12), one division and two products, the corner's depth (4); the
  // pixel's bounds and box (14), its centre (15) and the reductions (10); the cone takes another 10.
  const double pixels = static_cast<double>(view.pixels.size());
  const double maps = light_count;
  const double flops = pixels * (17.0 + maps * (150.0 / 256.0 + 58.0 * summary.visited_share));
  state.counters["median_ms"] = 1e3 * Median(estimates);
  state.counters["least_ms"] = 1e3 * *std::min_element(estimates.begin(), estimates.end());
  state.counters["read_ms"] = 1e3 * Median(reads);
  state.counters["ratio_to_read"] = Median(estimates) / Median(reads);
  state.counters["mflop"] = 1e-6 * flops;
  state.counters["gflop/s"] = 1e-9 * flops / Median(estimates);
  state.counters["settled"] = summary.settled_tiles;
  state.counters["tiles"] = summary.tiles;
  state.counters["visited_%"] = 100.0 * summary.visited_share;
}

BENCHMARK(BM_Estimate)
    ->ArgNames({"w", "h", "lights", "threads", "histogram"})
    ->ArgsProduct({{1680}, {1050}, {1, 4}, {1, 2}, {0, 1}})
    ->ArgsProduct({{1920}, {1080}, {1, 4}, {2}, {0}})
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace shadowfit
