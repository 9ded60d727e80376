// Tests of samples against a triangle that is set up, for Highway's per-target code: included once for each
// target.

#if defined(SHADOWFIT_IRREGULAR_SAMPLE_TESTS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SHADOWFIT_IRREGULAR_SAMPLE_TESTS_INL_H_
#undef SHADOWFIT_IRREGULAR_SAMPLE_TESTS_INL_H_
#else
#define SHADOWFIT_IRREGULAR_SAMPLE_TESTS_INL_H_
#endif

#include <hwy/highway.h>

#include <algorithm>
#include <bit>
#include <cstring>

#include "core/irregular/simd.h"
#include "core/irregular/triangle_setup-inl.h"
#include "core/irregular/walk_kernels.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::irregular {
namespace HWY_NAMESPACE {

/// Triangles that are set up, as the tests of samples read them: triangle i of block b has the number b *
/// kSetupFloats + i.
struct Triangles {
  const float* rows;  ///< Row k of a triangle is rows[k * kBlock + number].
  const CasterCluster& cluster;
  bool slivers = false;  ///< There is one at least.

  HWY_INLINE bool IsSliver(uint32_t triangle) const {
    return slivers && !(rows[kSpread * kBlock + triangle] <= kSliverSpread);
  }
};

HWY_INLINE VF Broadcast(const float* triangle, int row) { return hn::Set(df, triangle[row * kBlock]); }

/// Of the lanes in `bits`, those where the cutout's texture is opaque.
HWY_NOINLINE uint32_t OpaqueLanes(const Triangles& t, uint32_t triangle, const float* u, const float* v,
                                  uint32_t bits) {
  const CasterCluster& cluster = t.cluster;
  const Caster& caster = *cluster.caster;
  glm::vec2 corner_uvs[3];
  for (size_t corner = 0; corner < 3; ++corner) {
    const size_t place = (triangle / kSetupFloats * 3 + corner) * kBlock + triangle % kSetupFloats;
    const size_t vertex = cluster.vertex_count == 0 ? place : cluster.corner_numbers()[place];
    corner_uvs[corner] = {cluster.uvs[2 * vertex], cluster.uvs[2 * vertex + 1]};
  }
  const float* const column = t.rows + triangle;
  uint32_t opaque = 0;
  for (uint32_t left = bits; left != 0; left &= left - 1) {
    const int i = std::countr_zero(left);
    const float r[3] = {u[i], v[i], 1.0f};
    // r is a combination of the corners with the opposite edges' functions as weights, so that these are the
    // barycentric coordinates of the hit in space, without any perspective correction.
    float weight[3];
    float sum = 0.0f;
    for (int corner = 0; corner < 3; ++corner) {
      const int edge = (corner + 1) % 3;
      float e = 0.0f;
      for (int k = 0; k < 3; ++k) e += column[(kEdge + 3 * edge + k) * kBlock] * r[k];
      weight[corner] = std::max(e, 0.0f);
      sum += weight[corner];
    }
    glm::vec2 uv(0.0f);
    for (int corner = 0; corner < 3; ++corner) {
      const float b = sum > 0.0f ? weight[corner] / sum : 1.0f / 3.0f;
      uv += b * corner_uvs[corner];
    }
    if (caster.alpha->AlphaAt(uv) >= caster.alpha_cutoff) opaque |= 1u << i;
  }
  return opaque;
}

/// Returns what was set before.
HWY_INLINE uint32_t SetBits(uint32_t* words, uint32_t first, uint32_t bits) {
  words += first / 32;
  uint64_t old;
  std::memcpy(&old, words, sizeof(old));
  const uint64_t all = old | uint64_t{bits} << (first % 32);
  std::memcpy(words, &all, sizeof(all));
  return static_cast<uint32_t>(old >> (first % 32));
}

HWY_INLINE void Absorb(const WalkTask& state, const Caster& caster, uint32_t first, uint32_t bits) {
  const auto lanes = hn::RebindMask(du, LanesOf(bits));
  for (int channel = 0; channel < state.channels; ++channel) {
    uint32_t* sums = state.absorbance[channel] + first;
    const auto more = hn::IfThenElseZero(lanes, hn::Set(du, caster.absorbance[channel]));
    hn::StoreU(hn::Min(hn::Add(hn::LoadU(du, sums), more), hn::Set(du, kAbsorbanceMax)), du, sums);
  }
}

HWY_INLINE void Record(const WalkTask& state, const Triangles& t, uint32_t triangle, uint32_t first,
                       uint32_t behind, uint32_t on) {
  const Caster& caster = *t.cluster.caster;
  if (caster.alpha != nullptr) {
    if ((behind | on) == 0) return;
    const uint32_t opaque =
        OpaqueLanes(t, triangle, state.samples.u + first, state.samples.v + first, behind | on);
    behind &= opaque;
    on &= opaque;
  }
  if (caster.transmits) {
    if (behind != 0) Absorb(state, caster, first, behind);
  } else if (behind != 0) {
    SetBits(state.shadow, first, behind);
  }
  if (on != 0) {
    const uint32_t again = SetBits(state.touched, first, on) & on;
    if (again != 0) SetBits(state.touched_twice, first, again);
  }
}

HWY_INLINE MF BetweenEnds(const float* triangle, VF u, VF v) {
  const VF reach = hn::Add(hn::Add(hn::Abs(u), hn::Abs(v)), Broadcast(triangle, kEndExtent));
  MF between = hn::Eq(u, u);
  for (int end = 0; end < 2; ++end) {
    const int n = kEnd + 3 * end;
    const VF e = hn::MulAdd(Broadcast(triangle, n), u,
                            hn::MulAdd(Broadcast(triangle, n + 1), v, Broadcast(triangle, n + 2)));
    between =
        hn::And(between, hn::Ge(hn::MulAdd(Broadcast(triangle, kEndMargin + end), reach, e), hn::Zero(df)));
  }
  return between;
}

/// Which samples lie in the cone of a triangle's corners.
struct EdgeTest {
  VF normal[3][3], threshold[3];

