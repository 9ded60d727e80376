// Alias-free masks beside Embree's shadow rays: everything from the depth buffer to the packed mask, in
// ratios to Embree's best kernel, interleaved in one run. See --help.

#include <hwy/targets.h>
#include <tbb/blocked_range.h>
#include <tbb/global_control.h>
#include <tbb/parallel_for.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <string>
#include <vector>

#include "core/irregular/shadow_masks.h"
#include "tests/bench/masks/bench_scenes.h"
#include "tests/bench/masks/embree_shadows.h"

namespace shadowfit::bench {

/// With --cpu: processor time of all threads, which other load on the machine disturbs less than elapsed
/// time.
bool measure_cpu = false;

namespace {

double Now() {
  timespec t{};
  clock_gettime(measure_cpu ? CLOCK_PROCESS_CPUTIME_ID : CLOCK_MONOTONIC, &t);
  return 1e3 * static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_nsec);
}

double Milliseconds(const auto& work) {
  const double start = Now();
  work();
  return Now() - start;
}

double Median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2),
                   values.end());
  return values[values.size() / 2];
}

std::vector<glm::vec3> Positions(const BenchScene& bench, const Camera& camera,
                                 const std::vector<float>& depth) {
  std::vector<glm::vec3> positions(depth.size(), glm::vec3(NAN));
  for (size_t i = 0; i < depth.size(); ++i) {
    if (depth[i] >= 1.0f) continue;
    const size_t column = i % size_t(bench.width), row = i / size_t(bench.width);
    const double x = (double(column) + 0.5) * 2.0 / bench.width - 1.0;
    const double y = (double(row) + 0.5) * 2.0 / bench.height - 1.0;
    const glm::dvec4 h = camera.WsFromNdc({x, y, 2.0 * double(depth[i]) - 1.0});
    positions[i] = glm::vec3(glm::dvec3(h) / h.w);
  }
  return positions;
}

/// Bytes a second that all threads together copy, read and written both counted: the roof that the phases are
/// measured against.
double CopyBandwidth() {
  constexpr size_t kBytes = size_t{64} << 20;
  const std::vector<uint8_t> from(kBytes, 1);
  std::vector<uint8_t> to(kBytes);
  double least = 1e300;
  for (int i = 0; i < 5; ++i) {
    least = std::min(least, Milliseconds([&] {
                       tbb::parallel_for(
                           tbb::blocked_range<size_t>(0, kBytes, kBytes / 16), [&](const auto& range) {
                             std::copy(from.begin() + static_cast<std::ptrdiff_t>(range.begin()),
                                       from.begin() + static_cast<std::ptrdiff_t>(range.end()),
                                       to.begin() + static_cast<std::ptrdiff_t>(range.begin()));
                           });
                     }));
  }
  return 2.0 * static_cast<double>(kBytes) / (1e-3 * least);
}

using Wide = float __attribute__((vector_size(64)));

/// Multiply-adds that depend on nothing but their own last one.
__attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default"),
               optimize("fp-contract=fast"))) float
MultiplyAdds(int steps) {
  Wide a[10] = {};
  const Wide factor = Wide{} + 0.999f, term = Wide{} + 1e-3f;
  for (int i = 0; i < steps; ++i) {
    for (Wide& x : a) x = x * factor + term;
  }
  float sum = 0.0f;
  for (const Wide& x : a) sum += x[0];
  return sum;
}

/// Single-precision operations a second of all threads together; the other roof.
double PeakOperations(int threads) {
  constexpr int kSteps = 400000;
  double least = 1e300;
  std::vector<float> results(static_cast<size_t>(threads));
  for (int i = 0; i < 5; ++i) {
    least = std::min(least, Milliseconds([&] {
                       tbb::parallel_for(0, threads, [&](int thread) {
                         results[static_cast<size_t>(thread)] = MultiplyAdds(kSteps);
                       });
                     }));
  }
  return 2.0 * 16 * 10 * kSteps * threads / (1e-3 * least);
}

