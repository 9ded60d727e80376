// Runs of samples in the rows that a triangle covers, for Highway's per-target code: included once for each
// target.

#if defined(SHADOWFIT_IRREGULAR_SAMPLE_RUNS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SHADOWFIT_IRREGULAR_SAMPLE_RUNS_INL_H_
#undef SHADOWFIT_IRREGULAR_SAMPLE_RUNS_INL_H_
#else
#define SHADOWFIT_IRREGULAR_SAMPLE_RUNS_INL_H_
#endif

#include <hwy/cache_control.h>
#include <hwy/highway.h>

#include <algorithm>
#include <bit>

#include "core/irregular/outline-inl.h"
#include "core/irregular/sample_tests-inl.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::irregular {
namespace HWY_NAMESPACE {

/// Collects runs of samples and tests them later, in steps that have few branches to foretell, and with the
/// loads of the next runs under way.
class RunQueue {
 public:
  RunQueue(const WalkTask& state, const Triangles& triangles) : state_(state), triangles_(triangles) {}

  /// In each lane the samples of cells [first, last], against that lane's triangle.
  HWY_INLINE void Add(VU triangle, VI first_cell, VI last_cell, MF lanes) {
    const int* starts = reinterpret_cast<const int*>(state_.cell_start);
    const VI first = hn::GatherIndex(di, starts, first_cell);
    // The last cell's run would go on over the gap after it, whose answers reach into another thread's.
    const VI end = hn::Min(hn::GatherIndex(di, starts, hn::Add(last_cell, hn::Set(di, 1))),
                           hn::Set(di, static_cast<int32_t>(state_.end_sample)));
    const MF keep = hn::And(lanes, hn::RebindMask(df, hn::Lt(first, end)));
    hn::StoreU(hn::Compress(first, hn::RebindMask(di, keep)), di, first_ + count_);
    hn::StoreU(hn::Compress(end, hn::RebindMask(di, keep)), di, end_ + count_);
    hn::StoreU(hn::Compress(triangle, hn::RebindMask(du, keep)), du, triangle_ + count_);
    count_ += static_cast<uint32_t>(std::popcount(BitsOf(keep)));
    if (count_ > kCapacity) Flush();
  }

  bool empty() const { return count_ == 0; }

  HWY_NOINLINE void Flush() {
    const uint32_t count = count_;
    count_ = 0;
    // 1. Which samples are inside the edges.
    const SampleArrays samples = state_.samples;
    uint32_t* const shadow = state_.shadow;
    for (uint32_t i = 0; i < std::min(kAhead, count); ++i) Prefetch(samples, i);
    for (uint32_t i = 0; i < count; ++i) {
      Prefetch(samples, std::min(i + kAhead, count - 1));
      const uint32_t triangle = triangle_[i];
      const auto end = static_cast<uint32_t>(end_[i]);
      const EdgeTest test(triangles_.rows + triangle);
      uint32_t hit_count = hit_count_;
      for (auto s = static_cast<uint32_t>(first_[i]); s < end; s += kLanes) {
        const uint32_t live = FirstBits(end - s) & ~BitsAt(shadow, s);
        const uint32_t inside = test.Inside(samples, s) & live;
        hits_[hit_count] = {s, static_cast<uint16_t>(inside), static_cast<uint16_t>(triangle)};
        hit_count += static_cast<uint32_t>(inside != 0);
        if (hit_count == kCapacity) {
          hit_count_ = hit_count;
          TestHits();
          hit_count = 0;
        }
      }
      hit_count_ = hit_count;
    }
    // 2. Where those samples are.
    TestHits();
  }

 private:
  static constexpr uint32_t kCapacity = 128;
  static constexpr uint32_t kAhead = 6;

  struct Hit {
    uint32_t first;
    uint16_t inside;
    uint16_t triangle;
  };

  HWY_INLINE void Prefetch(const SampleArrays& samples, uint32_t i) const {
    hwy::Prefetch(samples.u + first_[i]);
    hwy::Prefetch(samples.v + first_[i]);
  }

