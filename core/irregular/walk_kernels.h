#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/cancellation.h"
#include "core/irregular/clustered_mesh.h"
#include "core/irregular/mask_types.h"

/// Triangles over sorted samples: inner loops compiled for several instruction sets.
namespace shadowfit::irregular {

/// Samples that share a depth in WalkTask::farthest_live.
inline constexpr uint32_t kSamplesOfDepth = 64;

enum class Search { kGrid, kBsp, kExhaustive };

/// Everything a triangle is tested against: the samples of some rows of a face, and their answers. Arrays of
/// answers have as many elements as there are samples, and kPadding more.
struct WalkTask {
  const LightFrame* frame = nullptr;
  const Face* face = nullptr;
  int row_begin = 0, row_end = 0;  ///< Of cells: samples elsewhere are left alone.
  float v_min = 0, v_max = 0;      ///< Enclose the samples in these rows.
  Search search = Search::kGrid;
  const uint32_t* cell_start = nullptr;       ///< Of samples.
  uint32_t first_sample = 0, end_sample = 0;  ///< Of these rows; what follows, up to the next cell, is a gap.
  /// Of samples kSamplesOfDepth * i and so on: no live one, which no caster blocks for certain, is deeper.
  const float* farthest_live = nullptr;
  const std::vector<BspNode>* bsp = nullptr;
  SampleArrays samples;
  uint32_t* shadow = nullptr;         ///< Bit per sample: a caster certainly blocks it.
  uint32_t* touched = nullptr;        ///< Bit per sample: it lies on a caster, within the error bound.
  uint32_t* touched_twice = nullptr;  ///< Bit per sample: on two.
  uint32_t* absorbance[3] = {};       ///< Per channel and sample; null where only bits are asked for.
  int channels = 3;                   ///< One where all casters are grey.
  const Cancellation* cancellation = nullptr;  ///< Once it asks, what is left is not tested.

  bool Cancelled() const { return IsCancelled(cancellation); }
};

/// A cluster of a mesh, as ClusteredMesh describes it, somewhere in the world.
struct CasterCluster {
  const float* lines = nullptr;
  const float* uvs = nullptr;  ///< Two a vertex, or null.
  uint32_t block_count = 0;
  uint32_t vertex_count = 0;                       ///< Zero where corners are separate.
  const glm::mat4x3* world_from_object = nullptr;  ///< Null where that changes nothing.
  const Caster* caster = nullptr;
  const float* next_lines = nullptr;  ///< What is likely to be walked next, to be fetched ahead.
  size_t next_line_count = 0;

  // Where vertices are shared.
  const uint8_t* corner_numbers() const { return reinterpret_cast<const uint8_t*>(lines); }
  const float* vertices() const { return lines + block_count * ClusteredMesh::kNumberFloats; }
};

/// Boxes in plane coordinates, padded by kPadding.
struct BoxArrays {
  const float *u_min, *v_min, *u_max, *v_max, *nearest;
};

/// Numbers of the boxes [begin, end) that overlap the samples; `out` has room for all of them and
/// kPadding more. Returns how many there are.
size_t SelectBoxes(const BoxArrays& boxes, const WalkTask& task, size_t begin, size_t end, uint32_t* out);

/// Tests a cluster's triangles.
void WalkTriangles(const WalkTask& task, const CasterCluster& cluster);

}  // namespace shadowfit::irregular
