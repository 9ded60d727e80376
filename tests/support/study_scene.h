#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "client/scene_io/load_scene.h"
#include "core/fit/frame_optimizer.h"
#include "core/reference/truth_scene.h"
#include "core/reference/view_study.h"

namespace shadowfit::testing {

/// The scene that LoadScene() knows by this name, in the ray tracer.
inline absl::StatusOr<TruthScene> LoadTruth(const std::string& scene_name) {
  const absl::StatusOr<Scene> scene = LoadScene(scene_name);
  if (!scene.ok()) return scene.status();
  return TruthScene::Create(*scene);
}

/// What an optimizer gets to see of one light in one view. Borrows both.
inline FrameRequest RequestFor(const TruthScene& truth, const ViewStudy& view, const LightStudy& light,
                               MapSize map_size) {
  FrameRequest request;
  request.camera = {view.camera.view_from_world(), view.camera.clip_from_view(), view.camera.clip_depth()};
  request.depth = view.samples.Depth();
  request.bits = light.Bits(view);
  request.screen = {view.screen.width, view.screen.height};
  request.ws_scene_bounds = truth.ws_bounds();
  request.lights.resize(1);
  request.lights[0].light = light.light;
  request.lights[0].map_size = map_size;
  return request;
}

}  // namespace shadowfit::testing
