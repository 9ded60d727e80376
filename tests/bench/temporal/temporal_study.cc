// How steady matrices are on the demo's walk, and what steadiness costs: for each way of making them the swim
// (swim.h), the flicker (points of the surfaces seen in two frames running whose answer changes from one to
// the next although the truth does not) and the wrong pixels, in the mean over frames and lights. Maps are
// judged without depth errors, against shadow rays.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_format.h"
#include "client/demo/walk.h"
#include "client/scene_io/load_scene.h"
#include "core/fit/frame_optimizer.h"
#include "core/reference/artefacts.h"
#include "core/reference/shadow_map_test.h"
#include "core/reference/view_study.h"

namespace shadowfit {
namespace {

struct Arguments {
  std::string scene = "sterngarten";
  int frames = 48;
  int lights = 4;
  int screen = 750;
  int map = 400;
  int samples = 180;
  std::vector<double> keep = {DefaultOptions{}.keep_within};
  bool brief = false;
  bool per_light = false;
};

/// A way of making matrices, with its memory and what is counted of it.
struct Variant {
  std::string name;
  Options options;

  FrameOptimizer optimizer = {};
  FrameSummary summary = {};
  std::vector<LightRequest> lights = {};                     // With the previous frame's matrices.
  std::vector<std::vector<ShadowProjection>> previous = {};  // By light.

  double wrong = 0.0;
  double predicted = 0.0;
  int maps = 0;
  double flicker = 0.0;
  int steps = 0;
  double swim = 0.0;
  int swims = 0;
  int kept = 0;
  int still = 0;
  std::vector<double> light_flicker = {};
  std::vector<double> light_wrong = {};
};

std::vector<Variant> Variants(const Arguments& arguments) {
  std::vector<Variant> variants;
  const auto add = [&](std::string name, Method method, double keep, double sufficient) {
    Variant& variant = variants.emplace_back();
    variant.name = std::move(name);
    variant.options.method = method;
    variant.options.standard.keep_within = keep;
    variant.options.paper.sufficient_improvement = sufficient;
  };
  add("focused", Method::kFocused, 0.0, 0.0);
  if (!arguments.brief) {
    add("sphere_stable", Method::kSphereStable, 0.0, 0.0);
    add("paper, always new", Method::kPaper, 0.0, 0.0);
    add("paper, 80 % rule", Method::kPaper, 0.0, 0.8);
  }
  add("default, keep_within 0", Method::kDefault, 0.0, 0.0);
  for (const double keep : arguments.keep) {
    add(absl::StrFormat("default, keep_within %g", keep), Method::kDefault, keep, 0.0);
  }
  return variants;
}

bool SamePlace(const std::vector<ShadowProjection>& a, const std::vector<ShadowProjection>& b) {
  if (a.size() != b.size()) return false;
  for (size_t k = 0; k < a.size(); ++k) {
    if (a[k].size != b[k].size) return false;
    const glm::dmat3 change = b[k].texel_from_ray * glm::inverse(a[k].texel_from_ray);
    const double scale = change[2][2];
    for (int i = 0; i < 9; ++i) {
      if (!(std::abs(change[i / 3][i % 3] / scale - (i % 4 == 0 ? 1.0 : 0.0)) < 1e-6)) return false;
    }
  }
  return true;
}

class Study {
 public:
  Study(const Arguments& arguments, const TruthScene& truth, const Walk& walk)
      : arguments_(arguments), truth_(truth), walk_(walk), variants_(Variants(arguments)) {
    for (Variant& variant : variants_) {
      for (size_t i = 0; i < walk.lights.size(); ++i) {
        LightRequest& light = variant.lights.emplace_back();
        light.id = static_cast<uint32_t>(i);
        light.light = walk.lights[i].light;
        light.map_size = {arguments.map, arguments.map};
      }
      variant.previous.resize(walk.lights.size());
      variant.light_flicker.resize(walk.lights.size());
      variant.light_wrong.resize(walk.lights.size());
    }
  }

