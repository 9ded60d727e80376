#include "core/scene/scene.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_format.h"

namespace shadowfit {
namespace {

int RepeatedTexel(float coordinate, int size) {
  const float wrapped = coordinate - std::floor(coordinate);
  return std::min(static_cast<int>(wrapped * static_cast<float>(size)), size - 1);
}

bool IsFinite(const glm::vec3& v) { return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z); }

/// Elements between two looks at the cancellation.
constexpr size_t kElementsOfPoll = size_t{1} << 16;

/// check(i) for all i < count, up to the first that is not OK.
template <typename Check>
absl::Status CheckAll(size_t count, const Cancellation* cancellation, const Check& check) {
  for (size_t begin = 0; begin < count; begin += kElementsOfPoll) {
    absl::Status status = CancellationStatus(cancellation, "the validation of a scene");
    const size_t end = std::min(count, begin + kElementsOfPoll);
    for (size_t i = begin; i < end && status.ok(); ++i) status = check(i);
    if (!status.ok()) return status;
  }
  return absl::OkStatus();
}

absl::Status ValidateMaterial(const Scene& scene, size_t i) {
  const Material& material = scene.materials[i];
  if (material.alpha_texture < -1 ||
      material.alpha_texture >= static_cast<int>(scene.alpha_textures.size())) {
    return absl::InvalidArgumentError(
        absl::StrFormat("materials[%d].alpha_texture: %d, but there are %d alpha textures", i,
                        material.alpha_texture, scene.alpha_textures.size()));
  }
  if (material.color_texture < -1 ||
      material.color_texture >= static_cast<int>(scene.color_textures.size())) {
    return absl::InvalidArgumentError(
        absl::StrFormat("materials[%d].color_texture: %d, but there are %d color textures", i,
                        material.color_texture, scene.color_textures.size()));
  }
  for (int channel = 0; channel < 3; ++channel) {
    const float t = material.transmittance[channel];
    if (!(t >= 0.0f && t <= 1.0f)) {
      return absl::InvalidArgumentError(
          absl::StrFormat("materials[%d].transmittance[%d]: %g is outside [0,1]", i, channel, t));
    }
  }
  return absl::OkStatus();
}

template <typename Texture>
absl::Status ValidateTexture(const Texture& texture, const std::vector<uint8_t>& bytes, int channels,
                             const char* list, size_t i) {
  if (texture.width <= 0 || texture.height <= 0) {
    return absl::InvalidArgumentError(
        absl::StrFormat("%s[%d]: size %dx%d, both must be positive", list, i, texture.width, texture.height));
  }
  const size_t expected = static_cast<size_t>(texture.width) * static_cast<size_t>(texture.height) *
                          static_cast<size_t>(channels);
  if (bytes.size() != expected) {
    return absl::InvalidArgumentError(absl::StrFormat("%s[%d]: %d bytes, %dx%d needs %d", list, i,
                                                      bytes.size(), texture.width, texture.height, expected));
  }
  return absl::OkStatus();
}

absl::Status ValidateMesh(const Scene& scene, size_t i, const Cancellation* cancellation) {
  const Mesh& mesh = scene.meshes[i];
  if (mesh.material < 0 || mesh.material >= static_cast<int>(scene.materials.size())) {
    return absl::InvalidArgumentError(absl::StrFormat("meshes[%d].material: %d, but there are %d materials",
                                                      i, mesh.material, scene.materials.size()));
  }
  if (mesh.triangles.empty())
    return absl::InvalidArgumentError(absl::StrFormat("meshes[%d].triangles: empty", i));
  absl::Status status = CheckAll(mesh.positions.size(), cancellation, [&](size_t v) {
    const glm::vec3& p = mesh.positions[v];
    if (IsFinite(p)) return absl::OkStatus();
    return absl::InvalidArgumentError(
        absl::StrFormat("meshes[%d].positions[%d]: (%g, %g, %g) is not finite", i, v, p.x, p.y, p.z));
  });
  if (!status.ok()) return status;
  if (!mesh.normals.empty() && mesh.normals.size() != mesh.positions.size()) {
    return absl::InvalidArgumentError(absl::StrFormat("meshes[%d].normals: %d for %d positions", i,
                                                      mesh.normals.size(), mesh.positions.size()));
  }
  if (!mesh.uvs.empty() && mesh.uvs.size() != mesh.positions.size()) {
    return absl::InvalidArgumentError(
        absl::StrFormat("meshes[%d].uvs: %d for %d positions", i, mesh.uvs.size(), mesh.positions.size()));
  }
  if (mesh.uvs.empty() && scene.materials[static_cast<size_t>(mesh.material)].alpha_texture >= 0) {
    return absl::InvalidArgumentError(
        absl::StrFormat("meshes[%d].uvs: none, but material %d is a cutout", i, mesh.material));
  }
  status = CheckAll(mesh.uvs.size(), cancellation, [&](size_t v) {
    const glm::vec2& uv = mesh.uvs[v];
    if (std::isfinite(uv.x) && std::isfinite(uv.y)) return absl::OkStatus();
    return absl::InvalidArgumentError(
        absl::StrFormat("meshes[%d].uvs[%d]: (%g, %g) is not finite", i, v, uv.x, uv.y));
  });
  if (!status.ok()) return status;
  return CheckAll(mesh.triangles.size(), cancellation, [&](size_t t) {
    for (int corner = 0; corner < 3; ++corner) {
      const uint32_t index = mesh.triangles[t][corner];
      if (index < mesh.positions.size()) continue;
      return absl::InvalidArgumentError(
          absl::StrFormat("meshes[%d].triangles[%d][%d]: index %d, but there are %d positions", i, t, corner,
                          index, mesh.positions.size()));
    }
    return absl::OkStatus();
  });
}

absl::Status ValidateInstance(const Scene& scene, size_t i) {
  const Instance& instance = scene.instances[i];
  if (instance.mesh < 0 || instance.mesh >= static_cast<int>(scene.meshes.size())) {
    return absl::InvalidArgumentError(absl::StrFormat("instances[%d].mesh: %d, but there are %d meshes", i,
                                                      instance.mesh, scene.meshes.size()));
  }
  for (int column = 0; column < 4; ++column) {
    if (!IsFinite(instance.world_from_object[column])) {
      return absl::InvalidArgumentError(
          absl::StrFormat("instances[%d].world_from_object[%d]: not finite", i, column));
    }
  }
  return absl::OkStatus();
}

}  // namespace

