#pragma once

#include <cstddef>
#include <cstdint>

#include "core/irregular/aligned_buffer.h"
#include "core/irregular/walk_kernels.h"

namespace shadowfit::irregular {

/// How deep the samples of a band lie that no caster is known to block yet: clusters of triangles behind all
/// of them, or in the shadow of others, can be left out. A sample whose bit is set stays in shadow, so that
/// no answer changes.
class LiveDepths {
 public:
  /// Memory for so many samples. False where it runs out.
  [[nodiscard]] bool Reserve(size_t samples);

  /// Looks at all samples of the task's rows; sets task->farthest_live.
  void Update(WalkTask* task);

  size_t MemoryBytes() const { return farthest_.MemoryBytes(); }

 private:
  AlignedBuffer<float> farthest_;
};

/// Whether any live sample lies in a box in plane coordinates, as deep as its nearest point at least. The
/// box reaches into the task's rows. Samples that have died since the last Update() are not live.
bool ReachesLiveSamples(const WalkTask& task, const BoxArrays& boxes, size_t box);

}  // namespace shadowfit::irregular
