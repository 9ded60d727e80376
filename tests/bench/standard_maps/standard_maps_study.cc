// Standard shadow maps on a walk: how many pixels are wrong at the recommended resolution, at a fixed one in
// the same crop, and at a fixed one without a crop; and what safe biases cost beside biases set by hand.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <functional>
#include <map>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "absl/strings/str_format.h"
#include "client/demo/walk.h"
#include "client/scene_io/load_scene.h"
#include "core/baseline/methods.h"
#include "core/bias/safe_bias.h"
#include "core/bias/surface_samples.h"
#include "core/budget/texel_budget.h"
#include "core/reference/artefacts.h"
#include "core/reference/shadow_map_test.h"
#include "core/resolution/resolution.h"

namespace shadowfit {
namespace {

struct Arguments {
  std::string scene = "sterngarten";
  int frames = 4;
  int width = 1680;
  int height = 1050;
  int limit = 4096;
  std::vector<double> percentiles = {100.0, 99.0, 90.0};
  int lights = 4;
  int bias_map = 2048;
  bool no_maps = false;
  bool no_bias = false;
};

class Study {
 public:
  Study(const Arguments& arguments, const TruthScene& scene) : arguments_(arguments), scene_(scene) {}

  absl::Status Frame(int index, const CameraMatrices& matrices, const SceneLight& scene_light) {
    const Light& light = scene_light.light;
    const absl::StatusOr<Camera> camera = Camera::Create(matrices);
    if (!camera.ok()) return camera.status();
    const absl::StatusOr<RaySpace> ray_space = RaySpace::Create(light);
    if (!ray_space.ok()) return ray_space.status();
    const VisibleSurface surface = scene_.RenderSurface(*camera, arguments_.width, arguments_.height);
    const ShadowMask truth = scene_.TrueShadow(surface, *ray_space);

    ResolutionRequest request;
    request.camera = matrices;
    request.depth = surface.Depth();
    request.lights.push_back({.id = 0, .light = light, .clip_from_world = {}});
    const auto estimate = [&](double percentile) -> absl::StatusOr<MapEstimate> {
      ResolutionSummary summary;
      const ResolutionOptions options{.max_size = arguments_.limit, .percentile = percentile};
      if (absl::Status status = estimator_.Estimate(request, options, Cancellation(), &summary);
          !status.ok()) {
        return status;
      }
      return std::move(summary.lights[0].maps[0]);
    };
    const absl::StatusOr<MapEstimate> published = estimate(100.0);
    if (!published.ok()) return published.status();
    if (published->pixels == 0) return absl::OkStatus();

    const MapSize fixed{arguments_.limit, arguments_.limit};
    if (!arguments_.no_maps) {
      const LightSamples no_samples;
      LightProblem problem;
      problem.camera = &*camera;
      problem.light = &light;
      problem.ray_space = &*ray_space;
      problem.samples = &no_samples;
      problem.map_size = fixed;
      problem.ws_scene_bounds = scene_.ws_bounds();
      const absl::StatusOr<LightFit> uncropped = FitNormal(problem);
      if (!uncropped.ok()) return uncropped.status();

      const auto wrong = [&](const ShadowProjection& projection) -> absl::StatusOr<int> {
        const absl::StatusOr<ShadowMask> mask =
            ShadowFromMaps(scene_, surface, truth, *ray_space, std::vector<ShadowProjection>{projection});
        if (!mask.ok()) return mask.status();
        return CountWrongPixels(truth, *mask);
      };
      const absl::StatusOr<int> cropped = wrong(Resized(published->projection, fixed));
      if (!cropped.ok()) return cropped.status();
      const absl::StatusOr<int> whole = wrong(uncropped->projection);
      if (!whole.ok()) return whole.status();
      for (const double percentile : arguments_.percentiles) {
        const absl::StatusOr<MapEstimate> wanted = estimate(percentile);
        if (!wanted.ok()) return wanted.status();
        const bool is_fixed = wanted->recommended == fixed;
        const absl::StatusOr<int> recommended = is_fixed ? cropped : wrong(wanted->projection);
        if (!recommended.ok()) return recommended.status();
        const bool beats = *recommended <= *whole;
        absl::PrintF("%5d  %-14s %6.1f %%  %10.0f x %-8.0f %4dx%-4d %s  %7.3f  %9d  %9d  %9d  %s\n", index,
                     scene_light.name, percentile, wanted->needed.x, wanted->needed.y,
                     wanted->recommended.width, wanted->recommended.height,
                     wanted->limited ? "limited" : "       ", wanted->recommended.texels() / fixed.texels(),
                     *recommended, *cropped, *whole,
                     beats ? "beats the fixed map" : "LOSES to the fixed map");
        std::fflush(stdout);
        Tally& tally = tallies_[percentile];
        tally.wins += beats ? 1 : 0;
        tally.losses += beats ? 0 : 1;
        if (wanted->limited) ++tally.limited;
        if (!wanted->limited) (beats ? tally.wins_within_limit : tally.losses_within_limit) += 1;
        tally.texel_share += wanted->recommended.texels() / fixed.texels();
        tally.recommended += *recommended;
        tally.cropped += *cropped;
        tally.whole += *whole;
      }
    }
    if (arguments_.no_bias) return absl::OkStatus();
    absl::PrintF("%5d  %-14s with a %dx%d crop:\n", index, scene_light.name, arguments_.bias_map,
                 arguments_.bias_map);
    return Bias(*camera, surface, truth, *ray_space,
                Resized(published->projection, {arguments_.bias_map, arguments_.bias_map}),
                published->depth_range);
  }

