#include "core/irregular/walk_kernels.h"

#include <algorithm>
#include <bit>
#include <cmath>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/irregular/walk_kernels.cc"
#include <hwy/cache_control.h>
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

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

/// What is known of kLanes triangles before they are set up.
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

/// Blocks whose samples are tested together.
constexpr size_t kTogether = 4;

/// Triangles [offset, offset + kLanes) of a block. Sets them up in `setup`, whose first triangle has the
/// number `first`, if any of them meets samples.
template <bool kDirectional>
void WalkLanes(const WalkTask& state, const FaceFrame& frame, const float* geometry, int offset,
               uint32_t first, BlockSetup* setup, Triangles* triangles, RunQueue* queue) {
  const bool exhaustive = state.search == Search::kExhaustive;
  const Face& face = *state.face;

  // 1. Plane coordinates of the corners, and which triangles can be bounded by them.
  Corner corners[3];
  TransformBlock(frame, geometry, offset, corners);
  const Projection p = Project<kDirectional>(corners);
  const VF reach_u = hn::Max(hn::Abs(p.u_low), hn::Abs(p.u_high));
  const VF reach_v = hn::Max(hn::Abs(p.v_low), hn::Abs(p.v_high));
  const VF reach = hn::Max(reach_u, reach_v);
  const float face_reach = std::max(std::max(std::abs(face.u_min), std::abs(face.u_max)),
                                    std::max(std::abs(face.v_min), std::abs(face.v_max)));
  // One unit of angular rounding moves plane coordinates by up to 1 + u^2 + v^2; in the parallel
  // projection of a directional light rounding is relative to the coordinates themselves.
  const VF unit = kDirectional
                      ? hn::Max(reach, hn::Set(df, face_reach))
                      : hn::MulAdd(reach_u, reach_u, hn::MulAdd(reach_v, reach_v, hn::Set(df, 1.0f)));
  const VF roundoff = hn::Mul(unit, hn::Set(df, 8.0f * kUnitRoundoff));
  const VF pad = hn::Mul(roundoff, hn::Add(hn::Set(df, 2.0f), SpreadBound(p, unit, roundoff)));
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
    for (const Corner& corner : corners) {
      for (const VF& r : corner.r) size = hn::Max(size, hn::Abs(r));
    }
    const VF behind = hn::Mul(size, hn::Set(df, -16.0f * kUnitRoundoff));
    clipped = hn::AndNot(bounded, hn::Ge(p.w_high, behind));
  }
  uint32_t quick_bits = BitsOf(exhaustive ? bounded : quick);
  uint32_t clipped_bits = exhaustive ? ~quick_bits & FirstBits(kLanes) : BitsOf(clipped);
  if ((quick_bits | clipped_bits) == 0) return;

  // 2. Samples of those that cover no more than two rows of cells, all lanes at once.
  bool met = false;
  uint32_t large_bits = quick_bits;
  if (state.search == Search::kGrid && quick_bits != 0) {
    const VI bin_begin = hn::Set(di, face.first_bin_of_row[static_cast<size_t>(state.row_begin)]);
    const VI bin_last = hn::Set(di, face.first_bin_of_row[static_cast<size_t>(state.row_end)] - 1);
    const RowLanes low(face, hn::Max(BinOf(face, hn::Sub(p.v_low, pad)), bin_begin));
    const RowLanes high(face, hn::Min(BinOf(face, hn::Add(p.v_high, pad)), bin_last));
    const VI further = hn::Sub(high.number, low.number);
    const MF small = hn::And(LanesOf(quick_bits), hn::RebindMask(df, hn::Lt(further, hn::Set(di, 2))));
    large_bits &= ~BitsOf(small);
    const VU numbers = hn::Iota(du, first + static_cast<uint32_t>(offset));
    const VF from = hn::Sub(p.u_low, pad), to = hn::Add(p.u_high, pad);
    met = queue->Add(numbers, low.CellAt(from), low.CellAt(to),
                     hn::And(small, hn::RebindMask(df, hn::Gt(further, hn::Set(di, -1)))));
    const MF both = hn::And(small, hn::RebindMask(df, hn::Gt(further, hn::Zero(di))));
    if (!hn::AllFalse(df, both)) met |= queue->Add(numbers, high.CellAt(from), high.CellAt(to), both);
    if (!met && (large_bits | clipped_bits) == 0) return;
  }

  // 3. Edges and planes.
  const uint32_t valid = SetUpBlock<kDirectional>(*state.frame, face, geometry, corners, offset, setup);
  large_bits &= valid;
  clipped_bits &= valid;
  // What is left of those that are clipped depends on the samples, the answer must not.
  hn::Store(hn::IfThenElse(bounded, nearest, hn::Set(df, -kInfinity)), df, &setup->rows[kNearest][offset]);
  const VF spread = hn::Load(df, &setup->rows[kSpread][offset]);
  const uint32_t slivers = BitsOf(hn::Not(hn::Le(spread, hn::Set(df, kSliverSpread))));
  triangles->slivers |= slivers != 0;
  for (uint32_t bits = (quick_bits | clipped_bits) & valid & slivers; bits != 0; bits &= bits - 1) {
    SetUpEnds(kDirectional, offset + std::countr_zero(bits), setup);
  }

  // 4. The others one by one.
  HWY_ALIGN float u[3][kLanes], v[3][kLanes], pads[kLanes];
  if ((large_bits | clipped_bits) != 0) {
    hn::Store(pad, df, pads);
    for (int corner = 0; corner < 3; ++corner) {
      hn::Store(p.u[corner], df, u[corner]);
      hn::Store(p.v[corner], df, v[corner]);
    }
  }
  for (uint32_t bits = large_bits | clipped_bits; bits != 0; bits &= bits - 1) {
    const int i = std::countr_zero(bits);
    const int lane = offset + i;
    const uint32_t triangle = first + static_cast<uint32_t>(lane);
    if (state.search != Search::kGrid && state.Cancelled()) return;
    Outline outline;
    if ((large_bits >> i & 1u) != 0) {
      outline.corners = 3;
      for (int corner = 0; corner < 3; ++corner) {
        outline.u[corner] = u[corner][i];
        outline.v[corner] = v[corner][i];
      }
      outline.pad = pads[i];
      MeasureOutline(&outline);
    } else if (ClippedOutline(*state.frame, face, geometry, lane, &outline)) {
      outline.pad = 8.0f * kUnitRoundoff * (2.0f + std::min(setup->rows[kSpread][lane], kSliverSpread)) *
                    (kDirectional ? 64.0f * face_reach : 1.0f + 2.0f * face_reach * face_reach);
    } else if (!exhaustive) {
      continue;
    }
    if (exhaustive) {
      TestRun(state, *triangles, triangle, face.first_sample, face.end_sample);
    } else if (state.search == Search::kBsp) {
      TestBsp(state, *triangles, triangle, *state.bsp, outline);
    } else {
      TestRows(state, triangle, outline, queue);
    }
  }
  queue->FlushIfFull();
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

