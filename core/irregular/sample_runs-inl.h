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

/// Triangles in up to so many rows of cells are taken for their boxes.
constexpr int32_t kFewRows = 4;
/// Runs that a cluster may have before any of them is tested.
constexpr uint32_t kMostRuns = static_cast<uint32_t>(kClusterBlocks) * kBlock * kFewRows;

/// Collects runs of samples and tests them later. A loop over the few vectors of a short run would mispredict
/// its end, which costs more than its tests: runs are collected by their number of vectors.
class RunQueue {
 public:
  RunQueue(const WalkTask& state, const Triangles& triangles) : state_(state), triangles_(triangles) {}

  /// In each lane the samples of cells [first, last], against triangle `number` + lane * `step`. False
  /// without any.
  HWY_INLINE bool Add(uint32_t number, uint32_t step, VI first_cell, VI last_cell, MF lanes) {
    // Where vectors cannot be compressed by one instruction, lanes are sorted into their lists one by one.
    if constexpr (kLanes == 16) {
      const VU triangles = hn::Add(hn::Mul(hn::Iota(du, 0), hn::Set(du, step)), hn::Set(du, number));
      return AddLanes(triangles, first_cell, last_cell, hn::RebindMask(di, lanes));
    } else {
      return AddOneByOne(number, step, first_cell, last_cell, BitsOf(lanes));
    }
  }

  /// To be called when there may be more than kMostRuns, all of them of triangles that are set up.
  HWY_INLINE void FlushIfFull() {
    static_assert(std::has_single_bit(kMostRuns) && 2 * kMostRuns <= kCountMask);
    uint64_t full = 0;
    for (int kind = 0; kind <= kLong; ++kind) full |= uint64_t{kMostRuns} << (kCountBits * kind);
    if ((counts_ & full) != 0) Flush();
  }

  HWY_NOINLINE void Flush() {
    TestShort<1>();
    TestShort<2>();
    TestShort<3>();
    TestShort<4>();
    static_assert(kLong == 5);
    TestLong();
    counts_ = 0;
  }

 private:
  // Kinds of runs: empty ones, those of one to four vectors, and longer ones.
  static constexpr int kLong = 5;
  static constexpr int kLog2Lanes = std::countr_zero(static_cast<unsigned>(kLanes));
  static constexpr int kCountBits = 10;
  static constexpr uint64_t kCountMask = (1u << kCountBits) - 1;
  static constexpr uint32_t kRoom = kMostRuns + kLanes;
  static constexpr uint32_t kMostHits = (kLong - 1) * kRoom;
  static constexpr uint32_t kAhead = 6;  ///< Runs, whose samples are fetched ahead.
  static constexpr int kTriangleShift = 16;
  static constexpr uint32_t kLaneBits = (1u << kTriangleShift) - 1;

  /// Samples [first, end); of short runs `end` is not read, and may not be set.
  struct RunList {
    uint32_t first[kRoom], end[kRoom];
    uint32_t tail[kRoom];  ///< Lanes of the last vector, and above kTriangleShift the triangle.
  };

  /// Lanes of a vector of samples, and above kTriangleShift the triangle.
  struct Hit {
    uint32_t first;
    uint32_t what;
  };

  HWY_INLINE uint32_t CountOf(int kind) const {
    return static_cast<uint32_t>(counts_ >> (kCountBits * kind) & kCountMask);
  }

