#include "core/irregular/clustered_mesh.h"

#include <tbb/parallel_sort.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <iterator>
#include <limits>

#include "core/irregular/parallel.h"
#include "core/scene/bounds.h"

namespace shadowfit::irregular {
namespace {

/// The number of the position that a place without a triangle has.
constexpr uint32_t kNoPosition = std::numeric_limits<uint32_t>::max();
/// x, y, z and the position's number; of separate corners, too.
constexpr size_t kVertexFloats = 4;

size_t BlocksFor(size_t triangles) { return (triangles + kBlock - 1) / kBlock; }

/// The lowest 21 bits, with two zeros between neighbours.
uint64_t SpreadBits(uint64_t x) {
  x &= 0x1FFFFF;
  x = (x | x << 32) & 0x1F00000000FFFF;
  x = (x | x << 16) & 0x1F0000FF0000FF;
  x = (x | x << 8) & 0x100F00F00F00F00F;
  x = (x | x << 4) & 0x10C30C30C30C30C3;
  return (x | x << 2) & 0x1249249249249249;
}

struct MortonKey {
  uint64_t code;
  uint32_t triangle;
  bool operator<(const MortonKey& other) const {
    return code != other.code ? code < other.code : triangle < other.triangle;
  }
};

/// Comparisons between two looks at the cancellation, and elements that are worth a task.
constexpr uint32_t kComparisonsOfPoll = 1 << 16;
constexpr size_t kTaskElements = 1 << 15;

/// An exception is the only way out of a sort.
struct SortCancelled {};

/// Throws SortCancelled.
void Sort(const Cancellation* cancellation, std::span<MortonKey> keys) {
  tbb::parallel_sort(keys.begin(), keys.end(), [cancellation](const MortonKey& a, const MortonKey& b) {
    static thread_local uint32_t comparisons = 0;
    if (++comparisons % kComparisonsOfPoll == 0 && IsCancelled(cancellation)) {
      throw SortCancelled();
    }
    return a < b;
  });
}

/// Not complete once cancelled.
Bounds BoundsOf(const Mesh& mesh, const Cancellation* cancellation) {
  Bounds bounds;
  for (size_t i = 0; i < mesh.positions.size(); ++i) {
    if (i % kTaskElements == 0 && IsCancelled(cancellation)) break;
    bounds.Add(glm::dvec3(mesh.positions[i]));
  }
  return bounds;
}

/// False where memory runs out. No order at all once cancelled.
bool MortonOrder(const Mesh& mesh, const Cancellation* cancellation, AlignedBuffer<uint32_t>* order) {
  const size_t count = mesh.triangles.size();
  AlignedBuffer<MortonKey> keys;
  if (!keys.Reserve(count) || !order->Reserve(count)) return false;
  const Bounds bounds = BoundsOf(mesh, cancellation);
  const glm::dvec3 extent = glm::max(bounds.max - bounds.min, glm::dvec3(1e-300));
  const double scale = 2097151.0 / std::max({extent.x, extent.y, extent.z});
  ForEachPiece(count, kTaskElements, cancellation, [&](size_t begin, size_t end) {
    for (size_t i = begin; i < end; ++i) {
      const glm::uvec3& t = mesh.triangles[i];
      const glm::dvec3 centre = (glm::dvec3(mesh.positions[t.x]) + glm::dvec3(mesh.positions[t.y]) +
                                 glm::dvec3(mesh.positions[t.z])) /
                                3.0;
      const glm::dvec3 cell = glm::clamp((centre - bounds.min) * scale, 0.0, 2097151.0);
      keys[i].code = SpreadBits(static_cast<uint64_t>(cell.x)) |
                     SpreadBits(static_cast<uint64_t>(cell.y)) << 1 |
                     SpreadBits(static_cast<uint64_t>(cell.z)) << 2;
      keys[i].triangle = static_cast<uint32_t>(i);
    }
  });
  try {
    Sort(cancellation, {keys.data(), count});
  } catch (const SortCancelled&) {
    return true;
  }
  ForEachPiece(count, kTaskElements, cancellation, [&](size_t begin, size_t end) {
    for (size_t i = begin; i < end; ++i) (*order)[i] = keys[i].triangle;
  });
  return true;
}

/// Calls visit(position, number of the mesh's position) for all corners, or vertices, of a cluster.
/// `Float` is float or const float; positions are three floats `stride` apart.
template <typename Float, typename Visit>
void ForEachPosition(const ClusteredMesh::Cluster& cluster, Float* lines, const Visit& visit) {
  if (cluster.vertex_count != 0) {
    Float* const vertices = lines + cluster.block_count * ClusteredMesh::kNumberFloats;
    for (size_t i = 0; i < cluster.vertex_count; ++i) {
      Float* const vertex = vertices + i * kVertexFloats;
      visit(vertex, size_t{1}, vertex + 3);
    }
    return;
  }
  Float* const numbers = lines + size_t{cluster.block_count} * kBlockFloats;
  for (size_t corner = 0; corner < size_t{cluster.block_count} * 3; ++corner) {
    for (size_t i = 0; i < kBlock; ++i) {
      visit(lines + corner * 3 * kBlock + i, size_t{kBlock}, numbers + corner * kBlock + i);
    }
  }
}

/// Texture coordinates follow all else: in floats.
size_t UvStart(const ClusteredMesh::Cluster& cluster) {
  if (cluster.vertex_count == 0) return size_t{cluster.block_count} * 3 * kBlock * kVertexFloats;
  return cluster.block_count * ClusteredMesh::kNumberFloats +
         (size_t{cluster.vertex_count} + 3) / 4 * 4 * kVertexFloats;
}

/// Lines of a cluster with all that belongs to it.
size_t AllLines(const ClusteredMesh::Cluster& cluster, bool cutout) {
  const size_t vertices =
      cluster.vertex_count != 0 ? cluster.vertex_count : size_t{cluster.block_count} * 3 * kBlock;
  const size_t floats = UvStart(cluster) + (cutout ? 2 * vertices : 0);
  return (floats + ClusteredMesh::kLineFloats - 1) / ClusteredMesh::kLineFloats;
}

}  // namespace

ClusteredMesh::Corners ClusteredMesh::CornersOf(const Mesh& mesh, std::span<const uint32_t> triangles) {
  Corners result;
  // Open addressing: one more than the number of a vertex, or zero.
  constexpr int kSlotBits = 9;
  std::array<uint8_t, 1 << kSlotBits> slots{};
  static_assert(std::size(result.positions) < std::numeric_limits<uint8_t>::max());
  const size_t places = BlocksFor(triangles.size()) * kBlock;
  for (size_t i = 0; i < places; ++i) {
    for (int corner = 0; corner < 3; ++corner) {
      const uint32_t position = i < triangles.size() ? mesh.triangles[triangles[i]][corner] : kNoPosition;
      size_t slot = (position * 2654435761u) >> (32 - kSlotBits);
      while (slots[slot] != 0 && result.positions[slots[slot] - 1u] != position) {
        slot = (slot + 1) % slots.size();
      }
      if (slots[slot] == 0) {
        result.positions[result.position_count] = position;
        slots[slot] = static_cast<uint8_t>(++result.position_count);
      }
      result.vertices[corner][i] = static_cast<uint8_t>(slots[slot] - 1);
    }
  }
  return result;
}

bool ClusteredMesh::Create(const Mesh& mesh, bool cutout, const Cancellation* cancellation) {
  cutout_ = cutout;
  position_count_ = mesh.positions.size();
  AlignedBuffer<uint32_t> sorted;
  if (!MortonOrder(mesh, cancellation, &sorted)) return false;
  if (IsCancelled(cancellation)) return true;
  const std::span<const uint32_t> order(sorted.data(), mesh.triangles.size());
  const auto triangles_of = [order](size_t cluster) {
    const size_t first = cluster * kClusterTriangles;
    return order.subspan(first, std::min(kClusterTriangles, order.size() - first));
  };
  clusters_.resize(CountFor(order.size()));
  // Corners are found twice rather than kept, which would take a kilobyte a cluster.
  ForEachPiece(clusters_.size(), kTaskClusters, cancellation, [&](size_t begin, size_t end) {
    for (size_t i = begin; i < end; ++i) {
      Cluster& cluster = clusters_[i];
      cluster.block_count = static_cast<uint16_t>(BlocksFor(triangles_of(i).size()));
      const size_t separate = AllLines(cluster, cutout);
      cluster.vertex_count = static_cast<uint16_t>(CornersOf(mesh, triangles_of(i)).position_count);
      if (AllLines(cluster, cutout) >= separate) cluster.vertex_count = 0;
    }
  });
  if (IsCancelled(cancellation)) return true;
  size_t lines = 0;
  for (Cluster& cluster : clusters_) {
    cluster.first_line = static_cast<uint32_t>(lines);
    lines += AllLines(cluster, cutout);
  }
  if (!lines_.Reserve(lines * kLineFloats)) return false;
  ForEachPiece(clusters_.size(), kTaskClusters, cancellation, [&](size_t begin, size_t end) {
    for (size_t i = begin; i < end; ++i) Fill(clusters_[i], CornersOf(mesh, triangles_of(i)), mesh);
  });
  if (IsCancelled(cancellation)) return true;
  SetPositions(mesh.positions, cancellation);
  return true;
}

/// All but the positions.
void ClusteredMesh::Fill(const Cluster& cluster, const Corners& corners, const Mesh& mesh) {
  float* const lines = LinesOf(cluster);
  std::fill_n(lines, AllLines(cluster, cutout_) * kLineFloats, 0.0f);
  float* uvs = cutout_ ? lines + UvStart(cluster) : nullptr;
  const auto add = [&](uint32_t id, float* number) {
    std::memcpy(number, &id, sizeof(id));
    if (uvs == nullptr) return;
    const glm::vec2 uv = id == kNoPosition ? glm::vec2(0.0f) : mesh.uvs[id];
    *uvs++ = uv.x;
    *uvs++ = uv.y;
  };
  size_t next = 0;
  if (cluster.vertex_count != 0) {
    auto* const numbers = reinterpret_cast<uint8_t*>(lines);
    for (size_t i = 0; i < size_t{cluster.block_count} * kBlock; ++i) {
      for (size_t corner = 0; corner < 3; ++corner) {
        numbers[(i / kBlock * 3 + corner) * kBlock + i % kBlock] = corners.vertices[corner][i];
      }
    }
    ForEachPosition(cluster, lines,
                    [&](float*, size_t, float* number) { add(corners.positions[next++], number); });
  } else {
    ForEachPosition(cluster, lines, [&](float*, size_t, float* number) {
      const size_t block = next / (3 * kBlock), corner = next / kBlock % 3;
      add(corners.positions[corners.vertices[corner][block * kBlock + next % kBlock]], number);
      ++next;
    });
  }
}

size_t ClusteredMesh::MostBytes(const Mesh& mesh, bool cutout) {
  Cluster whole;
  whole.block_count = kClusterBlocks;
  return CountFor(mesh.triangles.size()) *
         (sizeof(Cluster) + AllLines(whole, cutout) * kLineFloats * sizeof(float));
}

void ClusteredMesh::SetPositions(std::span<const glm::vec3> positions, const Cancellation* cancellation) {
  ForEachPiece(clusters_.size(), kTaskClusters, cancellation, [&](size_t begin, size_t end) {
    for (size_t i = begin; i < end; ++i) {
      ForEachPosition(clusters_[i], LinesOf(clusters_[i]), [&](float* p, size_t stride, const float* number) {
        uint32_t id;
        std::memcpy(&id, number, sizeof(id));
        const glm::vec3 position =
            id == kNoPosition ? glm::vec3(std::numeric_limits<float>::quiet_NaN()) : positions[id];
        for (int axis = 0; axis < 3; ++axis) p[static_cast<size_t>(axis) * stride] = position[axis];
      });
    }
  });
}

const float* ClusteredMesh::UvsOf(const Cluster& cluster) const {
  return cutout_ ? LinesOf(cluster) + UvStart(cluster) : nullptr;
}

void ClusteredMesh::BoundCluster(const Cluster& cluster, const glm::mat4x3& world_from_object,
                                 glm::vec3* ws_min, glm::vec3* ws_max) const {
  *ws_min = glm::vec3(std::numeric_limits<float>::infinity());
  *ws_max = -*ws_min;
  ForEachPosition(cluster, LinesOf(cluster), [&](const float* p, size_t stride, const float*) {
    const glm::vec3 ws_position = world_from_object * glm::vec4(p[0], p[stride], p[2 * stride], 1.0f);
    // NaN, where there is no triangle, compares false.
    *ws_min = glm::min(*ws_min, ws_position);
    *ws_max = glm::max(*ws_max, ws_position);
  });
}

}  // namespace shadowfit::irregular