void WalkTrianglesImpl(const WalkTask& task, const CasterBlocks& blocks) {
  const FaceFrame frame(*task.frame, *task.face);
  BlockSetup setups[kTogether];
  for (size_t block = 0; block < blocks.count; block += kTogether) {
    const size_t uv = block * 6 * kBlock;
    Triangles triangles = {&setups[0].rows[0][0], blocks.uvs == nullptr ? nullptr : blocks.uvs + uv,
                           blocks.caster};
    RunQueue queue(task, triangles);
    for (size_t i = 0; i < std::min(kTogether, blocks.count - block); ++i) {
      const float* const geometry = blocks.geometry + (block + i) * kBlockFloats;
      const auto first = static_cast<uint32_t>(i) * kSetupFloats;
      if (blocks.next_geometry != nullptr) {
        const float* const next = blocks.next_geometry + (block + i) * kBlockFloats;
        for (int row = 0; row < kBlockFloats; row += kBlock) hwy::Prefetch(next + row);
      }
      for (int offset = 0; offset < kBlock; offset += kLanes) {
        if (task.frame->directional) {
          WalkLanes<true>(task, frame, geometry, offset, first, &setups[i], &triangles, &queue);
        } else {
          WalkLanes<false>(task, frame, geometry, offset, first, &setups[i], &triangles, &queue);
        }
      }
    }
    queue.Flush();
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

void WalkTriangles(const WalkTask& task, const CasterBlocks& blocks) {
  HWY_DYNAMIC_DISPATCH(WalkTrianglesImpl)(task, blocks);
}

}  // namespace shadowfit::irregular
#endif  // HWY_ONCE