  HWY_INLINE bool AddLanes(VU triangles, VI first_cell, VI last_cell, hn::Mask<DI> lanes) {
    const int* const starts = reinterpret_cast<const int*>(state_.cell_start);
    const VI first = hn::GatherIndex(di, starts, first_cell);
    // The last cell's run would go on over the gap after it, whose answers reach into another thread's.
    const VI end = hn::Min(hn::GatherIndex(di, starts, hn::Add(last_cell, hn::Set(di, 1))),
                           hn::Set(di, static_cast<int32_t>(state_.end_sample)));
    const auto runs = hn::And(lanes, hn::Lt(first, end));
    if (hn::AllFalse(di, runs)) return false;
    const VI last = hn::Sub(hn::Sub(end, first), hn::Set(di, 1));
    const VI vectors = hn::ShiftRight<kLog2Lanes>(last);  // without the last one
    const VU last_lane = hn::BitCast(du, hn::And(last, hn::Set(di, kLanes - 1)));
    const VU lanes_of_last = hn::Sub(hn::Shl(hn::Set(du, 2), last_lane), hn::Set(du, 1));
    const VU tail = hn::Or(hn::ShiftLeft<kTriangleShift>(triangles), lanes_of_last);
    Append<1>(hn::And(runs, hn::Eq(vectors, hn::Zero(di))), first, end, tail);
    Append<2>(hn::And(runs, hn::Eq(vectors, hn::Set(di, 1))), first, end, tail);
    // None is longer where triangles are as small as samples are apart.
    if (hn::AllFalse(di, hn::And(runs, hn::Gt(vectors, hn::Set(di, 1))))) return true;
    Append<3>(hn::And(runs, hn::Eq(vectors, hn::Set(di, 2))), first, end, tail);
    Append<4>(hn::And(runs, hn::Eq(vectors, hn::Set(di, 3))), first, end, tail);
    const auto longer = hn::And(runs, hn::Gt(vectors, hn::Set(di, kLong - 2)));
    if (!hn::AllFalse(di, longer)) Append<kLong>(longer, first, end, tail);
    return true;
  }

  template <int kKind>
  HWY_INLINE void Append(hn::Mask<DI> these, VI first, VI end, VU tail) {
    RunList& list = runs_[kKind];
    const uint32_t count = CountOf(kKind);
    hn::StoreU(hn::Compress(tail, hn::RebindMask(du, these)), du, list.tail + count);
    const auto store = [these, count](VI values, uint32_t* to) HWY_ATTR {
      hn::StoreU(hn::BitCast(du, hn::Compress(values, these)), du, to + count);
    };
    store(first, list.first);
    if constexpr (kKind == kLong) store(end, list.end);
    counts_ += static_cast<uint64_t>(hn::CountTrue(di, these)) << (kCountBits * kKind);
  }

  HWY_INLINE bool AddOneByOne(uint32_t number, uint32_t step, VI first_cell, VI last_cell, uint32_t lanes) {
    HWY_ALIGN int32_t first_cells[kLanes], last_cells[kLanes];
    hn::Store(first_cell, di, first_cells);
    hn::Store(last_cell, di, last_cells);
    const uint32_t* const starts = state_.cell_start;
    uint64_t counts = counts_;
    for (; lanes != 0; lanes &= lanes - 1) {
      const auto i = static_cast<uint32_t>(std::countr_zero(lanes));
      const uint32_t first = starts[first_cells[i]];
      const uint32_t end = std::min(starts[last_cells[i] + 1], state_.end_sample);  // as above
      // Those of another band have no samples, or less than none.
      const int32_t last = static_cast<int32_t>(end - first) - 1;
      const int32_t kind = std::clamp((last >> kLog2Lanes) + 1, 0, kLong);
      RunList& list = runs_[kind];
      const auto at = static_cast<size_t>(counts >> (kCountBits * kind) & kCountMask);
      list.first[at] = first;
      list.end[at] = end;
      list.tail[at] = (number + i * step) << kTriangleShift | ((2u << (last & (kLanes - 1))) - 1);
      counts += uint64_t{1} << (kCountBits * kind);
    }
    const bool any = (counts ^ counts_) > kCountMask;
    counts_ = counts;
    return any;
  }

  template <int kVectors>
  HWY_INLINE void TestShort() {
    const RunList& runs = runs_[kVectors];
    const uint32_t count = CountOf(kVectors);
    const SampleArrays samples = state_.samples;
    const uint32_t* const shadow = state_.shadow;
    uint32_t hit_count = 0;
    for (uint32_t i = 0; i < count; ++i) {
      const uint32_t tail = runs.tail[i];
      const EdgeTest test(triangles_.rows + (tail >> kTriangleShift));
#pragma GCC unroll 4
      for (int vector = 0; vector < kVectors; ++vector) {
        const uint32_t first = runs.first[i] + static_cast<uint32_t>(vector * kLanes);
        const uint32_t lanes = vector + 1 < kVectors ? FirstBits(kLanes) : tail & kLaneBits;
        const uint32_t inside = test.Inside(samples, first) & lanes & ~BitsAt(shadow, first);
        hit_count = AddHit(first, tail & ~kLaneBits, inside, hit_count);
      }
    }
    TestHits(hit_count);
  }

