#include "core/irregular/mask_scene.h"

#include <algorithm>
#include <cmath>

#include "absl/status/status.h"
#include "absl/strings/str_format.h"
#include "core/irregular/parallel.h"

namespace shadowfit {
namespace {

using irregular::ClusteredMesh;

/// Instances that are worth a task; those of many triangles are several.
constexpr size_t kTaskInstances = 64;
constexpr char kPreparation[] = "the preparation of a scene";

bool IsFinite(const glm::vec3& v) { return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z); }

bool IsCutout(const Scene& scene, const Mesh& mesh) {
  return scene.materials[static_cast<size_t>(mesh.material)].alpha_texture >= 0;
}

}  // namespace

absl::StatusOr<MaskScene> MaskScene::Create(const Scene& scene, const Cancellation* cancellation) {
  if (absl::Status status = Validate(scene, cancellation); !status.ok()) return status;
  size_t cluster_count = 0;
  for (const Instance& instance : scene.instances) {
    cluster_count +=
        ClusteredMesh::CountFor(scene.meshes[static_cast<size_t>(instance.mesh)].triangles.size());
  }
  if (cluster_count > kMaxClusters) {
    return absl::ResourceExhaustedError(
        absl::StrFormat("instances: %d with %d triangles in total make %d clusters, at most %d",
                        scene.instances.size(), scene.TriangleCount(), cluster_count, kMaxClusters));
  }
  MaskScene result;
  result.triangle_count_ = scene.TriangleCount();
  result.materials_ = scene.materials;
  result.alpha_textures_ = scene.alpha_textures;
  result.meshes_.resize(scene.meshes.size());
  for (size_t i = 0; i < scene.meshes.size(); ++i) {
    const Mesh& mesh = scene.meshes[i];
    result.meshes_[i].material = static_cast<uint32_t>(mesh.material);
    if (!result.meshes_[i].clustered.Create(mesh, IsCutout(scene, mesh), cancellation)) {
      return absl::ResourceExhaustedError(
          absl::StrFormat("meshes: no memory for %d triangles", mesh.triangles.size()));
    }
    if (absl::Status status = CancellationStatus(cancellation, kPreparation); !status.ok()) return status;
  }
  size_t first_cluster = 0;
  for (const Instance& instance : scene.instances) {
    const auto mesh = static_cast<uint32_t>(instance.mesh);
    result.instances_.push_back({mesh, static_cast<uint32_t>(first_cluster)});
    first_cluster += result.meshes_[mesh].clustered.clusters().size();
  }
  result.clusters_.resize(cluster_count);
  irregular::ForEachPiece(scene.instances.size(), kTaskInstances, cancellation,
                          [&](size_t begin, size_t end) {
                            for (size_t i = begin; i < end; ++i)
                              result.PlaceInstance(i, scene.instances[i].world_from_object, cancellation);
                          });
  if (absl::Status status = CancellationStatus(cancellation, kPreparation); !status.ok()) return status;
  return result;
}

size_t MaskScene::MostBytes(const Scene& scene) {
  size_t bytes = 0;
  for (const AlphaTexture& texture : scene.alpha_textures) bytes += texture.alpha.size();
  for (const Mesh& mesh : scene.meshes) {
    bytes += sizeof(MeshData) + ClusteredMesh::MostBytes(mesh, IsCutout(scene, mesh));
  }
  for (const Instance& instance : scene.instances) {
    const Mesh& mesh = scene.meshes[static_cast<size_t>(instance.mesh)];
    bytes += sizeof(InstanceData) + ClusteredMesh::CountFor(mesh.triangles.size()) * sizeof(Cluster);
  }
  return bytes;
}

MaskScene::PlacedMesh MaskScene::InstanceOf(const Cluster& cluster) const {
  const InstanceData& instance = instances_[cluster.instance];
  const MeshData& mesh = meshes_[instance.mesh];
  return {mesh.clustered, mesh.material, instance.placed ? &instance.world_from_object : nullptr};
}