/// Slope of log time over log size, by least squares.
double Exponent(const std::vector<double>& sizes, const std::vector<double>& times) {
  double mean_x = 0, mean_y = 0;
  for (size_t i = 0; i < sizes.size(); ++i) {
    mean_x += std::log(sizes[i]) / static_cast<double>(sizes.size());
    mean_y += std::log(times[i]) / static_cast<double>(sizes.size());
  }
  double above = 0, below = 0;
  for (size_t i = 0; i < sizes.size(); ++i) {
    above += (std::log(sizes[i]) - mean_x) * (std::log(times[i]) - mean_y);
    below += (std::log(sizes[i]) - mean_x) * (std::log(sizes[i]) - mean_x);
  }
  return above / below;
}

struct Options {
  int repeats = 9;
  bool avx2 = true;
  bool bsp = true;
  bool phases = true;
  bool embree = true;
};

struct Roofs {
  double bandwidth, operations;  ///< A second.
};

double Run(const BenchScene& bench, const Options& options, int threads, const Roofs& roofs) {
  const Camera camera = *Camera::Create(bench.camera);
  EmbreeShadows embree(bench, threads);
  embree.Build(RTC_BUILD_QUALITY_MEDIUM);
  const std::vector<float> depth = embree.Depth(camera);
  const std::vector<glm::vec3> positions = Positions(bench, camera, depth);
  const absl::StatusOr<MaskScene> scene = MaskScene::Create(bench.scene);
  const bool transmit = scene->HasTransmittance();
  ReceiverLayer layer;
  layer.depth = BottomFirst(depth.data(), bench.width, bench.height);
  const Light light = bench.light;
  MaskRequest request;
  request.scene = &*scene;
  request.camera = &camera;
  request.layers = {&layer, 1};
  request.lights = {&light, 1};
  request.output = transmit ? MaskOutput::kTransmittance : MaskOutput::kBits;

  // Embree's best kernel for this scene and each quality.
  std::vector<uint8_t> shadow;
  std::vector<float> transmittance;
  TraceMode best[2];
  const RTCBuildQuality qualities[2] = {RTC_BUILD_QUALITY_LOW, RTC_BUILD_QUALITY_MEDIUM};
  for (int q = 0; q < 2 && options.embree; ++q) {
    embree.Build(qualities[q]);
    double least = 1e300;
    for (const TraceMode& mode : AllTraceModes()) {
      double time = 1e300;
      for (int i = 0; i < 2; ++i) {
        time = std::min(
            time, Milliseconds([&] { embree.Trace(positions, mode, transmit, &shadow, &transmittance); }));
      }
      if (time < least) least = time, best[q] = mode;
    }
  }

  MaskRenderer renderer;
  std::vector<double> ours, ours_avx2, ours_bsp, build[2], trace[2], ratio[2], trace_ratio, avx2_ratio;
  MaskTimings sum;
  std::vector<MaskTimings> phases;
  LightMask mask;
  const auto render = [&] {
    const auto masks = renderer.Render(request);
    if (!masks.ok()) {
      std::fprintf(stderr, "%s\n", masks.status().ToString().c_str());
      std::exit(1);
    }
    mask = (*masks)[0];
  };
  render();
  for (int i = 0; i < options.repeats; ++i) {
    ours.push_back(Milliseconds(render));
    phases.push_back(mask.milliseconds);
    if (options.avx2) {
      hwy::SetSupportedTargetsForTest(HWY_AVX2 | HWY_SSE4);
      ours_avx2.push_back(Milliseconds(render));
      hwy::SetSupportedTargetsForTest(0);
    }
    for (int q = 0; q < 2 && options.embree; ++q) {
      build[q].push_back(Milliseconds([&] { embree.Build(qualities[q]); }));
      trace[q].push_back(
          Milliseconds([&] { embree.Trace(positions, best[q], transmit, &shadow, &transmittance); }));
    }
  }
  const size_t memory = renderer.MemoryBytes();
  if (options.bsp) {
    request.method = MaskMethod::kBsp;
    render();
    for (int i = 0; i < 2; ++i) ours_bsp.push_back(Milliseconds(render));
    request.method = MaskMethod::kGrid;
    render();
  }

  const double mine = Median(ours);
  std::printf("%-10s %8zu triangles %8zu samples, %4.1f %% in shadow, %zu undecided, %.1f bytes a sample\n",
              bench.name.c_str(), scene->TriangleCount(), mask.samples,
              100.0 * double(mask.shadowed_samples) / double(mask.samples), mask.undecided_samples,
              double(memory) / double(bench.width) / double(bench.height));
  size_t mesh_bytes = 0;
  for (const Mesh& mesh : bench.scene.meshes) {
    mesh_bytes += mesh.positions.size() * sizeof(glm::vec3) + mesh.triangles.size() * sizeof(glm::uvec3);
  }
  std::printf("  casters: %.1f bytes a triangle, %.1f as meshes\n",
              double(scene->MemoryBytes()) / double(scene->TriangleCount()),
              double(mesh_bytes) / double(scene->TriangleCount()));
  std::printf("  masks %8.2f ms", mine);
  std::printf(" (least %.2f)", *std::min_element(ours.begin(), ours.end()));
  if (options.phases) {
    // The least of each: what the phase takes when nothing else runs on the machine.
    const auto phase = [&](double MaskTimings::*member) {
      double least = 1e300;
      for (const MaskTimings& t : phases) least = std::min(least, t.*member);
      return least;
    };
    std::printf("   plan %.2f  project %.2f  sort %.2f  walk %.2f  resolve %.2f", phase(&MaskTimings::plan),
                phase(&MaskTimings::project), phase(&MaskTimings::sort), phase(&MaskTimings::walk),
                phase(&MaskTimings::resolve));
  }
  std::printf("\n");
  if (options.phases) {
    // What each phase must at least move: a pixel's depth, a sample of sixteen bytes and the number of its
    // cell; that, its place and its pixel's number; the casters, and the samples, which are read
    // by pixel, written and read in order; four bits of answers a pixel. And compute, counted in single
    // precision (double counts twice): 80 operations to place and bound a sample, 540 to set up a triangle,
    // 240 to test it against sixteen samples.
    const double pixels = double(bench.width) * bench.height, samples = double(mask.samples);
    const double bytes[4] = {4 * pixels + 20 * samples, 12 * samples,
                             double(scene->MemoryBytes()) + 3 * 16 * samples, pixels / 2};
    // Where there are few triangles, phases are of all threads together; roofs are of as long as they take.
    const double at_once = scene->TriangleCount() <= kMostTrianglesOfPieces ? threads : 1;
    double MaskTimings::*const members[4] = {&MaskTimings::project, &MaskTimings::sort, &MaskTimings::walk,
                                             &MaskTimings::resolve};
    const char* const names[4] = {"project", "sort", "walk", "resolve"};
    const double operations[4] = {80 * samples, 0, 780 * double(scene->TriangleCount()), 0};
    std::printf("  share of roofline:");
    for (int i = 0; i < 4; ++i) {
      double least = 1e300;
      for (const MaskTimings& t : phases) least = std::min(least, t.*members[i]);
      const double roof = std::max(bytes[i] / roofs.bandwidth, operations[i] / roofs.operations);
      std::printf("  %s %.1f MB %.0f Mop %.0f %%", names[i], 1e-6 * bytes[i], 1e-6 * operations[i],
                  100.0 * roof * at_once / (1e-3 * least));
    }
    std::printf("\n");
  }
  if (options.avx2) std::printf("  AVX2  %8.2f ms\n", Median(ours_avx2));
  if (options.bsp) {
    const double bsp = *std::min_element(ours_bsp.begin(), ours_bsp.end());
    std::printf("  bsp   %8.2f ms (%.1f times as long)\n", bsp, bsp / mine);
  }
  if (!options.embree) return mine;
  double least_both = 1e300, least_trace = 1e300;
  for (int q = 0; q < 2; ++q) {
    std::printf("  Embree %-6s %8.2f + %8.2f ms  (%s)\n", q == 0 ? "LOW" : "MEDIUM", Median(build[q]),
                Median(trace[q]), Name(best[q]).c_str());
    std::vector<double> both;
    for (size_t i = 0; i < build[q].size(); ++i) both.push_back(build[q][i] + trace[q][i]);
    least_both = std::min(least_both, Median(both));
    least_trace = std::min(least_trace, Median(trace[q]));
  }
  std::printf("  ratio build + trace %.2f, trace alone %.2f", least_both / mine, least_trace / mine);
  if (options.avx2) {
    std::printf("   AVX2: %.2f, %.2f (%.2f of the best)", least_both / Median(ours_avx2),
                least_trace / Median(ours_avx2), mine / Median(ours_avx2));
  }
  size_t differ = 0;
  for (size_t i = 0; i < shadow.size(); ++i) {
    const int x = int(i % size_t(bench.width)), y = int(i / size_t(bench.width));
    differ += !transmit && mask.InShadow(0, bench.height, x, y) != (shadow[i] != 0);
  }
  std::printf("   differing samples %zu\n", differ);
  return mine;
}

}  // namespace
}  // namespace shadowfit::bench