uint8_t AlphaTexture::AlphaAt(glm::vec2 uv) const {
  const int x = RepeatedTexel(uv.x, width);
  const int y = RepeatedTexel(uv.y, height);
  return alpha[static_cast<size_t>(y) * static_cast<size_t>(width) + static_cast<size_t>(x)];
}

size_t Scene::TriangleCount() const {
  size_t count = 0;
  for (const Instance& instance : instances)
    count += meshes[static_cast<size_t>(instance.mesh)].triangles.size();
  return count;
}

Bounds Scene::WsBounds() const {
  Bounds bounds;
  for (const Instance& instance : instances) {
    for (const glm::vec3& p : meshes[static_cast<size_t>(instance.mesh)].positions) {
      bounds.Add(glm::dvec3(instance.world_from_object * glm::vec4(p, 1.0f)));
    }
  }
  return bounds;
}

absl::Status Validate(const Scene& scene, const Cancellation* cancellation) {
  absl::Status status = CheckAll(scene.alpha_textures.size(), cancellation, [&](size_t i) {
    const AlphaTexture& texture = scene.alpha_textures[i];
    return ValidateTexture(texture, texture.alpha, 1, "alpha_textures", i);
  });
  if (!status.ok()) return status;
  status = CheckAll(scene.color_textures.size(), cancellation, [&](size_t i) {
    const ColorTexture& texture = scene.color_textures[i];
    return ValidateTexture(texture, texture.rgb, 3, "color_textures", i);
  });
  if (!status.ok()) return status;
  status =
      CheckAll(scene.materials.size(), cancellation, [&](size_t i) { return ValidateMaterial(scene, i); });
  if (!status.ok()) return status;
  status = CheckAll(scene.meshes.size(), cancellation,
                    [&](size_t i) { return ValidateMesh(scene, i, cancellation); });
  if (!status.ok()) return status;
  return CheckAll(scene.instances.size(), cancellation, [&](size_t i) { return ValidateInstance(scene, i); });
}

}  // namespace shadowfit
