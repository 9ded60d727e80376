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
  const std::span<const MaskScene::Cluster> clusters = casters.scene->clusters();
  for (size_t begin = 0; begin < clusters.size(); begin += kSelected) {
    uint32_t selected[kSelected + kPadding];
    const size_t end = std::min(clusters.size(), begin + kSelected);
    size_t chosen = end - begin;
    if (task.search == Search::kExhaustive) {
      std::iota(selected, selected + chosen, static_cast<uint32_t>(begin));
    } else {
      chosen = SelectBoxes(boxes, task, begin, end, selected);
    }
    for (size_t i = 0; i < chosen; ++i) {
      if (i % kClustersOfPoll == 0 && task.Cancelled()) return true;
      const MaskScene::Cluster& where = clusters[selected[i]];
      const MaskScene::PlacedMesh placed = casters.scene->InstanceOf(where);
      const Caster& caster = casters.casters[placed.material];
      if (!caster.casts) continue;
      if (culls) {
        if (walked == next_update) {
          depths->Update(&task);
          next_update += period;
        }
        if (!ReachesLiveSamples(task, boxes, selected[i])) continue;
      }
      ++walked;
      const ClusteredMesh::Cluster& cluster = placed.mesh.clusters()[where.number];
      const glm::mat4x3* const moved = casters.moved.empty() ? nullptr : casters.moved[where.instance];
      CasterCluster out;
      out.lines = placed.mesh.LinesOf(cluster);
      out.uvs = placed.mesh.UvsOf(cluster);
      out.block_count = cluster.block_count;
      out.vertex_count = cluster.vertex_count;
      out.world_from_object = moved != nullptr ? moved : placed.world_from_object;
      out.caster = &caster;
      if (i + 1 < chosen) {
        const MaskScene::Cluster& next = clusters[selected[i + 1]];
        const ClusteredMesh& mesh = casters.scene->InstanceOf(next).mesh;
        out.next_lines = mesh.LinesOf(mesh.clusters()[next.number]);
        out.next_line_count = mesh.clusters()[next.number].line_count();
      }
      WalkTriangles(task, out);
    }
  }
  return true;
}

}  // namespace shadowfit::irregular
