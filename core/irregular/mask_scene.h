#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <span>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "core/cancellation.h"
#include "core/irregular/aligned_buffer.h"
#include "core/scene/scene.h"

namespace shadowfit {

/// The casters of a scene, prepared once so that masks of many frames, cameras and lights can stream them:
/// triangles in world space, those near each other side by side (Morton order), with a box around each
/// cluster of them. It keeps no hierarchy over them, so that a moved instance or a deformed mesh costs one
/// pass over its own triangles.
///
/// Const use is safe from many threads at once; changes are not, and must not overlap with use.
class MaskScene {
 public:
  /// At most this many triangles, instances counted one by one.
  static constexpr size_t kMaxTriangles = size_t{1} << 30;

  /// InvalidArgument where Validate() refuses the scene, ResourceExhausted above kMaxTriangles. A scene
  /// without triangles is allowed and casts no shadow. Takes its own copy of what it needs.
  static absl::StatusOr<MaskScene> Create(const Scene& scene);

  /// MemoryBytes() of what Create() would make of a scene that passes Validate(), but for small change.
  static size_t BytesFor(const Scene& scene);

  /// Moves an instance. InvalidArgument where the index is out of range or the matrix is not finite; the
  /// scene is then unchanged.
  absl::Status SetInstanceTransform(size_t instance, const glm::mat4x3& world_from_object);

  /// Deforms a mesh, in all its instances: as many positions as it has. InvalidArgument where the index or
  /// the count is wrong or a value is not finite; the scene is then unchanged.
  absl::Status SetMeshPositions(size_t mesh, std::span<const glm::vec3> positions);

  size_t TriangleCount() const { return triangle_count_; }
  size_t InstanceCount() const { return instances_.size(); }
  size_t MeshCount() const { return meshes_.size(); }
  bool HasTransmittance() const;  ///< True where any caster lets light through.
  size_t MemoryBytes() const;

  // What the masks read. Blocks hold 16 triangles as nine rows of 16 floats (a.x a.y a.z b.x ... c.z); unused
  // places of an instance's last block hold NaN.

  /// Blocks of one instance that lie near each other.
  struct alignas(16) Cluster {
    glm::vec3 ws_min, ws_max;
    uint32_t first_block = 0;
    uint32_t block_count = 0;
    uint32_t material = 0;
    int64_t first_uv = -1;  ///< Of the first block in uvs(): six rows of 16 floats a block; -1 without.
  };
  const std::vector<Cluster>& clusters() const { return clusters_; }
  /// Of clusters(), those of an instance: [first, end).
  std::pair<size_t, size_t> ClustersOf(size_t instance) const;
  /// An instance's clusters and blocks as they would be elsewhere. `clusters` are copies of its own, in which
  /// boxes and first_block (then counted from the first of `blocks`) are set anew; `blocks` has room for
  /// BlocksOf(instance) blocks. Once `cancellation` (may be null) asks, the rest is left undone.
  void Place(size_t instance, const glm::mat4x3& world_from_object, std::span<Cluster> clusters,
             float* blocks, const Cancellation* cancellation = nullptr) const;
  size_t BlocksOf(size_t instance) const;
  const float* geometry() const { return geometry_.data(); }
  const std::vector<float>& uvs() const { return uvs_; }
  const std::vector<Material>& materials() const { return materials_; }
  const std::vector<AlphaTexture>& alpha_textures() const { return alpha_textures_; }

 private:
  struct MeshData {
    std::vector<glm::vec3> positions;
    std::vector<glm::uvec3> triangles;  ///< In Morton order of their centres.
  };
  struct InstanceData {
    size_t mesh = 0;
    glm::mat4x3 world_from_object{1.0f};
    uint32_t first_cluster = 0;
    uint32_t cluster_count = 0;
  };

  void Flatten(const InstanceData& instance);
  void FlattenInto(size_t mesh, const glm::mat4x3& world_from_object, std::span<Cluster> clusters,
                   float* geometry, const Cancellation* cancellation) const;

  std::vector<Material> materials_;
  std::vector<AlphaTexture> alpha_textures_;
  std::vector<MeshData> meshes_;
  std::vector<InstanceData> instances_;
  std::vector<Cluster> clusters_;
  irregular::AlignedBuffer<float> geometry_;
  std::vector<float> uvs_;
  size_t triangle_count_ = 0;
};

}  // namespace shadowfit