  absl::Status Frame(const CameraMatrices& matrices) {
    const absl::StatusOr<Camera> camera = Camera::Create(matrices);
    if (!camera.ok()) return camera.status();
    const ViewStudy view = ViewStudy::Create(truth_, *camera, {arguments_.screen, arguments_.screen},
                                             {arguments_.samples, arguments_.samples});
    const std::vector<bool> seen = SeenBefore(view.screen);
    std::vector<LightStudy> lights;
    std::vector<uint32_t> bits(view.samples.size(), 0);
    for (size_t i = 0; i < walk_.lights.size(); ++i) {
      absl::StatusOr<LightStudy> light = LightStudy::Create(truth_, view, walk_.lights[i].light);
      if (!light.ok()) return light.status();
      for (size_t pixel = 0; pixel < bits.size(); ++pixel) bits[pixel] |= (light->bits[pixel] & 1u) << i;
      lights.push_back(*std::move(light));
    }
    FrameRequest request;
    request.camera = matrices;
    request.depth = view.samples.Depth();
    request.bits = BottomFirst(bits.data(), view.samples.width, view.samples.height);
    request.screen = {arguments_.screen, arguments_.screen};
    request.ws_scene_bounds = truth_.ws_bounds();
    for (Variant& variant : variants_) {
      request.lights = variant.lights;
      absl::Status status =
          variant.optimizer.Optimize(request, variant.options, Cancellation(), &variant.summary);
      if (!status.ok()) return status;
      for (size_t i = 0; i < lights.size(); ++i) {
        status = Count(view, lights[i], i, seen, &variant);
        if (!status.ok()) return status;
      }
    }
    clip_from_world_before_ = camera->clip_from_world();
    surface_before_ = view.screen;
    return absl::OkStatus();
  }

  void Print() const {
    const auto mean_wrong = [](const Variant& v) { return v.wrong / std::max(1, v.maps); };
    const Variant* focused = &variants_.front();
    const Variant* fresh = nullptr;
    for (const Variant& variant : variants_) {
      if (variant.name == "default, keep_within 0") fresh = &variant;
    }
    absl::PrintF("%-26s  %6s  %6s  %8s  %8s  %8s  %8s  %10s\n", "", "kept", "still", "swim", "flicker",
                 "/focused", "wrong", "gain lost");
    for (const Variant& variant : variants_) {
      const double steps = std::max(1, variant.steps);
      absl::PrintF("%-26s  %5.1f%%  %5.1f%%  %8.3f  %8.1f  %7.1f%%  %8.1f", variant.name,
                   100.0 * variant.kept / steps, 100.0 * variant.still / steps,
                   variant.swim / std::max(1, variant.swims), variant.flicker / steps,
                   100.0 * (variant.flicker / steps) / (focused->flicker / std::max(1, focused->steps)),
                   mean_wrong(variant));
      if (variant.options.method == Method::kDefault && variant.options.standard.keep_within > 0.0) {
        const double gain = mean_wrong(*focused) - mean_wrong(*fresh);
        absl::PrintF("  %9.1f%%", 100.0 * (mean_wrong(variant) - mean_wrong(*fresh)) / gain);
      }
      absl::PrintF("\n");
      if (!arguments_.per_light) continue;
      for (size_t i = 0; i < walk_.lights.size(); ++i) {
        absl::PrintF("    %-22s  %24s  %8.1f  %8s  %8.1f\n", walk_.lights[i].name, "",
                     variant.light_flicker[i] / std::max<double>(1, arguments_.frames - 1), "",
                     variant.light_wrong[i] / arguments_.frames);
      }
    }
  }

 private:
  /// Pixels whose point the frame before saw as well: its own pixel there saw the same place.
  std::vector<bool> SeenBefore(const VisibleSurface& surface) const {
    std::vector<bool> seen(surface.size(), false);
    if (!surface_before_) return seen;
    const VisibleSurface& before = *surface_before_;
    for (size_t i = 0; i < surface.size(); ++i) {
      if (surface.primitive[i] == kNoPrimitive) continue;
      const glm::dvec4 clip = clip_from_world_before_ * glm::dvec4(surface.ws_point[i], 1.0);
      if (!(clip.w > 0.0 && std::abs(clip.x) < clip.w && std::abs(clip.y) < clip.w)) continue;
      const int x = static_cast<int>((clip.x / clip.w + 1.0) * 0.5 * before.width);
      const int y = static_cast<int>((clip.y / clip.w + 1.0) * 0.5 * before.height);
      const size_t pixel =
          static_cast<size_t>(std::min(y, before.height - 1)) * static_cast<size_t>(before.width) +
          static_cast<size_t>(std::min(x, before.width - 1));
      if (before.primitive[pixel] == kNoPrimitive) continue;
      // In front of or behind the plane that is seen there by less than two pixels.
      const double pixel_size = 2.0 * clip.w / (std::sqrt(3.0) * before.width);
      const double off = glm::dot(before.ws_point[pixel] - surface.ws_point[i], surface.ws_normal[i]);
      seen[i] = before.primitive[pixel] == surface.primitive[i] || std::abs(off) < 2.0 * pixel_size;
    }
    return seen;
  }

