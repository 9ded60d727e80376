#include "core/irregular/walk_kernels.h"

#include <algorithm>
#include <bit>
#include <cmath>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/irregular/walk_kernels.cc"
#include <hwy/cache_control.h>
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/irregular/cluster_unpack-inl.h"
#include "core/irregular/outline-inl.h"
#include "core/irregular/sample_runs-inl.h"
#include "core/irregular/sample_tests-inl.h"
#include "core/irregular/simd.h"
#include "core/irregular/triangle_setup-inl.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::irregular {
namespace HWY_NAMESPACE {

HWY_NOINLINE void TestBsp(const WalkTask& state, const Triangles& t, uint32_t triangle,
                          const std::vector<BspNode>& nodes, const Outline& o) {
  const float nearest = t.rows[kNearest * kBlock + triangle];
  if (nodes.empty()) return;
  int32_t stack[64];
  int depth = 0;
  stack[depth++] = 0;
  while (depth > 0) {
    const int32_t at = stack[--depth];
    const BspNode& node = nodes[static_cast<size_t>(at)];
    if (node.u_min > o.u_max + o.pad || node.u_max < o.u_min - o.pad || node.v_min > o.v_max + o.pad ||
        node.v_max < o.v_min - o.pad || nearest > node.farthest) {
      continue;
    }
    if (node.right < 0) {
      TestRun(state, t, triangle, node.first_sample, node.end_sample);
    } else {
      stack[depth++] = node.right;
      stack[depth++] = at + 1;
    }
  }
}

/// Where kLanes triangles lie on the face.
struct Projection {
  VF u[3], v[3], w[3];
  VF u_low, u_high, v_low, v_high, w_low, w_high;
};

template <bool kDirectional>
HWY_INLINE Projection Project(const Corner corners[3]) {
  Projection p;
  for (int i = 0; i < 3; ++i) {
    p.w[i] = corners[i].r[2];
    p.u[i] = corners[i].r[0];
    p.v[i] = corners[i].r[1];
    if constexpr (!kDirectional) {
      const VF inverse_w = hn::Div(hn::Set(df, 1.0f), p.w[i]);
      p.u[i] = hn::Mul(p.u[i], inverse_w);
      p.v[i] = hn::Mul(p.v[i], inverse_w);
    }
  }
  const auto least = [](const VF x[3]) { return hn::Min(x[0], hn::Min(x[1], x[2])); };
  const auto most = [](const VF x[3]) { return hn::Max(x[0], hn::Max(x[1], x[2])); };
  p.u_low = least(p.u), p.u_high = most(p.u);
  p.v_low = least(p.v), p.v_high = most(p.v);
  p.w_low = least(p.w), p.w_high = most(p.w);
  return p;
}

/// No less than the spread of SetUpBlock, but no more than kSliverSpread: `unit` bounds how much larger plane
/// coordinates are than directions, `roundoff` their error.
HWY_INLINE VF SpreadBound(const Projection& p, VF unit, VF roundoff) {
  const VF width = hn::Add(hn::Sub(p.u_high, p.u_low), roundoff);
  const VF height = hn::Add(hn::Sub(p.v_high, p.v_low), roundoff);
  const VF longest2 = hn::MulAdd(width, width, hn::Mul(height, height));
  const VF e1[2] = {hn::Sub(p.u[1], p.u[0]), hn::Sub(p.v[1], p.v[0])};
  const VF e2[2] = {hn::Sub(p.u[2], p.u[0]), hn::Sub(p.v[2], p.v[0])};
  const VF area = hn::Abs(hn::Sub(hn::Mul(e1[0], e2[1]), hn::Mul(e1[1], e2[0])));
  const VF error = hn::Mul(hn::Add(width, height), hn::Add(roundoff, roundoff));
  const VF most = hn::Set(df, kSliverSpread);
  const VF spread = hn::Div(hn::Mul(hn::Mul(unit, unit), longest2), hn::Sub(area, error));
  return hn::IfThenElse(hn::And(hn::Gt(area, error), hn::Lt(spread, most)), spread, most);
}

/// kLanes triangles on their way to samples.
struct TriangleLanes {
  Corner corners[3];
  Projection at;
  VF pad;                ///< By how much rounding may move samples against them, in plane coordinates.
  VF nearest;            ///< Least depth of the corners.
  MF bounded;            ///< `at` encloses them.
  uint32_t large = 0;    ///< Bounded, and to be tested one by one.
  uint32_t clipped = 0;  ///< To be clipped to the face, and then tested one by one.
  bool compact = false;  ///< None that may meet samples is a sliver.
  // Of those in few rows: the rows, and the first and last cell in the least and in the last of them.
  MF few;
  VI low_row;
  VI further;  ///< From the least row to the last; negative where none is in this task.
  VI low_cells[2], high_cells[2];

