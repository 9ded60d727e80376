// Standard shadow maps on a walk: how many pixels are wrong at the recommended resolution, at a fixed one in
// the same crop, and at a fixed one without a crop; and what safe biases cost beside biases set by hand.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <limits>
#include <string>
#include <vector>

#include "absl/strings/str_format.h"
#include "client/scene_io/load_scene.h"
#include "core/baseline/methods.h"
#include "core/bias/safe_bias.h"
#include "core/reference/artefacts.h"
#include "core/reference/shadow_map_test.h"
#include "core/reference/study_setup.h"
#include "core/resolution/resolution.h"

namespace shadowfit {
namespace {

struct Arguments {
  std::string scene = "plaza";
  int frames = 6;
  int width = 1680;
  int height = 1050;
  int limit = 4096;
  double percentile = 100.0;
  uint64_t seed = 1;
  bool y_up = false;
  bool no_bias = false;
};

/// The crop with another number of texels.
ShadowProjection Resized(const ShadowProjection& projection, MapSize size) {
  glm::dmat3 rows = glm::transpose(projection.texel_from_ray);
  rows[0] *= double(size.width) / projection.size.width;
  rows[1] *= double(size.height) / projection.size.height;
  return {glm::transpose(rows), size};
}

class Study {
 public:
  Study(const Arguments& arguments, const TruthScene& scene) : arguments_(arguments), scene_(scene) {}

  absl::Status Frame(int index, const CameraMatrices& matrices, const Light& light, const char* light_name) {
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
    ResolutionSummary summary;
    const ResolutionOptions options{.max_size = arguments_.limit, .percentile = arguments_.percentile};
    if (absl::Status status = estimator_.Estimate(request, options, Cancellation(), &summary); !status.ok()) {
      return status;
    }
    const MapEstimate& estimate = summary.lights[0].maps[0];
    if (estimate.pixels == 0) return absl::OkStatus();

    const MapSize fixed{arguments_.limit, arguments_.limit};
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
    const absl::StatusOr<int> recommended = wrong(estimate.projection);
    if (!recommended.ok()) return recommended.status();
    const absl::StatusOr<int> cropped = wrong(Resized(estimate.projection, fixed));
    if (!cropped.ok()) return cropped.status();
    const absl::StatusOr<int> whole = wrong(uncropped->projection);
    if (!whole.ok()) return whole.status();
    const double texels = estimate.projection.size.texels();
    absl::PrintF("%5d  %-11s  %4dx%-4d %s  %7.3f  %9d  %9d  %9d  %s\n", index, light_name,
                 estimate.recommended.width, estimate.recommended.height,
                 estimate.limited ? "limited" : "       ", texels / fixed.texels(), *recommended, *cropped,
                 *whole, *recommended <= *whole ? "beats the fixed map" : "LOSES to the fixed map");
    std::fflush(stdout);
    if (arguments_.no_bias) return absl::OkStatus();
    return Bias(*camera, surface, truth, *ray_space, Resized(estimate.projection, {2048, 2048}),
                estimate.depth_range);
  }

 private:
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
    print("safe, 2048x2048", bias->constant, bias->slope, safe);
    print("clamp for a constant", bias->clamp, 0.0, count(BiasKind::kConstant, bias->clamp, 0.0));
    print("receiver plane", bias->receiver_plane_constant, 0.0,
          count(BiasKind::kReceiverPlane, bias->receiver_plane_constant, 0.0));
    // By hand: 50 constants, a factor of about 1.4 apart, up to the one that no slope can ask more of.
    ArtefactCounts best;
    double best_constant = 0.0;
    best.peter_panning = std::numeric_limits<int>::max();
    double constant = std::min(1.0, bias->clamp);
    for (int i = 0; i < 50; ++i, constant /= 1.4) {
      const ArtefactCounts by_hand = count(BiasKind::kConstant, constant, 0.0);
      if (by_hand.acne > safe.acne) break;
      if (by_hand.peter_panning >= best.peter_panning) continue;
      best = by_hand;
      best_constant = constant;
    }
    if (best.peter_panning < std::numeric_limits<int>::max())
      print("best of 50 constants by hand", best_constant, 0.0, best);
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
};

absl::Status Run(const Arguments& arguments) {
  const absl::StatusOr<Scene> scene = LoadScene(arguments.scene);
  if (!scene.ok()) return scene.status();
  const absl::StatusOr<TruthScene> truth = TruthScene::Create(*scene);
  if (!truth.ok()) return truth.status();
  ViewOptions view;
  view.aspect = double(arguments.width) / arguments.height;
  if (arguments.y_up) view.ws_up = {0.0, 1.0, 0.0};
  const std::vector<StandPoint> walk = FindStandPoints(*truth, arguments.frames, arguments.seed, view);
  const Bounds& bounds = truth->ws_bounds();
  const glm::dvec3 down = -view.ws_up;
  const glm::dvec3 side = arguments.y_up ? glm::dvec3(0.6, 0.0, 0.4) : glm::dvec3(0.6, 0.4, 0.0);
  absl::PrintF("%s, %d triangles, screen %dx%d, near plane %.2f m, limit %d, percentile %g\n",
               arguments.scene, truth->TriangleCount(), arguments.width, arguments.height, view.near,
               arguments.limit, arguments.percentile);
  absl::PrintF(
      "frame  light        recommended        texels/limit  wrong at  in crop at  uncropped\n"
      "                                       share         recomm.   the limit   at the limit\n");
  Study study(arguments, *truth);
  for (size_t i = 0; i < walk.size(); ++i) {
    const CameraMatrices camera = CameraAt(walk[i], bounds, view);
    const SpotLight spot{walk[i].ws_eye + 4.0 * view.ws_up - 3.0 * side,
                         walk[i].ws_target - walk[i].ws_eye + 2.0 * down + side, 0.9};
    absl::Status status =
        study.Frame(static_cast<int>(i), camera, DirectionalLight{side + down}, "directional");
    if (status.ok()) status = study.Frame(static_cast<int>(i), camera, spot, "spot");
    if (!status.ok()) return status;
  }
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
  app.add_option("--percentile", arguments.percentile)->check(CLI::Range(1.0, 100.0))->capture_default_str();
  app.add_option("--seed", arguments.seed)->capture_default_str();
  app.add_flag("--y-up", arguments.y_up, "The scene's up axis is y, not z");
  app.add_flag("--no-bias", arguments.no_bias, "Skip the biases");
  CLI11_PARSE(app, argc, argv);
  const absl::Status status = shadowfit::Run(arguments);
  if (status.ok()) return 0;
  std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return 1;
}