  void PrintSummary() const {
    for (const auto& [percentile, tally] : tallies_) {
      const double count = tally.wins + tally.losses;
      absl::PrintF(
          "%.1f %% of the pixels: %.3f of the fixed map's texels in the mean, wrong pixels %.0f (in the same "
          "crop at "
          "the limit %.0f, fixed map %.0f); beats the fixed map in %d of %.0f, within the limit in %d of "
          "%d\n",
          percentile, tally.texel_share / count, tally.recommended / count, tally.cropped / count,
          tally.whole / count, tally.wins, count, tally.wins_within_limit,
          tally.wins_within_limit + tally.losses_within_limit);
    }
    if (biases_ == 0) return;
    absl::PrintF(
        "safe biases: %d; acne %d pixels in all, at most %.5f %% of a picture; more pixels detached than "
        "with the "
        "best of 50 constants at no more acne: %d times; detached in the mean %.0f, by hand %.0f\n",
        biases_, acne_, worst_acne_percent_, losses_to_hand_, safe_detached_ / biases_,
        hand_detached_ / biases_);
  }

 private:
  struct Tally {
    int wins = 0, losses = 0, limited = 0, wins_within_limit = 0, losses_within_limit = 0;
    double texel_share = 0.0, recommended = 0.0, cropped = 0.0, whole = 0.0;
  };

  absl::Status Bias(const Camera& camera, const VisibleSurface& surface, const ShadowMask& truth,
                    const RaySpace& ray_space, const ShadowProjection& projection, const DepthRange& range) {
    const absl::StatusOr<StandardMap> map = RenderStandardMap(scene_, ray_space, projection, range);
    if (!map.ok()) return map.status();
    const ShadowMask ideal = ShadowWithoutDepthErrors(*map, 0, surface, truth, ray_space);
    constexpr DepthFormat kFormat = DepthFormat::kUnorm24;
    const auto start = std::chrono::steady_clock::now();
    const absl::StatusOr<SafeBias> bias =
        FindSafeBias(camera, surface.ws_point, surface.ws_normal, ray_space, projection, range,
                     {kFormat, 0, {arguments_.width, arguments_.height}}, surface.Depth());
    if (!bias.ok()) return bias.status();
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    const auto count = [&](BiasKind kind, double constant, double slope) {
      StandardTest test{kFormat, kind, constant, slope, 0};
      test.clamp = bias->clamp;
      return CountArtefacts(truth, ideal, ShadowFromStandardMap(*map, test, surface, truth, ray_space));
    };
    const auto print = [](const char* name, double constant, double slope, const ArtefactCounts& counts) {
      absl::PrintF("       %-34s constant %.3e slope %6.3f  acne %7d  detached %7d  jagged %7d\n", name,
                   constant, slope, counts.acne, counts.peter_panning, counts.jagged);
    };
    print("none", 0.0, 0.0, count(BiasKind::kConstant, 0.0, 0.0));
    const ArtefactCounts safe = count(BiasKind::kSlopeScaled, bias->constant, bias->slope);
    print("safe", bias->constant, bias->slope, safe);
    print("receiver plane", bias->receiver_plane_constant, 0.0,
          count(BiasKind::kReceiverPlane, bias->receiver_plane_constant, 0.0));
    // What the service makes of a small buffer.
    const VisibleSurface small = scene_.RenderSurface(camera, 208, 130);
    const SurfaceSamples samples = SamplesFromDepth(camera, small.Depth());
    const absl::StatusOr<SafeBias> estimate =
        FindSafeBias(camera, samples.ws_point, samples.ws_normal, ray_space, projection, range,
                     {kFormat, 0, {arguments_.width, arguments_.height}}, small.Depth());
    if (!estimate.ok()) return estimate.status();
    StandardTest estimated{kFormat, BiasKind::kSlopeScaled, estimate->constant, estimate->slope, 0};
    estimated.clamp = estimate->clamp;
    print("safe by a 208x130 depth buffer", estimate->constant, estimate->slope,
          CountArtefacts(truth, ideal, ShadowFromStandardMap(*map, estimated, surface, truth, ray_space)));
    // By hand: 50 constants, a factor of 1.4 apart, up to the one that no slope can ask more of. The least
    // with no more acne detaches least.
    ArtefactCounts best;
    double best_constant = 0.0;
    double constant = std::min(1.0, bias->clamp);
    for (int i = 0; i < 50; ++i, constant /= 1.4) {
      const ArtefactCounts by_hand = count(BiasKind::kConstant, constant, 0.0);
      if (by_hand.acne > safe.acne) break;
      best = by_hand;
      best_constant = constant;
    }
    if (best_constant > 0.0) {
      print("best of 50 constants by hand", best_constant, 0.0, best);
      losses_to_hand_ += safe.peter_panning > best.peter_panning ? 1 : 0;
    }
    ++biases_;
    acne_ += safe.acne;
    worst_acne_percent_ =
        std::max(worst_acne_percent_, 100.0 * safe.acne / (double(arguments_.width) * arguments_.height));
    safe_detached_ += safe.peter_panning;
    hand_detached_ += best.peter_panning;
    absl::PrintF(
        "       detachment mean %.4f m, %.3f pixels (constant alone: %.4f m); %d samples in %.1f ms\n",
        bias->ws_mean_detachment, bias->mean_detachment_pixels, bias->ws_mean_detachment_of_constant,
        bias->samples, 1e3 * seconds);
    std::fflush(stdout);
    return absl::OkStatus();
  }