int main(int argc, char** argv) {
  CLI::App app("Alias-free masks against Embree's shadow rays");
  std::vector<std::string> scenes{"1k", "10k", "100k", "1m", "terrain", "hair", "plaza", "hall"};
  shadowfit::bench::Options options;
  int threads = 2;
  bool scaling = false;
  app.add_flag("--scaling", scaling, "Time over 1 K to 4 M triangles and 0.2 to 8 M samples");
  app.add_option("--scenes", scenes, "1k, 10k, 100k, 1m, 4m, terrain, hair, plaza, hall")
      ->delimiter(',')
      ->check(CLI::IsMember({"1k", "10k", "100k", "1m", "4m", "terrain", "hair", "plaza", "hall"}));
  app.add_option("--repeats", options.repeats)->check(CLI::Range(1, 1000));
  app.add_option("--threads", threads)->check(CLI::Range(1, 256));
  app.add_flag("!--no-bsp", options.bsp, "Not the paper's hierarchy, once a scene");
  app.add_flag("!--no-embree", options.embree, "Only the masks");
  app.add_flag("!--no-avx2", options.avx2, "Only the best instruction set");
  app.add_flag(
      "--cpu", shadowfit::bench::measure_cpu,
      "Processor time of all threads instead of elapsed time; coarse where that is a few milliseconds");
  CLI11_PARSE(app, argc, argv);
  const tbb::global_control control(tbb::global_control::max_allowed_parallelism,
                                    static_cast<size_t>(threads));
  const shadowfit::bench::Roofs roofs{shadowfit::bench::CopyBandwidth(),
                                      shadowfit::bench::PeakOperations(threads)};
  std::printf("copy bandwidth %.1f GB/s, peak %.0f Gop/s\n", 1e-9 * roofs.bandwidth, 1e-9 * roofs.operations);
  if (scaling) {
    using namespace shadowfit::bench;  // NOLINT(google-build-using-namespace)
    options.embree = options.avx2 = options.phases = options.bsp = false;
    options.repeats = std::min(options.repeats, 5);
    std::vector<double> sizes, times;
    for (const size_t triangles : {1000, 10000, 100000, 1000000, 4000000}) {
      sizes.push_back(static_cast<double>(triangles));
      times.push_back(Run(RandomTriangles(triangles), options, threads, roofs));
    }
    std::printf("exponent over triangles %.2f\n", Exponent(sizes, times));
    sizes.clear();
    times.clear();
    for (const int width : {512, 1024, 2048, 3264}) {
      sizes.push_back(0.75 * width * width);
      times.push_back(Run(RandomTriangles(100000, width, width * 3 / 4), options, threads, roofs));
    }
    std::printf("exponent over samples %.2f\n", Exponent(sizes, times));
    return 0;
  }
  for (const std::string& name : scenes) {
    using namespace shadowfit::bench;  // NOLINT(google-build-using-namespace)
    const BenchScene bench = name == "1k"        ? RandomTriangles(1000)
                             : name == "10k"     ? RandomTriangles(10000)
                             : name == "100k"    ? RandomTriangles(100000)
                             : name == "1m"      ? RandomTriangles(1000000)
                             : name == "4m"      ? RandomTriangles(4000000)
                             : name == "terrain" ? Terrain(700)
                             : name == "plaza"   ? Plaza()
                             : name == "hall"    ? Hall()
                                                 : HairBall(5000);
    Run(bench, options, threads, roofs);
  }
  return 0;
}