  HWY_INLINE void TestHits() {
    for (uint32_t i = 0; i < hit_count_; ++i) {
      TestPlane(state_, triangles_, hits_[i].triangle, hits_[i].first, hits_[i].inside);
    }
    hit_count_ = 0;
  }

  const WalkTask& state_;
  const Triangles& triangles_;
  int32_t first_[kCapacity + 2 * kBlock], end_[kCapacity + 2 * kBlock];
  uint32_t triangle_[kCapacity + 2 * kBlock];
  uint32_t count_ = 0;
  Hit hits_[kCapacity + 1];
  uint32_t hit_count_ = 0;
};

/// A larger outline: the range of u that it covers in each row, kLanes rows at a time. In the slab of a row
/// the extremes are at corners inside it and where edges cross its two borders.
HWY_NOINLINE void TestRows(const WalkTask& task, int triangle, const Outline& o, RunQueue* queue) {
  const Face& face = *task.face;
  const int row_begin = std::max(face.RowAt(o.v_min - o.pad).number, task.row_begin);
  const int row_end = std::min(face.RowAt(o.v_max + o.pad).number + 1, task.row_end);
  struct Edge {
    float u, v, v_end, slope;
  };
  Edge edges[8];
  int edge_count = 0;
  for (int i = 0; i < o.corners; ++i) {
    const int j = (i + 1) % o.corners;
    const int low = o.v[i] <= o.v[j] ? i : j;
    const int high = low == i ? j : i;
    if (!(o.v[low] < o.v[high])) continue;
    edges[edge_count++] = {o.u[low], o.v[low], o.v[high], (o.u[high] - o.u[low]) / (o.v[high] - o.v[low])};
  }
  const VF pad = hn::Set(df, o.pad);
  for (int row = row_begin; row < row_end; row += kLanes) {
    const auto at = static_cast<size_t>(row);
    const VF slab_low = hn::Sub(hn::LoadU(df, &face.row_v_low[at]), pad);
    const VF slab_high = hn::Add(hn::LoadU(df, &face.row_v_high[at]), pad);
    VF low = hn::Set(df, kInfinity);
    VF high = hn::Set(df, -kInfinity);
    for (int i = 0; i < o.corners; ++i) {
      const VF u = hn::Set(df, o.u[i]);
      const VF v = hn::Set(df, o.v[i]);
      const MF inside = hn::And(hn::Ge(v, slab_low), hn::Le(v, slab_high));
      low = hn::IfThenElse(inside, hn::Min(low, u), low);
      high = hn::IfThenElse(inside, hn::Max(high, u), high);
    }
    for (int i = 0; i < edge_count; ++i) {
      const Edge& edge = edges[i];
      for (const VF border : {slab_low, slab_high}) {
        const MF crosses =
            hn::And(hn::Gt(border, hn::Set(df, edge.v)), hn::Lt(border, hn::Set(df, edge.v_end)));
        const VF u =
            hn::MulAdd(hn::Sub(border, hn::Set(df, edge.v)), hn::Set(df, edge.slope), hn::Set(df, edge.u));
        low = hn::IfThenElse(crosses, hn::Min(low, u), low);
        high = hn::IfThenElse(crosses, hn::Max(high, u), high);
      }
    }
    const VI rows = hn::Iota(di, row);
    const VI listed = hn::Min(rows, hn::Set(di, face.rows - 1));
    const RowLanes cells(face, hn::GatherIndex(di, face.first_bin_of_row.data(), listed));
    const MF lanes = hn::And(hn::Le(low, high), hn::RebindMask(df, hn::Lt(rows, hn::Set(di, row_end))));
    queue->Add(hn::Set(du, static_cast<uint32_t>(triangle)), cells.CellAt(hn::Sub(low, pad)),
               cells.CellAt(hn::Add(high, pad)), lanes);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace shadowfit::irregular
HWY_AFTER_NAMESPACE();

#endif
