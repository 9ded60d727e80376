#include "client/demo/resolution_study.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

#include "absl/strings/str_format.h"
#include "client/demo/walk_record.h"

namespace shadowfit {
namespace {

using SteadyClock = std::chrono::steady_clock;

double MillisecondsSince(SteadyClock::time_point start) {
  return std::chrono::duration<double, std::milli>(SteadyClock::now() - start).count();
}

/// Of a directional light's map, world units; of others, on the plane at distance 1.
absl::StatusOr<double> MapArea(const LightView& view) {
  const absl::StatusOr<RaySpace> ray_space = RaySpace::Create(view.light);
  if (!ray_space.ok()) return ray_space.status();
  ShadowProjection projection;
  if (!ProjectionFromClip(*ray_space, view.clip_from_world, view.map_size, &projection)) {
    return absl::InternalError("a matrix is not its light's");
  }
  // Ordinary projections: w is the third ray coordinate or 1, up to a rotation.
  return view.map_size.texels() / std::abs(glm::determinant(projection.texel_from_ray));
}

double Larger(MapSize size) { return std::max(size.width, size.height); }

}  // namespace

absl::StatusOr<std::unique_ptr<ResolutionStudy>> ResolutionStudy::Create(Renderer* renderer, const Walk& walk,
                                                                         int frames) {
  std::vector<size_t> lights;
  bool has_spot = false;
  ResolutionFigures figures;
  figures.screen = renderer->options().screen;
  for (size_t i = 0; i < walk.lights.size(); ++i) {
    const bool spot = std::holds_alternative<SpotLight>(walk.lights[i].light);
    if (!std::holds_alternative<DirectionalLight>(walk.lights[i].light) && (!spot || has_spot)) continue;
    has_spot = has_spot || spot;
    lights.push_back(i);
    figures.lights.emplace_back().light = walk.lights[i].name;
  }
  const int last = static_cast<int>(walk.cameras.size()) - 1;
  const int count = std::min(frames, last + 1);
  for (int i = 0; i < count; ++i) figures.frames.push_back(count > 1 ? i * last / (count - 1) : 0);
  absl::StatusOr<ShadowMaps> fixed_maps =
      renderer->CreateShadowMaps(std::vector<MapSize>{{figures.limit, figures.limit}});
  if (!fixed_maps.ok()) return fixed_maps.status();
  std::unique_ptr<ResolutionStudy> study(
      new ResolutionStudy(renderer, std::move(lights), *std::move(fixed_maps)));
  study->figures_ = std::move(figures);
  return study;
}

absl::StatusOr<double> ResolutionStudy::Milliseconds(const LightView& view, ShadowMaps* maps) {
  const SteadyClock::time_point start = SteadyClock::now();
  if (absl::Status status = renderer_->DrawShadowMaps(std::span(&view, 1), maps); !status.ok()) return status;
  renderer_->Finish();
  return MillisecondsSince(start);
}

absl::Status ResolutionStudy::AddFrame(size_t frame, const CameraMatrices& camera, const DepthView& depth,
                                       std::span<const LightView> normal) {
  if (!std::binary_search(figures_.frames.begin(), figures_.frames.end(), static_cast<int>(frame))) {
    return absl::OkStatus();
  }
  const SteadyClock::time_point study_start = SteadyClock::now();
  for (size_t i = 0; i < lights_.size(); ++i) {
    LightView view = normal[lights_[i]];
    ResolutionRecord& record = figures_.lights[i];
    ResolutionRequest request{.camera = camera, .depth = depth, .screen = {}, .lights = {}};
    request.lights.push_back({.id = 0, .light = view.light, .clip_from_world = {}});
    ResolutionOptions options{.max_size = figures_.limit};
    ResolutionSummary summary;
    absl::Status status = estimator_.Estimate(request, options, Cancellation(), &summary);
    if (!status.ok()) return status;
    record.estimate_ms.push_back(summary.seconds * 1e3);
    const MapEstimate published = summary.lights[0].maps[0];
    options.percentile = 99.0;
    if (status = estimator_.Estimate(request, options, Cancellation(), &summary); !status.ok()) return status;
    const MapEstimate& reduced = summary.lights[0].maps[0];
    record.recommended.push_back(Larger(published.recommended));
    record.recommended_99.push_back(Larger(reduced.recommended));

    view.map_size = {figures_.limit, figures_.limit};
    const absl::StatusOr<double> whole_area = MapArea(view);
    if (!whole_area.ok()) return whole_area.status();
    const absl::StatusOr<double> fixed_ms = Milliseconds(view, &fixed_maps_);
    if (!fixed_ms.ok()) return fixed_ms.status();
    record.fixed_ms.push_back(*fixed_ms);

    view.map_size = reduced.recommended;
    view.clip_from_world = reduced.clip_from_world;
    const absl::StatusOr<double> area = MapArea(view);
    if (!area.ok()) return area.status();
    record.share_used.push_back(100.0 * *area / *whole_area);
    absl::StatusOr<ShadowMaps> maps = renderer_->CreateShadowMaps(std::span(&view.map_size, 1));
    if (!maps.ok()) return maps.status();
    // The second time, when its memory is as warm as the fixed map's.
    absl::StatusOr<double> reduced_ms = Milliseconds(view, &*maps);
    if (reduced_ms.ok()) reduced_ms = Milliseconds(view, &*maps);
    if (!reduced_ms.ok()) return reduced_ms.status();
    record.reduced_ms.push_back(*reduced_ms);
  }
  figures_.seconds += 1e-3 * MillisecondsSince(study_start);
  return absl::OkStatus();
}

nlohmann::json ResolutionJson(const ResolutionFigures& figures) {
  nlohmann::json document{{"screen", {{"width", figures.screen.width}, {"height", figures.screen.height}}},
                          {"limit", figures.limit},
                          {"frames", figures.frames},
                          {"lights", nlohmann::json::array()}};
  for (const ResolutionRecord& record : figures.lights) {
    document["lights"].push_back({{"name", record.light},
                                  {"recommended", record.recommended},
                                  {"recommended99", record.recommended_99},
                                  {"shareUsedPercent", record.share_used},
                                  {"estimateMilliseconds", record.estimate_ms},
                                  {"reducedMapMilliseconds", record.reduced_ms},
                                  {"fixedMapMilliseconds", record.fixed_ms}});
  }
  return document;
}

std::string ResolutionTable(const ResolutionFigures& figures) {
  std::string text = absl::StrFormat(
      "\nNeeded maps, larger side in texels, limit %d, median of %d frames of the walk\n\n%-15s %10s %10s "
      "%9s "
      "%12s %16s %14s\n",
      figures.limit, figures.frames.size(), "light", "all pixels", "99 %", "frustum", "estimate, ms",
      "its map (99 %)", absl::StrFormat("%dx%d map", figures.limit, figures.limit));
  for (const ResolutionRecord& record : figures.lights) {
    const auto median = [](const std::vector<double>& values) { return Percentile(values, 0.5); };
    absl::StrAppendFormat(&text, "%-15s %10.0f %10.0f %7.1f %% %12.2f %13.1f ms %11.1f ms\n", record.light,
                          median(record.recommended), median(record.recommended_99),
                          median(record.share_used), median(record.estimate_ms), median(record.reduced_ms),
                          median(record.fixed_ms));
  }
  return text;
}

}  // namespace shadowfit
