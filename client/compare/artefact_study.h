#pragma once

#include <glm/glm.hpp>

#include "absl/status/statusor.h"
#include "client/compare/comparison.h"
#include "core/fit/frame_optimizer.h"
#include "core/reference/view_study.h"

namespace shadowfit {

/// What the maps of one view look like in a renderer: with depth of 24 bits and the safe bias, and from one
/// frame to the next while the camera turns on the spot.
class ArtefactStudy {
 public:
  /// `screen` is the size of the final picture. Both must outlive the study.
  ArtefactStudy(const TruthScene& truth, const ViewStudy& view, MapSize screen);

  /// `request` is the method's for the view, `fit` its answer. One method's artefacts for one light.
  absl::StatusOr<ArtefactRecord> Measure(const LightStudy& light, const Options& options,
                                         const FrameRequest& request, const LightSummary& fit,
                                         FrameOptimizer* optimizer) const;

 private:
  /// What the map says, where it holds a pixel's point.
  void Overlay(const LightMap& map, const RaySpace& ray_space, const ShadowMask& of_map,
               ShadowMask* mask) const;

  const TruthScene& truth_;
  const ViewStudy& view_;
  const MapSize screen_;
  CameraMatrices turned_matrices_;
  glm::dmat4 clip_from_world_turned_{1.0};
  VisibleSurface turned_samples_;
};

}  // namespace shadowfit