  const Arguments& arguments_;
  const TruthScene& scene_;
  ResolutionEstimator estimator_;
  std::map<double, Tally, std::greater<>> tallies_;
  int biases_ = 0;
  int acne_ = 0;
  double worst_acne_percent_ = 0.0;
  int losses_to_hand_ = 0;
  double safe_detached_ = 0.0;
  double hand_detached_ = 0.0;
};

absl::Status Run(const Arguments& arguments) {
  const absl::StatusOr<Scene> scene = LoadScene(arguments.scene);
  if (!scene.ok()) return scene.status();
  const absl::StatusOr<TruthScene> truth = TruthScene::Create(*scene);
  if (!truth.ok()) return truth.status();
  const Walk walk =
      PlanWalk(*scene, arguments.frames, arguments.lights, double(arguments.width) / arguments.height);
  absl::PrintF("%s, %d triangles, walk of %d frames, screen %dx%d, near plane %.2f m, limit %d\n",
               arguments.scene, truth->TriangleCount(), arguments.frames, arguments.width, arguments.height,
               walk.near, arguments.limit);
  if (!arguments.no_maps) {
    absl::PrintF(
        "frame  light            pixels               needed  recommended        texels/  wrong at  in crop "
        "at  "
        "uncropped\n"
        "                     satisfied                                            fixed   recomm.   the "
        "limit   "
        "at the limit\n");
  }
  Study study(arguments, *truth);
  for (size_t i = 0; i < walk.cameras.size(); ++i) {
    for (const SceneLight& light : walk.lights) {
      if (std::holds_alternative<PointLight>(light.light))
        continue;  // Six maps, no fixed one to compare with.
      if (absl::Status status = study.Frame(static_cast<int>(i), walk.cameras[i], light); !status.ok()) {
        return status;
      }
    }
  }
  study.PrintSummary();
  return absl::OkStatus();
}

}  // namespace
}  // namespace shadowfit

int main(int argc, char** argv) {
  shadowfit::Arguments arguments;
  CLI::App app{"Counts wrong pixels of standard shadow maps on a walk."};
  app.add_option("--scene", arguments.scene)->capture_default_str();
  app.add_option("--frames", arguments.frames)->check(CLI::Range(1, 1000))->capture_default_str();
  app.add_option("--width", arguments.width)->check(CLI::Range(16, 8192))->capture_default_str();
  app.add_option("--height", arguments.height)->check(CLI::Range(16, 8192))->capture_default_str();
  app.add_option("--limit", arguments.limit)->check(CLI::Range(64, 8192))->capture_default_str();
  app.add_option("--percentiles", arguments.percentiles, "Shares of the pixels to satisfy")
      ->delimiter(',')
      ->check(CLI::Range(1.0, 100.0))
      ->capture_default_str();
  app.add_option("--lights", arguments.lights, "Of the walk; its point lights take no part")
      ->check(CLI::Range(1, 32))
      ->capture_default_str();
  app.add_option("--bias-map", arguments.bias_map, "Size of the maps whose biases are judged")
      ->check(CLI::Range(16, 8192))
      ->capture_default_str();
  app.add_flag("--no-maps", arguments.no_maps, "Skip the resolutions");
  app.add_flag("--no-bias", arguments.no_bias, "Skip the biases");
  CLI11_PARSE(app, argc, argv);
  const absl::Status status = shadowfit::Run(arguments);
  if (status.ok()) return 0;
  std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return 1;
}
