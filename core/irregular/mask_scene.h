#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "core/cancellation.h"
#include "core/irregular/clustered_mesh.h"
#include "core/scene/scene.h"

namespace shadowfit {

/// The casters of a scene, prepared once so that masks of many frames, cameras and lights can stream them:
/// each mesh once, its triangles in clusters of those that lie near each other, in no more memory than the
/// mesh itself takes (see ClusteredMesh); and around each cluster of each instance a box, 32 bytes. It keeps
/// no hierarchy over them, so that a moved instance or a deformed mesh costs one pass over its own vertices.
///
/// Const use is safe from many threads at once; changes are not, and must not overlap with use.
class MaskScene {
 public:
  /// At most this many clusters of triangles, those of each instance counted: 2^28 triangles, or 2^22
  /// instances of few. Boxes for a light that shines in all directions then take half a gigabyte.
  static constexpr size_t kMaxClusters = size_t{1} << 22;

  /// InvalidArgument where Validate() refuses the scene, ResourceExhausted above kMaxClusters. A scene
  /// without triangles is allowed and casts no shadow. Takes its own copy of what it needs. Cancelled or
  /// DeadlineExceeded once `cancellation` (may be null) asks.
  static absl::StatusOr<MaskScene> Create(const Scene& scene, const Cancellation* cancellation = nullptr);

  /// At least MemoryBytes() of what Create() would make of a scene that passes Validate(): what triangles
  /// without common vertices would take.
  static size_t MostBytes(const Scene& scene);

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

  // What the masks read.

  /// Triangles of one instance that lie near each other.
  struct alignas(16) Cluster {
    glm::vec3 ws_min, ws_max;
    uint32_t instance = 0;
    uint32_t number = 0;  ///< Of the mesh's clusters.
  };
  struct PlacedMesh {
    const irregular::ClusteredMesh& mesh;
    uint32_t material;
    const glm::mat4x3* world_from_object;  ///< Null where that changes nothing.
  };
  const std::vector<Cluster>& clusters() const { return clusters_; }
  PlacedMesh InstanceOf(const Cluster& cluster) const;
  /// Of clusters(), those of an instance.
  std::span<const Cluster> ClustersOf(size_t instance) const;
  /// Sets a cluster's box to where it would be if its instance were elsewhere.
  void Place(const glm::mat4x3& world_from_object, Cluster* cluster) const;
  const std::vector<Material>& materials() const { return materials_; }
  const std::vector<AlphaTexture>& alpha_textures() const { return alpha_textures_; }

 private:
  struct MeshData {
    irregular::ClusteredMesh clustered;
    uint32_t material = 0;
  };
  struct InstanceData {
    uint32_t mesh = 0;
    uint32_t first_cluster = 0;
    glm::mat4x3 world_from_object{1.0f};
    bool placed = false;  ///< By a matrix that is not the identity.
  };

  /// Incomplete once `cancellation` (may be null) asks.
  void PlaceInstance(size_t instance, const glm::mat4x3& world_from_object, const Cancellation* cancellation);

  std::vector<Material> materials_;
  std::vector<AlphaTexture> alpha_textures_;
  std::vector<MeshData> meshes_;
  std::vector<InstanceData> instances_;
  std::vector<Cluster> clusters_;
  size_t triangle_count_ = 0;
};

}  // namespace shadowfit