  absl::Status Count(const ViewStudy& view, const LightStudy& light, size_t i, const std::vector<bool>& seen,
                     Variant* variant) {
    const LightSummary& fit = variant->summary.lights[i];
    std::vector<ShadowProjection> projections = {fit.projection};
    for (const LightMap& map : fit.further_maps) projections.push_back(map.projection);
    const absl::StatusOr<ShadowMask> now =
        ShadowFromMaps(truth_, view.screen, light.screen, light.ray_space, projections);
    if (!now.ok()) return now.status();
    const double wrong = CountWrongPixels(light.screen, *now);
    variant->wrong += wrong;
    variant->light_wrong[i] += wrong;
    variant->predicted += fit.predicted_misclassified_pixels;
    ++variant->maps;
    std::vector<ShadowProjection>& previous = variant->previous[i];
    if (!previous.empty()) {
      ++variant->steps;
      variant->kept += fit.outcome == FitOutcome::kKeptPrevious;
      if (fit.swim_pixels) {
        variant->swim += *fit.swim_pixels;
        ++variant->swims;
      }
      if (SamePlace(previous, projections)) {
        ++variant->still;
      } else {
        absl::StatusOr<ShadowMask> before =
            ShadowFromMaps(truth_, view.screen, light.screen, light.ray_space, previous);
        if (!before.ok()) return before.status();
        for (size_t pixel = 0; pixel < seen.size(); ++pixel) {
          if (!seen[pixel]) (*before)[pixel] = (*now)[pixel];
        }
        const double flicker = CountFlicker(light.screen, *before, light.screen, *now);
        variant->flicker += flicker;
        variant->light_flicker[i] += flicker;
      }
    }
    previous = std::move(projections);
    variant->lights[i].previous_clip_from_world = fit.clip_from_world;
    variant->lights[i].previous_map_size = fit.projection.size;
    return absl::OkStatus();
  }

  const Arguments& arguments_;
  const TruthScene& truth_;
  const Walk& walk_;
  std::vector<Variant> variants_;
  std::optional<VisibleSurface> surface_before_;
  glm::dmat4 clip_from_world_before_{1.0};
};

absl::Status Run(const Arguments& arguments) {
  const absl::StatusOr<Scene> scene = LoadScene(arguments.scene);
  if (!scene.ok()) return scene.status();
  const absl::StatusOr<TruthScene> truth = TruthScene::Create(*scene);
  if (!truth.ok()) return truth.status();
  const Walk walk = PlanWalk(*scene, arguments.frames, arguments.lights, 1.0);
  absl::PrintF(
      "%s, %d triangles, walk of %d frames, %d lights, screen %dx%d, maps %dx%d, samples %dx%d, near plane "
      "%.2f m\n"
      "kept: share of the frames that keep the previous matrix; still: share where no texel moved at all\n"
      "swim: mean motion of texel centres, pixels a frame; flicker: pixels a frame and light; wrong: a "
      "frame\n"
      "and light; gain lost: of the wrong pixels that the default saves against focused\n\n",
      arguments.scene, truth->TriangleCount(), arguments.frames, walk.lights.size(), arguments.screen,
      arguments.screen, arguments.map, arguments.map, arguments.samples, arguments.samples, walk.near);
  Study study(arguments, *truth, walk);
  for (size_t i = 0; i < walk.cameras.size(); ++i) {
    if (absl::Status status = study.Frame(walk.cameras[i]); !status.ok()) return status;
    std::fprintf(stderr, "\rframe %zu of %zu", i + 1, walk.cameras.size());
  }
  std::fprintf(stderr, "\n");
  study.Print();
  return absl::OkStatus();
}

}  // namespace
}  // namespace shadowfit

int main(int argc, char** argv) {
  shadowfit::Arguments arguments;
  CLI::App app{"Measures swim and flicker of shadow maps on the demo's walk."};
  app.add_option("--scene", arguments.scene)->capture_default_str();
  app.add_option("--frames", arguments.frames, "Of the walk, which is the same at any number")
      ->check(CLI::Range(2, 1000))
      ->capture_default_str();
  app.add_option("--lights", arguments.lights)->check(CLI::Range(1, 32))->capture_default_str();
  app.add_option("--screen", arguments.screen, "Side")->check(CLI::Range(16, 4096))->capture_default_str();
  app.add_option("--map", arguments.map, "Side")->check(CLI::Range(16, 8192))->capture_default_str();
  app.add_option("--samples", arguments.samples, "Side")->check(CLI::Range(16, 4096))->capture_default_str();
  app.add_option("--keep-within", arguments.keep,
                 "OptimizeOptions.keep_within of the default, several by commas")
      ->delimiter(',')
      ->check(CLI::Range(1.0, 1e6))
      ->capture_default_str();
  app.add_flag("--brief", arguments.brief, "The default beside focused alone");
  app.add_flag("--per-light", arguments.per_light, "A row a light as well");
  CLI11_PARSE(app, argc, argv);
  const absl::Status status = shadowfit::Run(arguments);
  if (status.ok()) return 0;
  std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return 1;
}
