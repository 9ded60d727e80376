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

/// Collects runs of samples and tests them later. A loop over the few vectors of a short run would mispredict
/// its end, which costs more than its tests: such runs are collected by their number of vectors.
class RunQueue {
 public:
  RunQueue(const WalkTask& state, const Triangles& triangles) : state_(state), triangles_(triangles) {}

  /// In each lane the samples of cells [first, last], against that lane's triangle. False without any.
  HWY_INLINE bool Add(VU triangle, VI first_cell, VI last_cell, MF lanes) {
    const int* starts = reinterpret_cast<const int*>(state_.cell_start);
    const VI first = hn::GatherIndex(di, starts, first_cell);
    // The last cell's run would go on over the gap after it, whose answers reach into another thread's.
    const VI end = hn::Min(hn::GatherIndex(di, starts, hn::Add(last_cell, hn::Set(di, 1))),
                           hn::Set(di, static_cast<int32_t>(state_.end_sample)));
    const auto runs = hn::And(hn::RebindMask(di, lanes), hn::Lt(first, end));
    if (hn::AllFalse(di, runs)) return false;
    const VI last = hn::Sub(hn::Sub(end, first), hn::Set(di, 1));
    const VU last_lane = hn::BitCast(du, hn::And(last, hn::Set(di, kLanes - 1)));
    const VU tail = hn::Sub(hn::Shl(hn::Set(du, 2), last_lane), hn::Set(du, 1));
    const VU what = hn::Or(hn::ShiftLeft<kTriangleShift>(triangle), tail);
    // Of one or two vectors nearly all are where triangles are as small as samples are apart.
    AddShort<1>(runs, first, last, what);
    AddShort<2>(runs, first, last, what);
    const auto longer = hn::And(runs, hn::Gt(last, hn::Set(di, 2 * kLanes - 1)));
    if (hn::AllFalse(di, longer)) return true;
    AddShort<3>(longer, first, last, what);
    AddShort<4>(longer, first, last, what);
    const auto others = hn::And(longer, hn::Gt(last, hn::Set(di, kShort * kLanes - 1)));
    if (hn::AllFalse(di, others)) return true;
    hn::StoreU(hn::Compress(hn::BitCast(du, first), hn::RebindMask(du, others)), du,
               long_first_ + long_count_);
    hn::StoreU(hn::Compress(hn::BitCast(du, end), hn::RebindMask(du, others)), du, long_end_ + long_count_);
    hn::StoreU(hn::Compress(triangle, hn::RebindMask(du, others)), du, long_triangle_ + long_count_);
    long_count_ += CountOf(others);
    return true;
  }

  /// To be called after every two Add()s at least.
  HWY_INLINE void FlushIfFull() {
    uint32_t most = long_count_;
    for (const ShortRuns& list : short_) most = std::max(most, list.count);
    if (most > kCapacity) Flush();
  }

  HWY_NOINLINE void Flush() {
    TestShort<1>();
    TestShort<2>();
    TestShort<3>();
    TestShort<4>();
    static_assert(kShort == 4);
    if (long_count_ != 0) TestLong();
  }

 private:
  static constexpr uint32_t kCapacity = 64;
  static constexpr uint32_t kRoom = kCapacity + 4 * kLanes;
  static constexpr int32_t kShort = 4;
  static constexpr uint32_t kAhead = 6;
  static constexpr int kTriangleShift = 16;
  static constexpr uint32_t kLaneBits = (1u << kTriangleShift) - 1;

  /// All of as many vectors.
  struct ShortRuns {
    uint32_t count = 0;
    uint32_t first[kRoom];
    uint32_t what[kRoom];  ///< Lanes of the last vector, and above kTriangleShift the triangle.
  };

  /// Lanes of a vector of samples, and above kTriangleShift the triangle.
  struct Hit {
    uint32_t first;
    uint32_t what;
  };

  template <class M>
  static HWY_INLINE uint32_t CountOf(M mask) {
    return static_cast<uint32_t>(hn::CountTrue(di, mask));
  }