  HWY_NOINLINE void TestLong() {
    const RunList& runs = runs_[kLong];
    const uint32_t count = CountOf(kLong);
    const SampleArrays samples = state_.samples;
    const uint32_t* const shadow = state_.shadow;
    uint32_t hit_count = 0;
    for (uint32_t i = 0; i < count; ++i) {
      const uint32_t ahead = runs.first[std::min(i + kAhead, count - 1)];
      hwy::Prefetch(samples.u + ahead);
      hwy::Prefetch(samples.v + ahead);
      const uint32_t tail = runs.tail[i], triangle = tail & ~kLaneBits;
      const EdgeTest test(triangles_.rows + (triangle >> kTriangleShift));
      uint32_t first = runs.first[i];
      for (uint32_t vectors = (runs.end[i] - first - 1) / kLanes; vectors != 0; --vectors, first += kLanes) {
        if (hit_count == kMostHits) hit_count = TestHits(hit_count);
        const uint32_t inside = test.Inside(samples, first) & ~BitsAt(shadow, first);
        hit_count = AddHit(first, triangle, inside, hit_count);
      }
      if (hit_count == kMostHits) hit_count = TestHits(hit_count);
      const uint32_t inside = test.Inside(samples, first) & tail & kLaneBits & ~BitsAt(shadow, first);
      hit_count = AddHit(first, triangle, inside, hit_count);
    }
    TestHits(hit_count);
  }

  /// Lanes of a vector, and the bits of a triangle. Returns the new number of hits.
  HWY_INLINE uint32_t AddHit(uint32_t first, uint32_t triangle_bits, uint32_t inside, uint32_t count) {
    hits_[count] = {first, triangle_bits | inside};
    return count + static_cast<uint32_t>(inside != 0);
  }

  /// Returns how many hits are left: none.
  HWY_NOINLINE uint32_t TestHits(uint32_t count) {
    if (triangles_.cluster.caster->alpha == nullptr && !triangles_.cluster.caster->transmits) {
      TestOpaqueHits(count);
    } else {
      for (uint32_t i = 0; i < count; ++i) {
        TestHit(state_, triangles_, hits_[i].what >> kTriangleShift, hits_[i].first,
                hits_[i].what & kLaneBits);
      }
    }
    return 0;
  }

  /// Of triangles that stop all light. Whether any sample is behind one, or on it, nothing foretells: both
  /// are recorded without asking.
  HWY_INLINE void TestOpaqueHits(uint32_t count) {
    const SampleArrays samples = state_.samples;
    const Triangles triangles = triangles_;
    uint32_t* const shadow = state_.shadow;
    uint32_t* const touched = state_.touched;
    for (uint32_t i = 0; i < count; ++i) {
      const uint32_t first = hits_[i].first, inside = hits_[i].what & kLaneBits;
      const PlaneLanes lanes = TestPlane(samples, triangles, hits_[i].what >> kTriangleShift, first);
      SetBits(shadow, first, lanes.behind & inside);
      const uint32_t on = lanes.on & inside;
      const uint32_t again = SetBits(touched, first, on) & on;
      if (again != 0) SetBits(state_.touched_twice, first, again);
    }
  }

  const WalkTask& state_;
  const Triangles& triangles_;
  uint64_t counts_ = 0;  ///< Of each kind, kCountBits each.
  RunList runs_[kLong + 1];
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
    queue->Add(triangle, 0, cells.CellAt(hn::Sub(low, pad)), cells.CellAt(hn::Add(high, pad)), lanes);
    queue->FlushIfFull();
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace shadowfit::irregular
HWY_AFTER_NAMESPACE();

#endif
