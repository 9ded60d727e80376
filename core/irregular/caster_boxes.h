#pragma once

#include <cstddef>
#include <span>

#include "core/cancellation.h"
#include "core/irregular/aligned_buffer.h"
#include "core/irregular/light_plan.h"
#include "core/irregular/mask_scene.h"
#include "core/irregular/walk_kernels.h"

namespace shadowfit::irregular {

/// Where a light sees the clusters: boxes in the plane coordinates of each face, so that a piece of the
/// samples finds those that may shadow it quickly.
class CasterBoxes {
 public:
  /// Of clusters that lie in several places, one after the other. False where memory runs out. Incomplete
  /// once `cancellation` (may be null) asks.
  [[nodiscard]] bool Compute(std::span<const std::span<const MaskScene::Cluster>> parts,
                             const LightPlan& plan, const Cancellation* cancellation);

  /// The boxes as a face sees them; numbered through all parts.
  BoxArrays Of(int face) const;

  /// What Compute() needs for so many clusters.
  static size_t BytesFor(size_t clusters, const LightPlan& plan);
  size_t MemoryBytes() const { return values_.MemoryBytes(); }

 private:
  size_t stride_ = 0;
  AlignedBuffer<float> values_;
};

}  // namespace shadowfit::irregular
