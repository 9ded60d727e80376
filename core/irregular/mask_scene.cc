#include "core/irregular/mask_scene.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "absl/status/status.h"
#include "absl/strings/str_format.h"
#include "core/irregular/mask_types.h"

namespace shadowfit {
namespace {

using irregular::kBlock;
using irregular::kBlockFloats;
using irregular::kClusterBlocks;

constexpr size_t kClusterTriangles = kClusterBlocks * kBlock;

bool IsFinite(const glm::vec3& v) { return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z); }

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

std::vector<uint32_t> MortonOrder(const Mesh& mesh) {
  Bounds bounds;
  for (const glm::vec3& p : mesh.positions) bounds.Add(glm::dvec3(p));
  const glm::dvec3 extent = glm::max(bounds.max - bounds.min, glm::dvec3(1e-300));
  const double scale = 2097151.0 / std::max({extent.x, extent.y, extent.z});
  std::vector<MortonKey> keys(mesh.triangles.size());
  tbb::parallel_for(tbb::blocked_range<size_t>(0, keys.size(), 4096), [&](const auto& range) {
    for (size_t i = range.begin(); i != range.end(); ++i) {
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
  tbb::parallel_sort(keys.begin(), keys.end());
  std::vector<uint32_t> order(keys.size());
  for (size_t i = 0; i < keys.size(); ++i) order[i] = keys[i].triangle;
  return order;
}

size_t BlocksFor(size_t triangles) { return (triangles + kBlock - 1) / kBlock; }

}  // namespace

absl::StatusOr<MaskScene> MaskScene::Create(const Scene& scene) {
  if (absl::Status status = Validate(scene); !status.ok()) return status;
  const size_t triangle_count = scene.TriangleCount();
  if (triangle_count > kMaxTriangles) {
    return absl::ResourceExhaustedError(
        absl::StrFormat("instances: %d triangles in total, at most %d", triangle_count, kMaxTriangles));
  }
  MaskScene result;
  result.triangle_count_ = triangle_count;
  result.materials_ = scene.materials;
  result.alpha_textures_ = scene.alpha_textures;
  std::vector<std::vector<uint32_t>> orders(scene.meshes.size());
  result.meshes_.resize(scene.meshes.size());
  for (size_t m = 0; m < scene.meshes.size(); ++m) {
    orders[m] = MortonOrder(scene.meshes[m]);
    result.meshes_[m].positions = scene.meshes[m].positions;
    result.meshes_[m].triangles.reserve(orders[m].size());
    for (const uint32_t t : orders[m]) result.meshes_[m].triangles.push_back(scene.meshes[m].triangles[t]);
  }

  size_t blocks = 0;
  for (const Instance& instance : scene.instances) {
    const auto mesh_index = static_cast<size_t>(instance.mesh);
    const Mesh& mesh = scene.meshes[mesh_index];
    const size_t triangles = mesh.triangles.size();
    InstanceData data;
    data.mesh = mesh_index;
    data.world_from_object = instance.world_from_object;
    data.first_cluster = static_cast<uint32_t>(result.clusters_.size());
    const bool cutout = scene.materials[static_cast<size_t>(mesh.material)].alpha_texture >= 0;
    for (size_t first = 0; first < triangles; first += kClusterTriangles) {
      Cluster cluster;
      const size_t count = std::min(kClusterTriangles, triangles - first);
      cluster.first_block = static_cast<uint32_t>(blocks);
      cluster.block_count = static_cast<uint32_t>(BlocksFor(count));
      cluster.material = static_cast<uint32_t>(mesh.material);
      if (cutout) {
        cluster.first_uv = static_cast<int64_t>(result.uvs_.size());
        result.uvs_.resize(result.uvs_.size() + size_t{cluster.block_count} * 6 * kBlock);
        for (size_t i = 0; i < count; ++i) {
          const glm::uvec3& t = scene.meshes[mesh_index].triangles[orders[mesh_index][first + i]];
          float* column = result.uvs_.data() + cluster.first_uv + (i / kBlock) * 6 * kBlock + i % kBlock;
          for (int corner = 0; corner < 3; ++corner) {
            column[(2 * corner) * kBlock] = mesh.uvs[t[corner]].x;
            column[(2 * corner + 1) * kBlock] = mesh.uvs[t[corner]].y;
          }
        }
      }
      blocks += cluster.block_count;
      result.clusters_.push_back(cluster);
    }
    data.cluster_count = static_cast<uint32_t>(result.clusters_.size()) - data.first_cluster;
    result.instances_.push_back(data);
  }
  if (!result.geometry_.Reserve(blocks * kBlockFloats)) {
    return absl::ResourceExhaustedError(
        absl::StrFormat("instances: no memory for %d triangles", triangle_count));
  }
  for (const InstanceData& instance : result.instances_) result.Flatten(instance);
  return result;
}

size_t MaskScene::BytesFor(const Scene& scene) {
  size_t bytes = 0;
  for (const AlphaTexture& texture : scene.alpha_textures) bytes += texture.alpha.size();
  for (const Mesh& mesh : scene.meshes) {
    bytes += mesh.positions.size() * sizeof(glm::vec3) + mesh.triangles.size() * sizeof(glm::uvec3);
  }
  for (const Instance& instance : scene.instances) {
    const Mesh& mesh = scene.meshes[static_cast<size_t>(instance.mesh)];
    const bool cutout = scene.materials[static_cast<size_t>(mesh.material)].alpha_texture >= 0;
    const size_t blocks = BlocksFor(mesh.triangles.size());
    bytes += blocks * (kBlockFloats + (cutout ? 6 * kBlock : 0)) * sizeof(float) +
             (blocks + kClusterBlocks - 1) / kClusterBlocks * sizeof(Cluster) + sizeof(InstanceData);
  }
  return bytes;
}

void MaskScene::FlattenInto(size_t mesh_index, const glm::mat4x3& world_from_object,
                            std::span<Cluster> clusters, float* geometry,
                            const Cancellation* cancellation) const {
  const MeshData& mesh = meshes_[mesh_index];
  tbb::parallel_for(tbb::blocked_range<size_t>(0, clusters.size(), 64), [&](const auto& range) {
    if (cancellation != nullptr && cancellation->Requested()) return;
    for (size_t c = range.begin(); c != range.end(); ++c) {
      Cluster& cluster = clusters[c];
      float* blocks = geometry + size_t{cluster.first_block} * kBlockFloats;
      std::fill_n(blocks, size_t{cluster.block_count} * kBlockFloats,
                  std::numeric_limits<float>::quiet_NaN());
      cluster.ws_min = glm::vec3(std::numeric_limits<float>::infinity());
      cluster.ws_max = -cluster.ws_min;
      const size_t first = c * kClusterTriangles;
      const size_t count = std::min(kClusterTriangles, mesh.triangles.size() - first);
      for (size_t i = 0; i < count; ++i) {
        float* column = blocks + (i / kBlock) * kBlockFloats + i % kBlock;
        for (int corner = 0; corner < 3; ++corner) {
          const glm::vec3 p =
              world_from_object * glm::vec4(mesh.positions[mesh.triangles[first + i][corner]], 1.0f);
          for (int axis = 0; axis < 3; ++axis) column[(3 * corner + axis) * kBlock] = p[axis];
          cluster.ws_min = glm::min(cluster.ws_min, p);
          cluster.ws_max = glm::max(cluster.ws_max, p);
        }
      }
    }
  });
}

void MaskScene::Flatten(const InstanceData& instance) {
  const std::span<Cluster> clusters(clusters_.data() + instance.first_cluster, instance.cluster_count);
  FlattenInto(instance.mesh, instance.world_from_object, clusters, geometry_.data(), nullptr);
}

std::pair<size_t, size_t> MaskScene::ClustersOf(size_t instance) const {
  const InstanceData& data = instances_[instance];
  return {data.first_cluster, size_t{data.first_cluster} + data.cluster_count};
}

size_t MaskScene::BlocksOf(size_t instance) const {
  return BlocksFor(meshes_[instances_[instance].mesh].triangles.size());
}

void MaskScene::Place(size_t instance, const glm::mat4x3& world_from_object, std::span<Cluster> clusters,
                      float* blocks, const Cancellation* cancellation) const {
  const uint32_t first_block = clusters.empty() ? 0 : clusters[0].first_block;
  for (Cluster& cluster : clusters) cluster.first_block -= first_block;
  FlattenInto(instances_[instance].mesh, world_from_object, clusters, blocks, cancellation);
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
  instances_[instance].world_from_object = world_from_object;
  Flatten(instances_[instance]);
  return absl::OkStatus();
}

absl::Status MaskScene::SetMeshPositions(size_t mesh, std::span<const glm::vec3> positions) {
  if (mesh >= meshes_.size()) {
    return absl::InvalidArgumentError(absl::StrFormat("mesh: %d, but there are %d", mesh, meshes_.size()));
  }
  if (positions.size() != meshes_[mesh].positions.size()) {
    return absl::InvalidArgumentError(absl::StrFormat("positions of mesh %d: %d, but it has %d", mesh,
                                                      positions.size(), meshes_[mesh].positions.size()));
  }
  for (size_t i = 0; i < positions.size(); ++i) {
    if (IsFinite(positions[i])) continue;
    return absl::InvalidArgumentError(absl::StrFormat("positions[%d] of mesh %d: not finite", i, mesh));
  }
  std::copy(positions.begin(), positions.end(), meshes_[mesh].positions.begin());
  for (const InstanceData& instance : instances_) {
    if (instance.mesh == mesh) Flatten(instance);
  }
  return absl::OkStatus();
}

bool MaskScene::HasTransmittance() const {
  return std::any_of(clusters_.begin(), clusters_.end(), [this](const Cluster& cluster) {
    return materials_[cluster.material].transmittance != glm::vec3(0.0f);
  });
}

size_t MaskScene::MemoryBytes() const {
  size_t bytes = geometry_.MemoryBytes() + uvs_.size() * sizeof(float) + clusters_.size() * sizeof(Cluster) +
                 instances_.size() * sizeof(InstanceData);
  for (const MeshData& mesh : meshes_) {
    bytes += mesh.positions.size() * sizeof(glm::vec3) + mesh.triangles.size() * sizeof(glm::uvec3);
  }
  for (const AlphaTexture& texture : alpha_textures_) bytes += texture.alpha.size();
  return bytes;
}

}  // namespace shadowfit
