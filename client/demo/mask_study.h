#pragma once

#include <memory>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/client.h"
#include "client/demo/walk.h"
#include "client/render/picture_pass.h"
#include "core/reference/visible_surface.h"
#include "core/scene/scene.h"

namespace shadowfit {

/// Exact masks of one light beside the shadow map, a value a studied frame.
struct MaskRecord {
  std::string light;
  std::vector<int> wrong_by_map;
  std::vector<int> wrong_by_mask;  ///< Where rounding of the depth buffer decides.
  std::vector<int> undecided;      ///< Pixels of the mask that rounding leaves open.
  std::vector<double> mask_ms;     ///< The service's compute time.
};

struct MaskFigures {
  std::vector<int> frames;
  std::vector<MaskRecord> lights;
  double upload_seconds = 0.0;  ///< Of the scene, once.
};

/// Renders alias-free masks of the walk's pictures through the service, for a scene that is uploaded once.
class MaskStudy {
 public:
  /// `client` must outlive the study.
  static absl::StatusOr<std::unique_ptr<MaskStudy>> Create(Client* client, const Scene& scene,
                                                           const Walk& walk);

  /// `truth` and `by_map` are the rays' and the shadow maps' answers, one a light. Returns the masks'.
  absl::StatusOr<std::vector<ShadowMask>> AddFrame(size_t frame, const CameraMatrices& camera,
                                                   const VisibleSurface& surface,
                                                   std::span<const ShadowMask> truth,
                                                   std::span<const ShadowMask> by_map);

  const MaskFigures& figures() const { return figures_; }

 private:
  MaskStudy(Client* client, PackedScene scene, std::vector<SceneLight> lights);

  Client* client_;
  const PackedScene scene_;
  const std::vector<SceneLight> lights_;
  MaskFigures figures_;
};

/// Shadows alone: the brighter the more lights reach a pixel.
Picture ShadowPicture(const VisibleSurface& surface, std::span<const ShadowMask> shadows);

nlohmann::json MaskJson(const MaskFigures& figures);

/// The table for people.
std::string MaskTable(const MaskFigures& figures);

}  // namespace shadowfit