  /// Of the runs, given by their first and the distance to their last sample, those of so many vectors.
  template <int32_t kVectors, class M>
  HWY_INLINE void AddShort(M runs, VI first, VI last, VU what) {
    const VI begin = hn::Set(di, (kVectors - 1) * kLanes);
    const auto these = hn::And(runs, hn::Eq(hn::AndNot(hn::Set(di, kLanes - 1), last), begin));
    ShortRuns& list = short_[kVectors - 1];
    hn::StoreU(hn::Compress(hn::BitCast(du, first), hn::RebindMask(du, these)), du, list.first + list.count);
    hn::StoreU(hn::Compress(what, hn::RebindMask(du, these)), du, list.what + list.count);
    list.count += CountOf(these);
  }

  template <uint32_t kVectors>
  HWY_INLINE void TestShort() {
    ShortRuns& list = short_[kVectors - 1];
    const SampleArrays samples = state_.samples;
    const uint32_t* const shadow = state_.shadow;
    uint32_t hit_count = 0;
    for (uint32_t i = 0; i < list.count; ++i) {
      const uint32_t what = list.what[i];
      const EdgeTest test(triangles_.rows + (what >> kTriangleShift));
#pragma GCC unroll 4
      for (uint32_t vector = 0; vector < kVectors; ++vector) {
        const uint32_t first = list.first[i] + vector * kLanes;
        const uint32_t lanes = vector + 1 < kVectors ? FirstBits(kLanes) : what & kLaneBits;
        const uint32_t inside = test.Inside(samples, first) & lanes & ~BitsAt(shadow, first);
        hits_[hit_count] = {first, (what & ~kLaneBits) | inside};
        hit_count += static_cast<uint32_t>(inside != 0);
      }
    }
    list.count = 0;
    TestHits(hit_count);
  }

  HWY_NOINLINE void TestLong() {
    const SampleArrays samples = state_.samples;
    uint32_t* const shadow = state_.shadow;
    uint32_t hit_count = 0;
    for (uint32_t i = 0; i < std::min(kAhead, long_count_); ++i) Prefetch(samples, i);
    for (uint32_t i = 0; i < long_count_; ++i) {
      Prefetch(samples, std::min(i + kAhead, long_count_ - 1));
      const uint32_t triangle = long_triangle_[i], end = long_end_[i];
      const EdgeTest test(triangles_.rows + triangle);
      for (uint32_t first = long_first_[i]; first < end; first += kLanes) {
        const uint32_t inside = test.Inside(samples, first) & FirstBits(end - first) & ~BitsAt(shadow, first);
        hits_[hit_count] = {first, triangle << kTriangleShift | inside};
        hit_count += static_cast<uint32_t>(inside != 0);
        if (hit_count == kMostHits) {
          TestHits(hit_count);
          hit_count = 0;
        }
      }
    }
    long_count_ = 0;
    TestHits(hit_count);
  }

  HWY_INLINE void Prefetch(const SampleArrays& samples, uint32_t i) const {
    hwy::Prefetch(samples.u + long_first_[i]);
    hwy::Prefetch(samples.v + long_first_[i]);
  }

  HWY_NOINLINE void TestHits(uint32_t count) {
    const bool opaque = triangles_.caster->alpha == nullptr && !triangles_.caster->transmits;
    for (uint32_t i = 0; i < count; ++i) {
      const uint32_t triangle = hits_[i].what >> kTriangleShift, inside = hits_[i].what & kLaneBits;
      if (opaque) {
        TestOpaqueHit(state_, triangles_, triangle, hits_[i].first, inside);
      } else {
        TestHit(state_, triangles_, triangle, hits_[i].first, inside);
      }
    }
  }

  static constexpr uint32_t kMostHits = kShort * kRoom;
  const WalkTask& state_;
  const Triangles& triangles_;
  ShortRuns short_[kShort];
  uint32_t long_first_[kRoom], long_end_[kRoom], long_triangle_[kRoom];
  uint32_t long_count_ = 0;
  Hit hits_[kMostHits + 1];
};

/// A larger outline: the range of u that it covers in each row, kLanes rows at a time. In the slab of a row
/// the extremes are at corners inside it and where edges cross its two borders.
HWY_NOINLINE void TestRows(const WalkTask& task, uint32_t triangle, const Outline& o, RunQueue* queue) {
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
    queue->Add(hn::Set(du, triangle), cells.CellAt(hn::Sub(low, pad)), cells.CellAt(hn::Add(high, pad)),
               lanes);
    queue->FlushIfFull();
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace shadowfit::irregular
HWY_AFTER_NAMESPACE();

#endif
