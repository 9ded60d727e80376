// A cluster's triangles in blocks, for Highway's per-target code: included once for each target.

#if defined(SHADOWFIT_IRREGULAR_CLUSTER_UNPACK_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SHADOWFIT_IRREGULAR_CLUSTER_UNPACK_INL_H_
#undef SHADOWFIT_IRREGULAR_CLUSTER_UNPACK_INL_H_
#else
#define SHADOWFIT_IRREGULAR_CLUSTER_UNPACK_INL_H_
#endif

#include <hwy/highway.h>

#include "core/irregular/simd.h"
#include "core/irregular/walk_kernels.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::irregular {
namespace HWY_NAMESPACE {

/// From object to world space, rounded as GLM rounds it: where the shadow rays' triangles are, too.
class Placement {
 public:
  HWY_INLINE explicit Placement(const glm::mat4x3* world_from_object) : matrix_(world_from_object) {}

  HWY_INLINE void Apply(VF position[3]) const {
    if (matrix_ == nullptr) return;
    const VF x = position[0], y = position[1], z = position[2];
    for (int row = 0; row < 3; ++row) {
      const auto factor = [&](int column) HWY_ATTR { return hn::Set(df, (*matrix_)[column][row]); };
      const VF xy = hn::Add(hn::Mul(factor(0), x), hn::Mul(factor(1), y));
      position[row] = hn::Add(hn::Add(xy, hn::Mul(factor(2), z)), factor(3));
    }
  }

 private:
  const glm::mat4x3* matrix_;
};

/// Separate corners, elsewhere.
HWY_INLINE void PlaceCorners(const CasterCluster& cluster, const Placement& placement, float* blocks) {
  for (size_t corner = 0; corner < size_t{cluster.block_count} * 3; ++corner) {
    for (size_t at = corner * 3 * kBlock; at < (corner * 3 + 1) * kBlock; at += kLanes) {
      VF p[3];
      for (size_t axis = 0; axis < 3; ++axis) p[axis] = hn::Load(df, cluster.lines + at + axis * kBlock);
      placement.Apply(p);
      for (size_t axis = 0; axis < 3; ++axis) hn::Store(p[axis], df, blocks + at + axis * kBlock);
    }
  }
}

/// Any number of shared vertices: one load each brings x, y and z.
HWY_INLINE void LookUpInMemory(const CasterCluster& cluster, const Placement& placement, float* blocks) {
  const uint8_t* const numbers = cluster.corner_numbers();
  for (size_t corner = 0; corner < size_t{cluster.block_count} * 3; ++corner) {
    for (size_t lane = 0; lane < kBlock; lane += kLanes) {
      VF p[4];
      for (size_t k = 0; k < 4; ++k) {
        p[k] = EveryFourth(df, cluster.vertices(), numbers + corner * kBlock + lane + k);
      }
      TransposeBlocks(p);
      placement.Apply(p);
      for (size_t axis = 0; axis < 3; ++axis) {
        hn::Store(p[axis], df, blocks + (corner * 3 + axis) * kBlock + lane);
      }
    }
  }
}

#if HWY_MAX_BYTES == 64
/// Up to kMostInRegisters shared vertices: four registers hold one coordinate of all.
constexpr uint32_t kMostInRegisters = 64;

HWY_INLINE void LookUpInRegisters(const CasterCluster& cluster, const Placement& placement, float* blocks) {
  VF table[3][4];
  for (size_t group = 0; group < 4; ++group) {
    VF p[4];
    for (size_t k = 0; k < 4; ++k) {
      const size_t first = 16 * group + 4 * k;
      p[k] = first < cluster.vertex_count ? hn::LoadU(df, cluster.vertices() + 4 * first) : hn::Zero(df);
    }
    TransposeBlocks(p);
    placement.Apply(p);
    for (size_t axis = 0; axis < 3; ++axis) table[axis][group] = p[axis];
  }
  for (size_t corner = 0; corner < size_t{cluster.block_count} * 3; ++corner) {
    const hn::Rebind<uint8_t, DF> bytes;
    const VU number = hn::PromoteTo(du, hn::Load(bytes, cluster.corner_numbers() + corner * kBlock));
    // A group's vertex 4 i + j came from lane 4 j of vector i to lane 4 j + i.
    const VU lane = hn::Or(hn::And(hn::ShiftLeft<2>(number), hn::Set(du, 12)),
                           hn::And(hn::ShiftRight<2>(number), hn::Set(du, 3)));
    const auto index = hn::IndicesFromVec(df, lane);
    const VU group = hn::ShiftRight<4>(number);
    for (size_t axis = 0; axis < 3; ++axis) {
      VF value = hn::TableLookupLanes(table[axis][0], index);
      for (uint32_t g = 1; g < 4; ++g) {
        const MF in_group = hn::RebindMask(df, hn::Eq(group, hn::Set(du, g)));
        value = hn::IfThenElse(in_group, hn::TableLookupLanes(table[axis][g], index), value);
      }
      hn::Store(value, df, blocks + (corner * 3 + axis) * kBlock);
    }
  }
}
#endif

/// The cluster's triangles in the world, in blocks of nine rows a.x a.y a.z b.x .. c.z: where they are, or in
/// `blocks`, which has room for kClusterBlocks.
HWY_NOINLINE const float* Unpack(const CasterCluster& cluster, float* blocks) {
  const Placement placement(cluster.world_from_object);
  if (cluster.vertex_count == 0) {
    if (cluster.world_from_object == nullptr) return cluster.lines;
    PlaceCorners(cluster, placement, blocks);
    return blocks;
  }
#if HWY_MAX_BYTES == 64
  if (cluster.vertex_count <= kMostInRegisters) {
    LookUpInRegisters(cluster, placement, blocks);
    return blocks;
  }
#endif
  LookUpInMemory(cluster, placement, blocks);
  return blocks;
}

}  // namespace HWY_NAMESPACE
}  // namespace shadowfit::irregular
HWY_AFTER_NAMESPACE();

#endif
