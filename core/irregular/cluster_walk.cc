#include "core/irregular/cluster_walk.h"

#include <algorithm>
#include <numeric>

namespace shadowfit::irregular {
namespace {

/// Clusters that are selected together, and those between two looks at the cancellation.
constexpr size_t kSelected = 1024;
constexpr size_t kClustersOfPoll = 64;
/// After a cluster for each so many samples, and some more, it costs little to look at all depths again.
constexpr size_t kSamplesOfCluster = 64;
constexpr size_t kLeastClusters = 64;

}  // namespace

bool WalkClusters(WalkTask task, const BoxArrays& boxes, const CasterInput& casters, LiveDepths* depths) {
  const size_t samples = task.end_sample - task.first_sample;
  const bool culls = task.search == Search::kGrid;
  if (culls && !depths->Reserve(samples)) return false;
  const size_t period = samples / kSamplesOfCluster + kLeastClusters;
  size_t walked = 0, next_update = 0;
  size_t segment_begin = 0;
  for (const CasterSegment& segment : casters.segments) {
    const size_t segment_end = segment_begin + segment.clusters.size();
    for (size_t begin = segment_begin; begin < segment_end; begin += kSelected) {
      uint32_t selected[kSelected + kPadding];
      const size_t end = std::min(segment_end, begin + kSelected);
      size_t chosen = end - begin;
      if (task.search == Search::kExhaustive) {
        std::iota(selected, selected + chosen, static_cast<uint32_t>(begin));
      } else {
        chosen = SelectBoxes(boxes, task, begin, end, selected);
      }
      for (size_t i = 0; i < chosen; ++i) {
        if (i % kClustersOfPoll == 0 && task.Cancelled()) return true;
        const MaskScene::Cluster& cluster = segment.clusters[selected[i] - segment_begin];
        const Caster& caster = casters.casters[cluster.material];
        if (!caster.casts) continue;
        if (culls) {
          if (walked == next_update) {
            depths->Update(&task);
            next_update += period;
          }
          if (!ReachesLiveSamples(task, boxes, selected[i])) continue;
        }
        ++walked;
        const auto geometry_of = [&segment, segment_begin](uint32_t number) {
          return segment.geometry +
                 size_t{segment.clusters[number - segment_begin].first_block} * kBlockFloats;
        };
        CasterBlocks blocks;
        blocks.geometry = geometry_of(selected[i]);
        if (i + 1 < chosen) blocks.next_geometry = geometry_of(selected[i + 1]);
        blocks.uvs = cluster.first_uv < 0 ? nullptr : casters.uvs->data() + cluster.first_uv;
        blocks.count = cluster.block_count;
        blocks.caster = &caster;
        WalkTriangles(task, blocks);
      }
    }
    segment_begin = segment_end;
  }
  return true;
}

}  // namespace shadowfit::irregular