  HWY_INLINE explicit EdgeTest(const float* triangle) {
    for (int edge = 0; edge < 3; ++edge) {
      for (int i = 0; i < 3; ++i) normal[edge][i] = Broadcast(triangle, kEdge + 3 * edge + i);
      threshold[edge] = Broadcast(triangle, kThreshold + edge);
    }
  }

  /// Of kLanes samples from `first` on.
  HWY_INLINE uint32_t Inside(const SampleArrays& samples, uint32_t first) const {
    const VF u = hn::LoadU(df, samples.u + first);
    const VF v = hn::LoadU(df, samples.v + first);
    MF inside[3];
    for (int edge = 0; edge < 3; ++edge) {
      const VF* n = normal[edge];
      inside[edge] = hn::Gt(hn::MulAdd(n[0], u, hn::MulAdd(n[1], v, n[2])), threshold[edge]);
    }
    return BitsOf(hn::And(hn::And(inside[0], inside[1]), inside[2]));
  }
};

/// Lanes of a vector of samples.
struct PlaneLanes {
  uint32_t behind, on;
};

/// Which samples lie behind a triangle's plane, and which on it, within the error bound?
HWY_INLINE PlaneLanes TestPlane(const SampleArrays& samples, const Triangles& t, uint32_t triangle,
                                uint32_t first) {
  const float* column = t.rows + triangle;
  const VF u = hn::LoadU(df, samples.u + first);
  const VF v = hn::LoadU(df, samples.v + first);
  const VF depth = hn::LoadU(df, samples.depth + first);
  MF lanes = hn::Ge(depth, Broadcast(column, kNearest));
  if (t.IsSliver(triangle)) lanes = hn::And(lanes, BetweenEnds(column, u, v));
  const VF height =
      hn::MulAdd(Broadcast(column, kPlane), u,
                 hn::MulAdd(Broadcast(column, kPlane + 1), v,
                            hn::MulAdd(Broadcast(column, kPlane + 2), depth, Broadcast(column, kPlane + 3))));
  const VF bound = hn::Mul(Broadcast(column, kPlaneLength), hn::LoadU(df, samples.error + first));
  return {BitsOf(hn::And(lanes, hn::Gt(height, bound))),
          BitsOf(hn::And(lanes, hn::Le(hn::Abs(height), bound)))};
}

/// Of the samples in `inside`, which lie in the cone of the corners: are they behind the triangle?
HWY_INLINE void TestHit(const WalkTask& state, const Triangles& t, uint32_t triangle, uint32_t first,
                        uint32_t inside) {
  const PlaneLanes lanes = TestPlane(state.samples, t, triangle, first);
  Record(state, t, triangle, first, lanes.behind & inside, lanes.on & inside);
}

/// A run of sorted samples.
HWY_INLINE void TestRun(const WalkTask& state, const Triangles& t, uint32_t triangle, uint32_t first,
                        uint32_t end) {
  const EdgeTest test(t.rows + triangle);
  for (uint32_t s = first; s < end; s += kLanes) {
    const uint32_t live = FirstBits(end - s) & ~BitsAt(state.shadow, s);
    if (live == 0) continue;
    const uint32_t inside = test.Inside(state.samples, s) & live;
    if (inside != 0) TestHit(state, t, triangle, s, inside);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace shadowfit::irregular
HWY_AFTER_NAMESPACE();

#endif
