#include "core/irregular/live_depths.h"

#include <algorithm>
#include <limits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/irregular/live_depths.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/irregular/simd.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::irregular {
namespace HWY_NAMESPACE {

void UpdateImpl(const WalkTask& task, float* farthest) {
  const VF nothing = hn::Set(df, -kInfinity);
  for (uint32_t s = task.first_sample; s < task.end_sample;) {
    const uint32_t chunk = s / kSamplesOfDepth;
    const uint32_t end = std::min((chunk + 1) * kSamplesOfDepth, task.end_sample);
    VF most = nothing;
    for (; s < end; s += kLanes) {
      const MF live = LanesOf(FirstBits(end - s) & ~BitsAt(task.shadow, s));
      most = hn::Max(most, hn::IfThenElse(live, hn::LoadU(df, task.samples.depth + s), nothing));
    }
    s = end;
    farthest[chunk] = hn::GetLane(hn::MaxOfLanes(df, most));
  }
}

/// Of chunks without a live sample deep enough nothing more is read; most others have one in their first few
/// vectors.
bool ReachesLiveSamplesImpl(const WalkTask& task, const BoxArrays& boxes, size_t box) {
  const Face& face = *task.face;
  const SampleArrays samples = task.samples;
  const float nearest = boxes.nearest[box];
  const VF u_min = hn::Set(df, boxes.u_min[box]), u_max = hn::Set(df, boxes.u_max[box]);
  const VF v_min = hn::Set(df, boxes.v_min[box]), v_max = hn::Set(df, boxes.v_max[box]);
  const auto in_box = [&](uint32_t s) HWY_ATTR {
    const VF u = hn::LoadU(df, samples.u + s), v = hn::LoadU(df, samples.v + s);
    const MF in_plane = hn::And(hn::And(hn::Ge(u, u_min), hn::Le(u, u_max)),  //
                                hn::And(hn::Ge(v, v_min), hn::Le(v, v_max)));
    return BitsOf(hn::And(in_plane, hn::Ge(hn::LoadU(df, samples.depth + s), hn::Set(df, nearest))));
  };
  const int row_end = std::min(face.RowAt(boxes.v_max[box]).number + 1, task.row_end);
  for (int i = std::max(face.RowAt(boxes.v_min[box]).number, task.row_begin); i < row_end; ++i) {
    const Row& row = face.row_of_bin[static_cast<size_t>(face.first_bin_of_row[static_cast<size_t>(i)])];
    uint32_t s = task.cell_start[face.CellAt(row, boxes.u_min[box])];
    const uint32_t end = std::min(task.cell_start[face.CellAt(row, boxes.u_max[box]) + 1], task.end_sample);
    while (s < end) {
      const uint32_t chunk = s / kSamplesOfDepth;
      const uint32_t chunk_end = std::min((chunk + 1) * kSamplesOfDepth, end);
      if (task.farthest_live[chunk] >= nearest) {
        for (; s < chunk_end; s += kLanes) {
          if ((in_box(s) & FirstBits(chunk_end - s) & ~BitsAt(task.shadow, s)) != 0) return true;
        }
      }
      s = chunk_end;
    }
  }
  return false;
}

}  // namespace HWY_NAMESPACE
}  // namespace shadowfit::irregular
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit::irregular {

HWY_EXPORT(UpdateImpl);
HWY_EXPORT(ReachesLiveSamplesImpl);

bool LiveDepths::Reserve(size_t samples) { return farthest_.Reserve(samples / kSamplesOfDepth + 2); }

void LiveDepths::Update(WalkTask* task) {
  float* const farthest = farthest_.data() - task->first_sample / kSamplesOfDepth;
  HWY_DYNAMIC_DISPATCH(UpdateImpl)(*task, farthest);
  task->farthest_live = farthest;
}

bool ReachesLiveSamples(const WalkTask& task, const BoxArrays& boxes, size_t box) {
  return HWY_DYNAMIC_DISPATCH(ReachesLiveSamplesImpl)(task, boxes, box);
}

}  // namespace shadowfit::irregular
#endif  // HWY_ONCE
