#pragma once

#include <cstddef>
#include <span>

#include "core/irregular/caster_boxes.h"
#include "core/irregular/live_depths.h"
#include "core/irregular/walk_kernels.h"

namespace shadowfit::irregular {

/// What all pieces of all lights share.
struct CasterInput {
  const MaskScene* scene = nullptr;
  std::span<const glm::mat4x3* const> moved;  ///< By instance, null where it is not; or empty.
  std::span<const Caster> casters;            ///< By material.
  int channels = 3;                           ///< Of absorbance; one where all casters are grey.
};

/// Streams clusters of triangles over the samples of a band: those whose boxes overlap them and lie before
/// some that may still be lit, which `depths` keeps. `boxes` are those of the task's face. False where memory
/// runs out. Incomplete once cancelled.
[[nodiscard]] bool WalkClusters(WalkTask task, const BoxArrays& boxes, const CasterInput& casters,
                                LiveDepths* depths);

}  // namespace shadowfit::irregular