std::span<const MaskScene::Cluster> MaskScene::ClustersOf(size_t instance) const {
  const InstanceData& data = instances_[instance];
  return std::span(clusters_).subspan(data.first_cluster, meshes_[data.mesh].clustered.clusters().size());
}

void MaskScene::Place(const glm::mat4x3& world_from_object, Cluster* cluster) const {
  const ClusteredMesh& mesh = meshes_[instances_[cluster->instance].mesh].clustered;
  mesh.BoundCluster(mesh.clusters()[cluster->number], world_from_object, &cluster->ws_min, &cluster->ws_max);
}

void MaskScene::PlaceInstance(size_t instance, const glm::mat4x3& world_from_object,
                              const Cancellation* cancellation) {
  InstanceData& data = instances_[instance];
  data.world_from_object = world_from_object;
  data.placed = world_from_object != glm::mat4x3(1.0f);
  const size_t count = ClustersOf(instance).size();
  const std::span<Cluster> clusters = std::span(clusters_).subspan(data.first_cluster, count);
  irregular::ForEachPiece(count, ClusteredMesh::kTaskClusters, cancellation, [&](size_t begin, size_t end) {
    for (size_t i = begin; i < end; ++i) {
      clusters[i].instance = static_cast<uint32_t>(instance);
      clusters[i].number = static_cast<uint32_t>(i);
      Place(world_from_object, &clusters[i]);
    }
  });
}

absl::Status MaskScene::SetInstanceTransform(size_t instance, const glm::mat4x3& world_from_object) {
  if (instance >= instances_.size()) {
    return absl::InvalidArgumentError(
        absl::StrFormat("instance: %d, but there are %d", instance, instances_.size()));
  }
  for (int column = 0; column < 4; ++column) {
    if (!IsFinite(world_from_object[column])) {
      return absl::InvalidArgumentError(
          absl::StrFormat("world_from_object[%d] of instance %d: not finite", column, instance));
    }
  }
  PlaceInstance(instance, world_from_object, nullptr);
  return absl::OkStatus();
}

absl::Status MaskScene::SetMeshPositions(size_t mesh, std::span<const glm::vec3> positions) {
  if (mesh >= meshes_.size()) {
    return absl::InvalidArgumentError(absl::StrFormat("mesh: %d, but there are %d", mesh, meshes_.size()));
  }
  const size_t count = meshes_[mesh].clustered.position_count();
  if (positions.size() != count) {
    return absl::InvalidArgumentError(
        absl::StrFormat("positions of mesh %d: %d, but it has %d", mesh, positions.size(), count));
  }
  for (size_t i = 0; i < positions.size(); ++i) {
    if (IsFinite(positions[i])) continue;
    return absl::InvalidArgumentError(absl::StrFormat("positions[%d] of mesh %d: not finite", i, mesh));
  }
  meshes_[mesh].clustered.SetPositions(positions);
  for (size_t instance = 0; instance < instances_.size(); ++instance) {
    const InstanceData& data = instances_[instance];
    if (data.mesh == mesh) PlaceInstance(instance, data.world_from_object, nullptr);
  }
  return absl::OkStatus();
}

bool MaskScene::HasTransmittance() const {
  return std::any_of(instances_.begin(), instances_.end(), [this](const InstanceData& instance) {
    const MeshData& mesh = meshes_[instance.mesh];
    return !mesh.clustered.clusters().empty() && materials_[mesh.material].transmittance != glm::vec3(0.0f);
  });
}

size_t MaskScene::MemoryBytes() const {
  size_t bytes = clusters_.size() * sizeof(Cluster) + instances_.size() * sizeof(InstanceData);
  for (const MeshData& mesh : meshes_) bytes += sizeof(MeshData) + mesh.clustered.MemoryBytes();
  for (const AlphaTexture& texture : alpha_textures_) bytes += texture.alpha.size();
  return bytes;
}

}  // namespace shadowfit
