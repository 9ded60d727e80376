#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <span>
#include <vector>

#include "core/cancellation.h"
#include "core/irregular/aligned_buffer.h"
#include "core/irregular/mask_types.h"
#include "core/scene/scene.h"

namespace shadowfit::irregular {

/// A mesh's triangles as the masks stream them: in object space, in clusters of up to kClusterTriangles that
/// lie near each other (Morton order), each of which is read from one place.
///
/// A cluster takes lines of 16 floats, 64 bytes, and one of two forms, the smaller one. Triangles are counted
/// in blocks of kBlock; the places of the last block that no triangle takes have corners that are NaN.
///
///   - Vertices are shared: for each block kNumberFloats floats' room of corners, a byte each, which is the
///     number of a vertex: the first corners of the block's triangles, then their second, then their third;
///     and after all blocks the vertices, four floats each, which are x, y, z and, as an integer, the number
///     of the mesh's position. There is room for a multiple of four.
///
///   - Corners are separate, as in a soup of triangles: for each block nine lines, a.x a.y a.z b.x .. c.z;
///     and after all blocks, three lines each, the numbers of their positions.
///
/// Texture coordinates follow where the mesh is a cutout, two floats a vertex; separate corners are numbered
/// as they lie, first corners of the first block first.
class ClusteredMesh {
 public:
  static constexpr size_t kClusterTriangles = kClusterBlocks * kBlock;
  /// Clusters whose vertices are worth a task.
  static constexpr size_t kTaskClusters = 64;
  static constexpr size_t kLineFloats = 16;
  static constexpr size_t kNumberFloats = 3 * kBlock / sizeof(float);

  struct Cluster {
    uint32_t first_line = 0;
    uint16_t block_count = 0;
    uint16_t vertex_count = 0;  ///< Zero where corners are separate.

    /// Without numbers of positions that lie by themselves, and without texture coordinates.
    size_t line_count() const {
      if (vertex_count == 0) return size_t{block_count} * 9;
      return (block_count * kNumberFloats + size_t{vertex_count} * 4 + kLineFloats - 1) / kLineFloats;
    }
  };

  /// Takes the triangles of a mesh that passes Validate(), with texture coordinates where `cutout`. False
  /// where memory runs out. Incomplete once `cancellation` (may be null) asks.
  [[nodiscard]] bool Create(const Mesh& mesh, bool cutout, const Cancellation* cancellation = nullptr);

  /// Clusters of a mesh of so many triangles.
  static constexpr size_t CountFor(size_t triangles) {
    return (triangles + kClusterTriangles - 1) / kClusterTriangles;
  }

  /// At least MemoryBytes() of what Create() would make.
  static size_t MostBytes(const Mesh& mesh, bool cutout);

  /// Moves the vertices: as many positions as the mesh has. Incomplete once `cancellation` asks.
  void SetPositions(std::span<const glm::vec3> positions, const Cancellation* cancellation = nullptr);

  size_t position_count() const { return position_count_; }
  const std::vector<Cluster>& clusters() const { return clusters_; }
  const float* LinesOf(const Cluster& cluster) const {
    return lines_.data() + size_t{cluster.first_line} * kLineFloats;
  }
  /// Null where the mesh is no cutout.
  const float* UvsOf(const Cluster& cluster) const;

  /// Encloses a cluster's corners elsewhere, each rounded to single precision as they are when it is walked.
  void BoundCluster(const Cluster& cluster, const glm::mat4x3& world_from_object, glm::vec3* ws_min,
                    glm::vec3* ws_max) const;

  size_t MemoryBytes() const { return lines_.MemoryBytes() + clusters_.capacity() * sizeof(Cluster); }

 private:
  /// Of a cluster's triangles. Places without one have corners, too: kNoPosition.
  struct Corners {
    uint8_t vertices[3][kClusterTriangles];         ///< Which of these they are:
    uint32_t positions[3 * kClusterTriangles + 1];  ///< The mesh's, by number, each once.
    size_t position_count = 0;
  };
  static Corners CornersOf(const Mesh& mesh, std::span<const uint32_t> triangles);
  void Fill(const Cluster& cluster, const Corners& corners, const Mesh& mesh);

  float* LinesOf(const Cluster& cluster) { return lines_.data() + size_t{cluster.first_line} * kLineFloats; }

  bool cutout_ = false;
  size_t position_count_ = 0;
  std::vector<Cluster> clusters_;
  AlignedBuffer<float> lines_;
};

}  // namespace shadowfit::irregular
