#include "core/fit/frame_optimizer.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <functional>
#include <optional>
#include <set>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/bias/surface_samples.h"
#include "core/fit/best_baseline.h"
#include "core/fit/depth_range.h"
#include "core/fit/frame_sizing.h"
#include "core/fit/map_quality.h"
#include "core/fit/method_factory.h"
#include "core/fit/metric.h"
#include "core/fit/prediction.h"
#include "core/fit/swim.h"
#include "core/fit/trim_shadow.h"
#include "core/frame/for_lights.h"
#include "core/frame/frame_sampler.h"

namespace shadowfit {
namespace {

using SteadyClock = std::chrono::steady_clock;

double SecondsSince(SteadyClock::time_point start) {
  return std::chrono::duration<double>(SteadyClock::now() - start).count();
}

/// Puts the field's path before a message that a lower layer began with a member's name.
absl::Status Within(const std::string& path, const absl::Status& status) {
  return {status.code(), absl::StrCat(path, ".", status.message())};
}

const char* KindName(const Light& light) {
  constexpr const char* kNames[] = {"point", "spot", "directional"};
  return kNames[light.index()];
}

absl::Status CheckMapSize(const std::string& path, MapSize size) {
  for (const auto& [value, name] : {std::pair(size.width, "width"), std::pair(size.height, "height")}) {
    if (value < 1 || value > kMaxMapSize) {
      return absl::InvalidArgumentError(
          absl::StrFormat("%s.%s: %d is outside 1 to %d", path, name, value, kMaxMapSize));
    }
  }
  return absl::OkStatus();
}

absl::Status CheckBounds(const Bounds& bounds) {
  for (int axis = 0; axis < 3; ++axis) {
    if (!std::isfinite(bounds.min[axis]) || !std::isfinite(bounds.max[axis])) {
      return absl::InvalidArgumentError(absl::StrFormat("scene_bounds: component %d (%g to %g) is not finite",
                                                        axis, bounds.min[axis], bounds.max[axis]));
    }
    if (bounds.min[axis] > bounds.max[axis]) {
      return absl::InvalidArgumentError(absl::StrFormat(
          "scene_bounds: min %g is above max %g in component %d", bounds.min[axis], bounds.max[axis], axis));
    }
  }
  return absl::OkStatus();
}

absl::Status CheckImages(const FrameRequest& request) {
  if (request.depth.bottom_row == nullptr || request.depth.width < 1 || request.depth.height < 1) {
    return absl::InvalidArgumentError(absl::StrFormat("depth: size %dx%d, both must be positive",
                                                      request.depth.width, request.depth.height));
  }
  if (!request.bits) return absl::OkStatus();
  if (request.bits->width != request.depth.width || request.bits->height != request.depth.height) {
    return absl::InvalidArgumentError(absl::StrFormat("shadow_bits: size %dx%d differs from depth's %dx%d",
                                                      request.bits->width, request.bits->height,
                                                      request.depth.width, request.depth.height));
  }
  return absl::OkStatus();
}

absl::Status CheckLights(const FrameRequest& request, std::vector<RaySpace>* ray_spaces) {
  if (request.lights.empty()) return absl::InvalidArgumentError("lights: empty, at least one is needed");
  if (request.lights.size() > kMaxLights) {
    return absl::InvalidArgumentError(
        absl::StrFormat("lights: %d, at most %d fit a frame", request.lights.size(), kMaxLights));
  }
  std::set<uint32_t> ids;
  ray_spaces->clear();
  for (size_t i = 0; i < request.lights.size(); ++i) {
    const LightRequest& light = request.lights[i];
    const std::string path = absl::StrFormat("lights[%d]", i);
    if (!ids.insert(light.id).second)
      return absl::InvalidArgumentError(absl::StrFormat("%s.id: %d is not unique", path, light.id));
    if (absl::Status status = CheckMapSize(path + ".shadow_map", light.map_size); !status.ok()) return status;
    if (!std::isfinite(light.weight) || !(light.weight > 0.0)) {
      return absl::InvalidArgumentError(
          absl::StrFormat("%s.weight: %g is not finite and above 0", path, light.weight));
    }
    absl::StatusOr<RaySpace> space = RaySpace::Create(light.light);
    if (!space.ok()) return Within(absl::StrCat(path, ".", KindName(light.light)), space.status());
    ray_spaces->push_back(*std::move(space));
    if (light.previous_map_size) {
      absl::Status status = CheckMapSize(path + ".previous_shadow_map", *light.previous_map_size);
      if (!status.ok()) return status;
    }
    if (!light.previous_clip_from_world) continue;
    for (int k = 0; k < 16; ++k) {
      const double entry = (*light.previous_clip_from_world)[k / 4][k % 4];
      if (!std::isfinite(entry)) {
        return absl::InvalidArgumentError(
            absl::StrFormat("%s.previous_world_to_shadow_clip.m[%d]: %g is not finite", path, k, entry));
      }
    }
  }
  return absl::OkStatus();
}

constexpr char kComputation[] = "the computation";

absl::Status CheckKnobs(const DefaultOptions& options) {
  if (options.keep_within == 0.0 || (std::isfinite(options.keep_within) && options.keep_within >= 1.0)) {
    return absl::OkStatus();
  }
  return absl::InvalidArgumentError(
      absl::StrFormat("options.keep_within: %g, must be 0, or finite and at least 1", options.keep_within));
}

/// World-space corners of the part of the view frustum that holds visible surfaces, with their homogeneous
/// coordinate divided out.
std::array<glm::dvec3, 8> VisibleFrustumCorners(const Camera& camera, const FrameExtent& extent) {
  std::array<glm::dvec3, 8> corners;
  for (int i = 0; i < 8; ++i) {
    const glm::dvec4 corner =
        camera.WsFromNdc({(i & 1) != 0 ? 1.0 : -1.0, (i & 2) != 0 ? 1.0 : -1.0,
                          (i & 4) != 0 ? extent.farthest_ndc_depth : extent.nearest_ndc_depth});
    corners[static_cast<size_t>(i)] = glm::dvec3(corner) / corner.w;
  }
  return corners;
}

/// Safe biases of the fitted matrices, where the request asks for them.
absl::Status FindBiases(const Camera& camera, const FrameRequest& request, MapSize screen,
                        std::span<const RaySpace> ray_spaces, const Cancellation& cancellation,
                        FrameSummary* summary) {
  summary->bias_seconds = 0.0;
  if (!request.safe_bias) return absl::OkStatus();
  const SteadyClock::time_point start = SteadyClock::now();
  BiasOptions options = *request.safe_bias;
  options.screen = screen;
  const SurfaceSamples surface = SamplesFromDepth(camera, request.depth, options.max_samples);
  for (size_t i = 0; i < summary->lights.size(); ++i) {
    if (absl::Status status = CancellationStatus(&cancellation, kComputation); !status.ok()) return status;
    std::vector<LightMap*> maps = {&summary->lights[i]};
    for (LightMap& map : summary->lights[i].further_maps) maps.push_back(&map);
    for (LightMap* map : maps) {
      const absl::StatusOr<SafeBias> bias =
          FindSafeBias(camera, surface.ws_point, surface.ws_normal, ray_spaces[i], map->projection,
                       map->depth_range, options, request.depth);
      if (!bias.ok()) return Within("options.safe_bias", bias.status());
      map->safe_bias = *bias;
    }
  }
  summary->bias_seconds = SecondsSince(start);
  return absl::OkStatus();
}

bool IsFinite(const glm::dmat4& m) { return std::isfinite(glm::dot(m * glm::dvec4(1.0), glm::dvec4(1.0))); }

/// The projections of a light's maps, in the order in which they are asked.
std::vector<ShadowProjection> ProjectionsOf(const LightSummary& light) {
  std::vector<ShadowProjection> projections = {light.projection};
  for (const LightMap& map : light.further_maps) projections.push_back(map.projection);
  return projections;
}

/// work(i) for every light, side by side; the first light's error, if there is any.
absl::Status ForEachLight(size_t count, const std::function<absl::Status(size_t)>& work) {
  std::vector<absl::Status> statuses(count);
  ForLights(count, [&](size_t i) { statuses[i] = work(i); });
  const auto failed =
      std::find_if(statuses.begin(), statuses.end(), [](const absl::Status& status) { return !status.ok(); });
  return failed == statuses.end() ? absl::OkStatus() : *failed;
}

/// Lets go of shadow once the maps have their sizes: what is worth its texels depends on how many there are.
/// Where the plane-optimal map, which holds nothing that the picture of its plane does not, is predicted to
/// serve better than what came of that, it is trimmed in its turn: descents from a map that holds all seldom
/// lead there. Returns what the maps are predicted to get wrong, where they were trimmed.
std::optional<PredictedPixels> TrimFit(const Options& options, SizedLight* light) {
  const bool fitted = light->fit.outcome == FitOutcome::kFitted;
  if (options.standard.hold_all_shadow || !fitted || !light->problem.KnowsShadow()) return std::nullopt;
  DefaultOptions knobs = options.standard;
  LightProblem problem = light->problem;
  LightFit& fit = light->fit;
  std::vector<ShadowProjection> maps = fit.Projections();
  if (!std::holds_alternative<std::monostate>(options.sizing)) {
    // Sides that were chosen stay.
    knobs.free_aspect = false;
    problem.map_size = maps[0].size;
  }
  TrimmedShadow trimmed = TrimShadow(problem, knobs, maps);
  fit.evaluations += trimmed.evaluations;
  if (maps.size() == 1) {
    constexpr Method kOther[] = {Method::kPlaneOptimal};
    if (const std::optional<ShadowProjection> other =
            BestBaseline(problem, kOther, trimmed.predicted.Total())) {
      maps[0] = *other;
      trimmed = TrimShadow(problem, knobs, maps);
      fit.evaluations += trimmed.evaluations;
    }
  }
  fit.projection = maps[0];
  std::copy(maps.begin() + 1, maps.end(), fit.further_projections.begin());
  return trimmed.predicted;
}

}  // namespace

struct FrameOptimizer::Workspace {
  FrameSampler sampler;
  std::vector<RaySpace> ray_spaces;
  std::vector<LightSamples> samples;
};

FrameOptimizer::FrameOptimizer() : workspace_(std::make_unique<Workspace>()) {}
FrameOptimizer::~FrameOptimizer() = default;
FrameOptimizer::FrameOptimizer(FrameOptimizer&&) noexcept = default;
FrameOptimizer& FrameOptimizer::operator=(FrameOptimizer&&) noexcept = default;

absl::Status FrameOptimizer::Optimize(const FrameRequest& request, const Options& options,
                                      const Cancellation& cancellation, FrameSummary* summary) {
  const SteadyClock::time_point start = SteadyClock::now();
  Workspace& work = *workspace_;
  summary->lights.clear();

  const absl::StatusOr<Camera> camera = Camera::Create(request.camera);
  if (!camera.ok()) return Within("camera", camera.status());
  if (absl::Status status = CheckImages(request); !status.ok()) return status;
  if (absl::Status status = CheckLights(request, &work.ray_spaces); !status.ok()) return status;
  MapSize screen = request.screen;
  if (screen == MapSize{}) screen = {request.depth.width, request.depth.height};
  if (absl::Status status = CheckMapSize("screen", screen); !status.ok()) return status;
  if (request.ws_scene_bounds) {
    if (absl::Status status = CheckBounds(*request.ws_scene_bounds); !status.ok()) return status;
  }
  if (absl::Status status = CheckSizing(options.sizing); !status.ok()) return status;
  if (absl::Status status = CheckKnobs(options.standard); !status.ok()) return status;
  // A tolerance is what the maps are sized for: letting go of shadow would break it, and save nothing.
  const bool to_tolerance = std::holds_alternative<ToleranceOptions>(options.sizing);
  Options effective_options = options;
  effective_options.standard.hold_all_shadow |= to_tolerance;
  const std::unique_ptr<LightMatrixMethod> method = MakeMethod(effective_options);

  FrameExtent extent;
  work.sampler.Sample(*camera, request.depth, request.bits, work.ray_spaces, screen, &extent, &work.samples);
  if (extent.visible_pixels == 0) {
    // Nothing to see: the frustum itself, short of a far plane that may lie at infinity.
    extent.nearest_ndc_depth = NearNdc(camera->clip_depth());
    extent.farthest_ndc_depth = glm::mix(NearNdc(camera->clip_depth()), FarNdc(camera->clip_depth()), 0.99);
  }
  const std::array<glm::dvec3, 8> ws_visible_corners = VisibleFrustumCorners(*camera, extent);
  Bounds ws_scene_bounds;
  if (request.ws_scene_bounds) {
    ws_scene_bounds = *request.ws_scene_bounds;
  } else {
    for (const glm::dvec3& corner : ws_visible_corners) ws_scene_bounds.Add(corner);
  }
  summary->sampling_seconds = SecondsSince(start);

  std::vector<ShadowProjection> previous(request.lights.size());
  std::vector<SizedLight> fits(request.lights.size());
  summary->lights.resize(request.lights.size());
  const auto fit_light = [&](size_t i) -> absl::Status {
    if (absl::Status status = CancellationStatus(&cancellation, kComputation); !status.ok()) return status;
    const SteadyClock::time_point light_start = SteadyClock::now();
    const LightRequest& light = request.lights[i];
    LightSummary& result = summary->lights[i];
    result.id = light.id;

    LightProblem& problem = fits[i].problem;
    problem.camera = &*camera;
    problem.light = &light.light;
    problem.ray_space = &work.ray_spaces[i];
    problem.samples = &work.samples[i];
    problem.map_size = light.map_size;
    problem.sampler = &work.sampler;
    problem.light_in_frame = i;
    problem.cancellation = &cancellation;
    problem.nearest_ndc_depth = extent.nearest_ndc_depth;
    problem.farthest_ndc_depth = extent.farthest_ndc_depth;
    problem.ws_scene_bounds = ws_scene_bounds;
    if (light.previous_clip_from_world) {
      if (ProjectionFromClip(work.ray_spaces[i], *light.previous_clip_from_world,
                             light.previous_map_size.value_or(light.map_size), &previous[i])) {
        problem.previous = &previous[i];
      } else {
        result.note = "the previous matrix is not this light's and was ignored";
      }
    }
    absl::StatusOr<LightFit> fit = method->Fit(problem);
    if (absl::Status status = CancellationStatus(&cancellation, kComputation); !status.ok()) return status;
    if (!fit.ok()) return Within(absl::StrFormat("lights[%d]", i), fit.status());
    fits[i].fit = *std::move(fit);
    fits[i].weight = light.weight;
    result.seconds = SecondsSince(light_start);
    return absl::OkStatus();
  };
  if (absl::Status status = ForEachLight(request.lights.size(), fit_light); !status.ok()) return status;
  if (absl::Status status = SizeMaps(options.sizing, *method, request.bits.has_value(), fits); !status.ok()) {
    return status;
  }
  if (absl::Status status = CancellationStatus(&cancellation, kComputation); !status.ok()) return status;

  const auto describe_light = [&](size_t i) -> absl::Status {
    const SteadyClock::time_point light_start = SteadyClock::now();
    const LightSamples& samples = work.samples[i];
    std::optional<PredictedPixels> predicted;
    if (options.method == Method::kDefault) predicted = TrimFit(effective_options, &fits[i]);
    const LightFit& fit = fits[i].fit;
    LightSummary& result = summary->lights[i];
    result.sample_source = samples.source;
    result.boundary_samples = static_cast<int>(samples.boundary.size());
    result.hull_samples = static_cast<int>(samples.hull_rays.size());
    result.outcome = fit.outcome;
    if (fit.note[0] != '\0') result.note = fit.note;
    result.evaluations = fit.evaluations;
    const auto map_of = [&](const ShadowProjection& projection, size_t k) {
      LightMap map;
      map.projection = KeepWinding(projection);
      map.depth_range = FitDepthRange(work.ray_spaces[i], map.projection, samples, ws_visible_corners);
      map.clip_from_world =
          ClipFromWorld(work.ray_spaces[i], map.projection, map.depth_range, request.output_clip_depth);
      if (!fits[i].atlas_positions.empty()) map.atlas_position = fits[i].atlas_positions[k];
      return map;
    };
    static_cast<LightMap&>(result) = map_of(fit.projection, 0);
    for (const ShadowProjection& projection : fit.further_projections) {
      result.further_maps.push_back(map_of(projection, result.further_maps.size() + 1));
    }
    if (!IsFinite(result.clip_from_world) ||
        !std::all_of(result.further_maps.begin(), result.further_maps.end(),
                     [](const LightMap& map) { return IsFinite(map.clip_from_world); })) {
      return absl::InvalidArgumentError(
          absl::StrFormat("lights[%d]: the numbers of camera and light leave the range of doubles", i));
    }
    result.objective = FrobeniusMetric(samples.boundary, result.projection.texel_from_ray);
    if (samples.source == SampleSource::kShadowBoundary) {
      if (!predicted) predicted = PredictWrongPixels(fits[i].problem, ProjectionsOf(result));
      result.predicted_misclassified_pixels = predicted->Total();
      result.shadow_outside_pixels = predicted->outside;
    }
    if (fits[i].problem.previous != nullptr && result.further_maps.empty()) {
      result.swim_pixels = MeanSwim(samples, previous[i], result.projection);
    }
    if (options.assess_quality) {
      result.quality = AssessMaps(*camera, work.ray_spaces[i], samples, ProjectionsOf(result), screen);
    }
    result.seconds += SecondsSince(light_start);
    return absl::OkStatus();
  };
  if (absl::Status status = ForEachLight(request.lights.size(), describe_light); !status.ok()) return status;
  if (absl::Status status = FindBiases(*camera, request, screen, work.ray_spaces, cancellation, summary);
      !status.ok()) {
    return status;
  }
  summary->total_seconds = SecondsSince(start);
  return absl::OkStatus();
}

std::string FrameSummary::BriefReport() const {
  double predicted = 0.0;
  for (const LightSummary& light : lights) predicted += light.predicted_misclassified_pixels;
  return absl::StrFormat("%d lights in %.2f ms (sampling %.2f ms), %.0f misclassified pixels predicted",
                         lights.size(), total_seconds * 1e3, sampling_seconds * 1e3, predicted);
}

std::string FrameSummary::FullReport() const {
  constexpr const char* kOutcomes[] = {"fitted", "kept previous", "fallback"};
  std::string report = absl::StrFormat("%10s %13s %10s %8s %12s %10s  %s\n", "light", "outcome", "boundary",
                                       "hull", "evaluations", "ms", "predicted wrong pixels");
  for (const LightSummary& light : lights) {
    absl::StrAppendFormat(&report, "%10d %13s %10d %8d %12d %10.3f  %.1f%s%s\n", light.id,
                          kOutcomes[static_cast<int>(light.outcome)], light.boundary_samples,
                          light.hull_samples, light.evaluations, light.seconds * 1e3,
                          light.predicted_misclassified_pixels, light.note.empty() ? "" : "  ", light.note);
  }
  return report + BriefReport() + "\n";
}

}  // namespace shadowfit
