#include "client/compare/artefact_study.h"

#include <algorithm>
#include <cmath>
#include <glm/ext/matrix_transform.hpp>
#include <numbers>
#include <vector>

#include "core/bias/surface_samples.h"

namespace shadowfit {
namespace {

/// Of the camera, from one frame to the next.
constexpr double kTurn = std::numbers::pi / 180.0;

/// The last first: the maps before it hide it where they hold a point, too.
std::vector<const LightMap*> MapsOf(const LightSummary& fit) {
  std::vector<const LightMap*> maps;
  for (const LightMap& map : fit.further_maps) maps.insert(maps.begin(), &map);
  maps.push_back(&fit);
  return maps;
}

ShadowMask LitEverywhere(const ShadowMask& truth) {
  ShadowMask mask = truth;
  std::ranges::replace(mask, PixelLight::kShadowed, PixelLight::kLit);
  return mask;
}

}  // namespace

void ArtefactStudy::Overlay(const LightMap& map, const RaySpace& ray_space, const ShadowMask& of_map,
                            ShadowMask* mask) const {
  for (size_t i = 0; i < mask->size(); ++i) {
    if ((*mask)[i] == PixelLight::kNotConcerned) continue;
    if (map.projection.Holds(ray_space.RayFromPoint(view_.screen.ws_point[i]))) (*mask)[i] = of_map[i];
  }
}

ArtefactStudy::ArtefactStudy(const TruthScene& truth, const ViewStudy& view, MapSize screen)
    : truth_(truth), view_(view), screen_(screen) {
  // About the view's vertical axis, which passes through the viewer.
  turned_matrices_ = {glm::rotate(glm::dmat4(1.0), kTurn, {0.0, 1.0, 0.0}) * view.camera.view_from_world(),
                      view.camera.clip_from_view(), view.camera.clip_depth()};
  const absl::StatusOr<Camera> turned = Camera::Create(turned_matrices_);
  if (!turned.ok()) return;  // The first camera was regular, and so is a rotation.
  clip_from_world_turned_ = turned->clip_from_world();
  turned_samples_ = truth.RenderSurface(*turned, view.samples.width, view.samples.height);
}

absl::StatusOr<ArtefactRecord> ArtefactStudy::Measure(const LightStudy& light, const Options& options,
                                                      const FrameRequest& request, const LightSummary& fit,
                                                      FrameOptimizer* optimizer) const {
  // 1. One frame. The bias comes from the small depth buffer, as the service makes it.
  const SurfaceSamples samples = SamplesFromDepth(view_.camera, request.depth);
  ShadowMask ideal = LitEverywhere(light.screen);
  ShadowMask shown = ideal;
  for (const LightMap* part : MapsOf(fit)) {
    StandardTest test{.format = DepthFormat::kUnorm24};
    const absl::StatusOr<SafeBias> bias =
        FindSafeBias(view_.camera, samples.ws_point, samples.ws_normal, light.ray_space, part->projection,
                     part->depth_range, {.format = test.format, .screen = screen_}, request.depth);
    if (!bias.ok()) return bias.status();
    test.constant = bias->constant;
    test.slope = bias->slope;
    test.clamp = bias->clamp;
    const absl::StatusOr<StandardMap> map =
        RenderStandardMap(truth_, light.ray_space, part->projection, part->depth_range, test.casters);
    if (!map.ok()) return map.status();
    Overlay(*part, light.ray_space,
            ShadowWithoutDepthErrors(*map, 0, view_.screen, light.screen, light.ray_space), &ideal);
    Overlay(*part, light.ray_space,
            ShadowFromStandardMap(*map, test, view_.screen, light.screen, light.ray_space), &shown);
  }
  ArtefactRecord record;
  record.counts = CountArtefacts(light.screen, ideal, shown);

  // 2. The next one, with the memory of the first. Aliasing alone counts: what depth errors add has been
  // counted above.
  FrameRequest next = request;
  next.camera = turned_matrices_;
  next.depth = turned_samples_.Depth();
  std::vector<uint32_t> bits;
  WriteBit(truth_.TrueShadow(turned_samples_, light.ray_space), 0, &bits);
  next.bits = BottomFirst(bits.data(), turned_samples_.width, turned_samples_.height);
  next.lights[0].previous_clip_from_world = fit.clip_from_world;
  FrameSummary summary;
  if (absl::Status status = optimizer->Optimize(next, options, Cancellation(), &summary); !status.ok()) {
    return status;
  }
  ShadowMask after = LitEverywhere(light.screen);
  for (const LightMap* part : MapsOf(summary.lights[0])) {
    const absl::StatusOr<StandardMap> map =
        RenderStandardMap(truth_, light.ray_space, part->projection, part->depth_range);
    if (!map.ok()) return map.status();
    Overlay(*part, light.ray_space,
            ShadowWithoutDepthErrors(*map, 0, view_.screen, light.screen, light.ray_space), &after);
  }
  for (size_t i = 0; i < after.size(); ++i) {
    const glm::dvec4 clip = clip_from_world_turned_ * glm::dvec4(view_.screen.ws_point[i], 1.0);
    const bool still_visible = std::abs(clip.x) <= clip.w && std::abs(clip.y) <= clip.w;
    if (!still_visible) after[i] = ideal[i];
  }
  record.flicker = CountFlicker(light.screen, ideal, light.screen, after);
  return record;
}

}  // namespace shadowfit
