#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "core/irregular/caster_boxes.h"
#include "core/irregular/live_depths.h"
#include "core/irregular/walk_kernels.h"

namespace shadowfit::irregular {

/// What all pieces of all lights share.
struct CasterInput {
  std::span<const CasterSegment> segments;
  std::span<const Caster> casters;  ///< By material.
  const std::vector<float>* uvs = nullptr;
  int channels = 3;  ///< Of absorbance; one where all casters are grey.
};

/// Streams clusters of triangles over the samples of a band: those whose boxes overlap them and lie before
/// some that may still be lit. Keeps its memory.
class ClusterWalk {
 public:
  /// Memory for a band of so many samples. False where it runs out.
  [[nodiscard]] bool Reserve(size_t samples) { return live_.Reserve(samples); }

  /// False where memory runs out. Incomplete once cancelled. `boxes` are those of the task's face.
  [[nodiscard]] bool Run(WalkTask task, const BoxArrays& boxes, const CasterInput& casters);

  size_t MemoryBytes() const { return live_.MemoryBytes(); }

 private:
  LiveDepths live_;
};

}  // namespace shadowfit::irregular
