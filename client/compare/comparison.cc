#include "client/compare/comparison.h"

#include <time.h>

#include <algorithm>
#include <array>
#include <set>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/compare/artefact_study.h"
#include "client/compare/certificate_study.h"
#include "client/compare/comparison_report.h"
#include "client/compare/record_store.h"
#include "core/fit/frame_optimizer.h"
#include "core/reference/view_study.h"

namespace shadowfit {
namespace {

absl::Status Validate(const ComparisonOptions& options) {
  const auto invalid = [](const std::string& message) { return absl::InvalidArgumentError(message); };
  if (options.methods.empty()) return invalid("methods: empty, at least one is needed");
  std::set<std::string> names;
  for (const MethodVariant& method : options.methods) {
    if (!names.insert(method.name).second) return invalid(absl::StrCat("methods: ", method.name, " twice"));
    if (method.map_size.width < 1 || method.map_size.height < 1) {
      return invalid(absl::StrFormat("methods.%s.map_size: %dx%d, both must be positive", method.name,
                                     method.map_size.width, method.map_size.height));
    }
  }
  if (!(options.certify_tolerance >= 0.0) || !(options.certify_tolerance < 1.0)) {
    return invalid(
        absl::StrFormat("certify: %g, a share above 0 and below 1 is accepted", options.certify_tolerance));
  }
  if (options.sets.empty()) return invalid("sets: empty, at least one is needed");
  std::set<LightPlacement> placements;
  for (const LightSet& set : options.sets) {
    if (set.count < 1) return invalid(absl::StrFormat("lights: %d, at least 1 is needed", set.count));
    if (!placements.insert(set.placement).second) {
      return invalid(absl::StrCat("kind: ", std::string(LightPlacementName(set.placement)), " twice"));
    }
  }
  for (const auto& [size, name] :
       {std::pair(options.screen, "screen"), std::pair(options.samples, "samples")}) {
    if (size.width < 2 || size.height < 2 || size.width > 16384 || size.height > 16384) {
      return invalid(
          absl::StrFormat("%s: %dx%d, 2 to 16384 on each side are accepted", name, size.width, size.height));
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<std::vector<StandPoint>> ChooseStandPoints(const TruthScene& truth,
                                                          const std::string& scene_name,
                                                          const ComparisonOptions& options) {
  if (options.views == 0) {
    if (options.stand_point) return std::vector{*options.stand_point};
    if (const auto own = ProceduralStandPoint(scene_name)) return std::vector{*own};
  }
  std::vector<StandPoint> found =
      FindStandPoints(truth, std::max(1, options.views), options.views == 0 ? 1 : options.seed, options.view);
  if (found.empty()) {
    return absl::InvalidArgumentError(
        "view: no floor to stand on was found in the scene; give the eye and the target");
  }
  return found;
}

/// A frame of the view's small picture, without lights.
FrameRequest RequestOf(const TruthScene& truth, const ViewStudy& view, MapSize screen) {
  FrameRequest request;
  request.camera = {view.camera.view_from_world(), view.camera.clip_from_view(), view.camera.clip_depth()};
  request.depth = view.samples.Depth();
  request.screen = screen;
  request.ws_scene_bounds = truth.ws_bounds();
  return request;
}

/// Processor time of this thread, which other programs on the machine leave alone.
double ThreadSeconds() {
  timespec time{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

/// Whether what was kept of a light has all that is asked for. Where a light has no certificate because it
/// cannot have one, it is tried again: that costs nothing.
bool Serves(const MethodRecord& kept, const MethodVariant& method, bool with_artefacts,
            const ComparisonOptions& options) {
  if (with_artefacts && !kept.artefacts) return false;
  if (!(options.certify_tolerance > 0.0) || method.options.method != Method::kDefault) return true;
  if (!kept.certificate || kept.certificate->tolerance != options.certify_tolerance) return false;
  return kept.certificate->complete || kept.certificate->time_limit >= options.certify_seconds;
}

/// One method's matrices for one light: the summary of the last of three runs, the median of their times.
MethodRecord MeasureFit(const TruthScene& truth, const ViewStudy& view, const LightStudy& light,
                        const MethodVariant& method, const ComparisonOptions& options,
                        FrameOptimizer* optimizer, const ArtefactStudy* artefacts) {
  FrameRequest request = RequestOf(truth, view, options.screen);
  request.bits = light.Bits(view);
  LightRequest& wanted = request.lights.emplace_back();
  wanted.light = light.light;
  wanted.map_size = method.map_size;

  MethodRecord record;
  FrameSummary summary;
  std::array<double, 3> seconds{};
  for (double& run : seconds) {
    const double start = ThreadSeconds();
    const absl::Status status = optimizer->Optimize(request, method.options, Cancellation(), &summary);
    run = ThreadSeconds() - start;
    if (!status.ok()) {
      record.note = absl::StrCat("failed: ", status.message());
      record.wrong_pixels = light.shadowed_pixels;
      return record;
    }
  }
  std::ranges::sort(seconds);
  const LightSummary& fit = summary.lights[0];
  record.milliseconds = 1e3 * seconds[1];
  record.predicted_pixels = fit.predicted_misclassified_pixels;
  record.boundary_samples = fit.boundary_samples;
  record.evaluations = fit.evaluations;
  record.note = fit.note;
  std::vector<ShadowProjection> projections = {fit.projection};
  for (const LightMap& map : fit.further_maps) projections.push_back(map.projection);
  const absl::StatusOr<int> wrong = WrongPixels(truth, view, light, projections);
  if (wrong.ok()) {
    record.wrong_pixels = *wrong;
  } else {
    record.note = absl::StrCat("failed: ", wrong.status().message());
    record.wrong_pixels = light.shadowed_pixels;
  }
  if (options.certify_tolerance > 0.0 && method.options.method == Method::kDefault) {
    record.certificate = CertifyFit(view, light, request, method.options.standard, fit,
                                    options.certify_tolerance, options.certify_seconds);
  }
  if (artefacts != nullptr) {
    const absl::StatusOr<ArtefactRecord> measured =
        artefacts->Measure(light, method.options, request, fit, optimizer);
    if (measured.ok()) record.artefacts = *measured;
  }
  return record;
}

/// The paper's rows, and on to as many lights as a frame holds.
absl::StatusOr<std::vector<FrameTime>> MeasureFrames(const TruthScene& truth, const ViewStudy& view,
                                                     const ComparisonOptions& options) {
  constexpr std::pair<int, int> kRows[] = {{1, 500},  {1, 700},  {1, 1000}, {2, 500},   {2, 700},
                                           {2, 1000}, {3, 500},  {3, 700},  {3, 1000},  {4, 500},
                                           {4, 700},  {4, 1000}, {8, 1000}, {16, 1000}, {32, 1000}};
  constexpr int kRuns = 9;
  FrameRequest request = RequestOf(truth, view, options.screen);
  std::vector<uint32_t> bits;
  std::vector<FrameTime> times;
  std::vector<FrameOptimizer> optimizers(options.methods.size());
  const std::vector<Light> lights =
      PlaceLights(options.sets[0].placement, kMaxLights, options.seed, truth.ws_bounds(), options.view.ws_up);
  for (const auto& [count, side] : kRows) {
    while (request.lights.size() < static_cast<size_t>(count)) {
      const size_t i = request.lights.size();
      const absl::StatusOr<RaySpace> ray_space = RaySpace::Create(lights[i]);
      if (!ray_space.ok()) return ray_space.status();
      WriteBit(truth.TrueShadow(view.samples, *ray_space), static_cast<int>(i), &bits);
      LightRequest& light = request.lights.emplace_back();
      light.id = static_cast<uint32_t>(i);
      light.light = lights[i];
    }
    request.bits = BottomFirst(bits.data(), view.samples.width, view.samples.height);
    FrameTime& time = times.emplace_back();
    time.lights = count;
    time.map_size = {side, side};
    for (LightRequest& light : request.lights) light.map_size = time.map_size;
    for (size_t m = 0; m < options.methods.size(); ++m) {
      FrameTime::Stages fastest;
      for (int run = 0; run < kRuns; ++run) {
        FrameSummary summary;
        const absl::Status status =
            optimizers[m].Optimize(request, options.methods[m].options, Cancellation(), &summary);
        if (!status.ok()) return status;
        if (run > 0 && 1e3 * summary.total_seconds >= fastest.total) continue;
        fastest = {1e3 * summary.sampling_seconds, 1e3 * summary.total_seconds};
      }
      time.methods.push_back(fastest);
    }
  }
  return times;
}

}  // namespace

absl::StatusOr<Comparison> RunComparison(const Scene& scene, const ComparisonOptions& options,
                                         const ComparisonProgress& progress) {
  if (absl::Status status = Validate(options); !status.ok()) return status;
  absl::StatusOr<TruthScene> truth = TruthScene::Create(scene);
  if (!truth.ok()) return truth.status();

  Comparison comparison;
  comparison.scene = scene.name;
  comparison.triangles = truth->TriangleCount();
  comparison.options = options;
  comparison.options.view.aspect = double(options.screen.width) / options.screen.height;
  const absl::StatusOr<std::vector<StandPoint>> stand_points =
      ChooseStandPoints(*truth, scene.name, comparison.options);
  if (!stand_points.ok()) return stand_points.status();
  comparison.stand_points = *stand_points;

  std::vector<ViewStudy> views;
  for (const StandPoint& stand_point : comparison.stand_points) {
    const absl::StatusOr<Camera> camera =
        Camera::Create(CameraAt(stand_point, truth->ws_bounds(), comparison.options.view));
    if (!camera.ok()) return camera.status();
    views.push_back(ViewStudy::Create(*truth, *camera, options.screen, options.samples));
  }

  std::optional<RecordStore> store;
  if (!options.folder.empty()) {
    absl::StatusOr<RecordStore> opened = RecordStore::Open(options.folder, StudyJson(comparison));
    if (!opened.ok()) return opened.status();
    store = *std::move(opened);
  }

  // An optimizer a method, so that each keeps its memory warm as a stream of frames does.
  std::vector<FrameOptimizer> optimizers(options.methods.size());
  std::vector<std::optional<ArtefactStudy>> artefact_studies(views.size());
  int total = 0;
  for (const LightSet& set : options.sets) total += set.count;
  for (const LightSet& set : options.sets) {
    const std::vector<Light> lights = PlaceLights(set.placement, set.count, options.seed, truth->ws_bounds(),
                                                  comparison.options.view.ws_up);
    for (int i = 0; i < set.count; ++i) {
      LightRecord& record = comparison.lights.emplace_back();
      record.placement = set.placement;
      record.index = i;
      record.view = i % static_cast<int>(views.size());
      record.light = lights[static_cast<size_t>(i)];
      const ViewStudy& view = views[static_cast<size_t>(record.view)];
      std::optional<LightStudy> study;
      for (size_t m = 0; m < options.methods.size(); ++m) {
        const MethodVariant& method = options.methods[m];
        const bool with_artefacts = i < options.artefact_lights;
        const auto* line = store ? store->Find(set.placement, i, method.name) : nullptr;
        if (line != nullptr && Serves(line->record, method, with_artefacts, options)) {
          record.concerned_pixels = line->concerned_pixels;
          record.shadowed_pixels = line->shadowed_pixels;
          record.methods.push_back(line->record);
          continue;
        }
        if (!study) {
          absl::StatusOr<LightStudy> made = LightStudy::Create(*truth, view, record.light);
          if (!made.ok()) return made.status();
          study = *std::move(made);
          record.concerned_pixels = study->concerned_pixels;
          record.shadowed_pixels = study->shadowed_pixels;
        }
        std::optional<ArtefactStudy>& artefact_study = artefact_studies[static_cast<size_t>(record.view)];
        if (with_artefacts && !artefact_study) artefact_study.emplace(*truth, view, options.screen);
        record.methods.push_back(MeasureFit(*truth, view, *study, method, options, &optimizers[m],
                                            with_artefacts ? &*artefact_study : nullptr));
        if (!store) continue;
        const absl::Status status = store->Append({set.placement, i, method.name, record.concerned_pixels,
                                                   record.shadowed_pixels, record.methods.back()});
        if (!status.ok()) return status;
      }
      if (progress) progress(static_cast<int>(comparison.lights.size()), total);
    }
  }
  if (options.frame_times) {
    absl::StatusOr<std::vector<FrameTime>> times = MeasureFrames(*truth, views[0], comparison.options);
    if (!times.ok()) return times.status();
    comparison.times = *std::move(times);
  }
  return comparison;
}

}  // namespace shadowfit