  HWY_INLINE bool OneByOne() const { return (large | clipped) != 0; }
};

/// The largest plane coordinates of samples.
HWY_INLINE float FaceReach(const Face& face) {
  return std::max(std::max(std::abs(face.u_min), std::abs(face.u_max)),
                  std::max(std::abs(face.v_min), std::abs(face.v_max)));
}

/// Finds what may meet triangles [offset, offset + kLanes) of a block. False where nothing does.
template <bool kDirectional>
HWY_NOINLINE bool ProjectLanes(const WalkTask& state, const FaceFrame& frame, const float* geometry,
                               int offset, TriangleLanes* out) {
  const bool exhaustive = state.search == Search::kExhaustive;
  const Face& face = *state.face;

  // 1. Plane coordinates of the corners, and which triangles can be bounded by them.
  TransformBlock(frame, geometry, offset, out->corners);
  const Projection p = Project<kDirectional>(out->corners);
  out->at = p;
  const VF reach_u = hn::Max(hn::Abs(p.u_low), hn::Abs(p.u_high));
  const VF reach_v = hn::Max(hn::Abs(p.v_low), hn::Abs(p.v_high));
  const VF reach = hn::Max(reach_u, reach_v);
  const float face_reach = FaceReach(face);
  // One unit of angular rounding moves plane coordinates by up to 1 + u^2 + v^2; in the parallel
  // projection of a directional light rounding is relative to the coordinates themselves.
  const VF unit = kDirectional
                      ? hn::Max(reach, hn::Set(df, face_reach))
                      : hn::MulAdd(reach_u, reach_u, hn::MulAdd(reach_v, reach_v, hn::Set(df, 1.0f)));
  const VF roundoff = hn::Mul(unit, hn::Set(df, 8.0f * kUnitRoundoff));
  const VF spread = SpreadBound(p, unit, roundoff);
  const VF pad = hn::Mul(roundoff, hn::Add(hn::Set(df, 2.0f), spread));
  MF bounded = hn::Le(reach, hn::Set(df, kDirectional ? 64.0f * face_reach : 64.0f));
  if constexpr (!kDirectional) bounded = hn::And(bounded, hn::Gt(p.w_low, hn::Zero(df)));
  const VF largest_w = hn::Max(hn::Abs(p.w_low), hn::Abs(p.w_high));
  VF nearest = hn::NegMulAdd(largest_w, hn::Set(df, 16.0f * kUnitRoundoff), p.w_low);
  if constexpr (!kDirectional) {
    nearest = hn::IfThenElse(hn::Gt(nearest, hn::Zero(df)), hn::Div(hn::Set(df, -1.0f), nearest),
                             hn::Set(df, -kInfinity));
  }
  const MF overlaps = hn::And(hn::And(hn::And(hn::Le(hn::Sub(p.u_low, pad), hn::Set(df, face.u_max)),
                                              hn::Ge(hn::Add(p.u_high, pad), hn::Set(df, face.u_min))),
                                      hn::And(hn::Le(hn::Sub(p.v_low, pad), hn::Set(df, state.v_max)),
                                              hn::Ge(hn::Add(p.v_high, pad), hn::Set(df, state.v_min)))),
                              hn::Le(nearest, hn::Set(df, face.farthest)));
  const MF quick = hn::And(bounded, overlaps);
  // Others are clipped: those in front of the light at least in part, or so close to its plane that rounding
  // could hide it (NaN corners compare false).
  MF clipped = hn::AndNot(bounded, overlaps);
  if constexpr (!kDirectional) {
    VF size = hn::Zero(df);
    for (const Corner& corner : out->corners) {
      for (const VF& r : corner.r) size = hn::Max(size, hn::Abs(r));
    }
    const VF behind = hn::Mul(size, hn::Set(df, -16.0f * kUnitRoundoff));
    clipped = hn::AndNot(bounded, hn::Ge(p.w_high, behind));
  }
  out->pad = pad;
  out->nearest = nearest;
  out->bounded = bounded;
  out->large = BitsOf(exhaustive ? bounded : quick);
  out->clipped = exhaustive ? ~out->large & FirstBits(kLanes) : BitsOf(clipped);
  const uint32_t compact = out->large & BitsOf(hn::Lt(spread, hn::Set(df, kSliverSpread)));
  out->compact = compact == (out->large | out->clipped);
  out->few = NoLanes();
  if (state.search != Search::kGrid || out->large == 0) return out->OneByOne();

  // 2. Cells of those in few rows.
  const VI bin_begin = hn::Set(di, face.first_bin_of_row[static_cast<size_t>(state.row_begin)]);
  const VI bin_last = hn::Set(di, face.first_bin_of_row[static_cast<size_t>(state.row_end)] - 1);
  const VF from = hn::Sub(p.u_low, pad), to = hn::Add(p.u_high, pad);
  const RowLanes low(face, hn::Max(BinOf(face, hn::Sub(p.v_low, pad)), bin_begin));
  const RowLanes high(face, hn::Min(BinOf(face, hn::Add(p.v_high, pad)), bin_last));
  out->low_row = low.number;
  out->further = hn::Sub(high.number, low.number);
  out->few = hn::And(quick, hn::RebindMask(df, hn::Lt(out->further, hn::Set(di, kFewRows))));
  out->large &= ~BitsOf(out->few);
  out->low_cells[0] = low.CellAt(from);
  out->low_cells[1] = low.CellAt(to);
  out->high_cells[0] = high.CellAt(from);
  out->high_cells[1] = high.CellAt(to);
  return true;
}

/// Collects the samples of triangles in few rows, the first of which has the number `first`. False without
/// any.
HWY_INLINE bool CollectRuns(const Face& face, const TriangleLanes& lanes, uint32_t first, RunQueue* queue) {
  const auto further_than = [&lanes](int32_t rows) HWY_ATTR {
    return hn::And(lanes.few, hn::RebindMask(df, hn::Gt(lanes.further, hn::Set(di, rows))));
  };
  bool met = queue->Add(first, 1, lanes.low_cells[0], lanes.low_cells[1], further_than(-1));
  MF more = further_than(0);
  if (hn::AllFalse(df, more)) return met;
  met |= queue->Add(first, 1, lanes.high_cells[0], lanes.high_cells[1], more);
  const VF from = hn::Sub(lanes.at.u_low, lanes.pad), to = hn::Add(lanes.at.u_high, lanes.pad);
  for (int32_t row = 1; row + 1 < kFewRows; ++row) {
    more = further_than(row);
    if (hn::AllFalse(df, more)) return met;
    const VI number = hn::Add(lanes.low_row, hn::Min(lanes.further, hn::Set(di, row)));
    const RowLanes cells(face, hn::GatherIndex(di, face.first_bin_of_row.data(), number));
    met |= queue->Add(first, 1, cells.CellAt(from), cells.CellAt(to), more);
  }
  return met;
}

/// Edges and planes of triangles [offset, offset + kLanes) of a block. Those that are degenerate are no more
/// to be tested one by one.
template <bool kDirectional>
void SetUpLanes(const WalkTask& state, const float* geometry, int offset, TriangleLanes* lanes,
                BlockSetup* setup, Triangles* triangles) {
  const uint32_t valid = SetUpBlock<kDirectional>(*state.frame, *state.face, geometry, lanes->corners, offset,
                                                  lanes->compact, setup);
  lanes->large &= valid;
  lanes->clipped &= valid;
  // What is left of those that are clipped depends on the samples, the answer must not.
  hn::Store(hn::IfThenElse(lanes->bounded, lanes->nearest, hn::Set(df, -kInfinity)), df,
            &setup->rows[kNearest][offset]);
  if (lanes->compact) {
    hn::Store(hn::Zero(df), df, &setup->rows[kSpread][offset]);
    return;
  }
  const VF spread = hn::Load(df, &setup->rows[kSpread][offset]);
  const uint32_t slivers = BitsOf(hn::Not(hn::Le(spread, hn::Set(df, kSliverSpread))));
  triangles->slivers |= slivers != 0;
  const uint32_t tested = (BitsOf(lanes->few) & valid) | lanes->large | lanes->clipped;
  for (uint32_t bits = tested & slivers; bits != 0; bits &= bits - 1) {
    SetUpEnds(kDirectional, offset + std::countr_zero(bits), setup);
  }
}

/// Tests those of a block's triangles [offset, offset + kLanes) that are neither in few rows nor out of the
/// way. The block's first triangle has the number `first`.
template <bool kDirectional>
HWY_NOINLINE void TestOneByOne(const WalkTask& state, const float* geometry, int offset,
                               const TriangleLanes& lanes, uint32_t first, const BlockSetup& setup,
                               const Triangles& triangles, RunQueue* queue) {
  const bool exhaustive = state.search == Search::kExhaustive;
  const Face& face = *state.face;
  HWY_ALIGN float u[3][kLanes], v[3][kLanes], pads[kLanes];
  hn::Store(lanes.pad, df, pads);
  for (int corner = 0; corner < 3; ++corner) {
    hn::Store(lanes.at.u[corner], df, u[corner]);
    hn::Store(lanes.at.v[corner], df, v[corner]);
  }
  for (uint32_t bits = lanes.large | lanes.clipped; bits != 0; bits &= bits - 1) {
    const int i = std::countr_zero(bits);
    const int lane = offset + i;
    const uint32_t triangle = first + static_cast<uint32_t>(lane);
    if (state.search != Search::kGrid && state.Cancelled()) return;
    Outline outline;
    if ((lanes.large >> i & 1u) != 0) {
      outline.corners = 3;
      for (int corner = 0; corner < 3; ++corner) {
        outline.u[corner] = u[corner][i];
        outline.v[corner] = v[corner][i];
      }
      outline.pad = pads[i];
      MeasureOutline(&outline);
    } else if (ClippedOutline(*state.frame, face, geometry, lane, &outline)) {
      const float face_reach = FaceReach(face);
      outline.pad = 8.0f * kUnitRoundoff * (2.0f + std::min(setup.rows[kSpread][lane], kSliverSpread)) *
                    (kDirectional ? 64.0f * face_reach : 1.0f + 2.0f * face_reach * face_reach);
    } else if (!exhaustive) {
      continue;
    }
    if (exhaustive) {
      TestRun(state, triangles, triangle, face.first_sample, face.end_sample);
    } else if (state.search == Search::kBsp) {
      TestBsp(state, triangles, triangle, *state.bsp, outline);
    } else {
      TestRows(state, triangle, outline, queue);
    }
  }
}

constexpr int kVectorsOfBlock = kBlock / kLanes;

/// Step after step for all of a cluster, so that what one vector waits for, the next does not.
template <bool kDirectional>
void WalkBlocks(const WalkTask& task, const FaceFrame& frame, const CasterCluster& cluster,
                const float* blocks) {
  BlockSetup setups[kClusterBlocks];
  TriangleLanes lanes[kClusterBlocks * kVectorsOfBlock];
  Triangles triangles = {&setups[0].rows[0][0], cluster};
  RunQueue queue(task, triangles);
  const auto count = static_cast<int>(cluster.block_count) * kVectorsOfBlock;
  const auto geometry_of = [blocks](int i) {
    return blocks + static_cast<size_t>(i / kVectorsOfBlock) * kBlockFloats;
  };
  const auto first_of = [](int i) { return static_cast<uint32_t>(i / kVectorsOfBlock) * kSetupFloats; };
  const auto offset_of = [](int i) { return i % kVectorsOfBlock * kLanes; };
  uint32_t left = 0;
  for (int i = 0; i < count; ++i) {
    left |= static_cast<uint32_t>(
                ProjectLanes<kDirectional>(task, frame, geometry_of(i), offset_of(i), &lanes[i]))
            << i;
  }
  for (uint32_t bits = left; bits != 0; bits &= bits - 1) {
    const int i = std::countr_zero(bits);
    const bool met =
        !hn::AllFalse(df, lanes[i].few) &&
        CollectRuns(*task.face, lanes[i], first_of(i) + static_cast<uint32_t>(offset_of(i)), &queue);
    if (!met && !lanes[i].OneByOne()) left &= ~(1u << i);
  }
  for (uint32_t bits = left; bits != 0; bits &= bits - 1) {
    const int i = std::countr_zero(bits);
    SetUpLanes<kDirectional>(task, geometry_of(i), offset_of(i), &lanes[i], &setups[i / kVectorsOfBlock],
                             &triangles);
    if (!lanes[i].OneByOne()) left &= ~(1u << i);
  }
  // Not before all are set up: the queue may be flushed on the way.
  for (uint32_t bits = left; bits != 0; bits &= bits - 1) {
    const int i = std::countr_zero(bits);
    TestOneByOne<kDirectional>(task, geometry_of(i), offset_of(i), lanes[i], first_of(i),
                               setups[i / kVectorsOfBlock], triangles, &queue);
  }
  queue.Flush();
}

size_t SelectBoxesImpl(const BoxArrays& boxes, const WalkTask& task, size_t begin, size_t end,
                       uint32_t* out) {
  size_t count = 0;
  for (size_t i = begin; i < end; i += kLanes) {
    MF keep = LanesOf(FirstBits(static_cast<uint32_t>(std::min<size_t>(end - i, kLanes))));
    keep = hn::And(keep, hn::Le(hn::LoadU(df, boxes.u_min + i), hn::Set(df, task.face->u_max)));
    keep = hn::And(keep, hn::Le(hn::LoadU(df, boxes.v_min + i), hn::Set(df, task.v_max)));
    keep = hn::And(keep, hn::Ge(hn::LoadU(df, boxes.u_max + i), hn::Set(df, task.face->u_min)));
    keep = hn::And(keep, hn::Ge(hn::LoadU(df, boxes.v_max + i), hn::Set(df, task.v_min)));
    keep = hn::And(keep, hn::Le(hn::LoadU(df, boxes.nearest + i), hn::Set(df, task.face->farthest)));
    const VU numbers = hn::Iota(du, static_cast<uint32_t>(i));
    hn::StoreU(hn::Compress(numbers, hn::RebindMask(du, keep)), du, out + count);
    count += static_cast<size_t>(std::popcount(BitsOf(keep)));
  }
  return count;
}

void WalkTrianglesImpl(const WalkTask& task, const CasterCluster& cluster) {
  const FaceFrame frame(*task.frame, *task.face);
  for (size_t i = 0; i < cluster.next_line_count; ++i) {
    hwy::Prefetch(cluster.next_lines + i * ClusteredMesh::kLineFloats);
  }
  HWY_ALIGN float room[kClusterBlocks * kBlockFloats];
  const float* const blocks = Unpack(cluster, room);
  if (task.frame->directional) {
    WalkBlocks<true>(task, frame, cluster, blocks);
  } else {
    WalkBlocks<false>(task, frame, cluster, blocks);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace shadowfit::irregular
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit::irregular {

HWY_EXPORT(SelectBoxesImpl);
HWY_EXPORT(WalkTrianglesImpl);

size_t SelectBoxes(const BoxArrays& boxes, const WalkTask& task, size_t begin, size_t end, uint32_t* out) {
  return HWY_DYNAMIC_DISPATCH(SelectBoxesImpl)(boxes, task, begin, end, out);
}

void WalkTriangles(const WalkTask& task, const CasterCluster& cluster) {
  HWY_DYNAMIC_DISPATCH(WalkTrianglesImpl)(task, cluster);
}

}  // namespace shadowfit::irregular
#endif  // HWY_ONCE
