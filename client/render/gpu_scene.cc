#include "client/render/gpu_scene.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <numeric>
#include <tuple>

#include "absl/strings/str_format.h"
#include "client/render/gl_context.h"

namespace shadowfit {
namespace {

struct Vertex {
  glm::vec3 ws_position;
  glm::vec3 ws_normal;
  glm::vec2 uv;
};

bool CastsShadow(const Material& material) {
  const glm::vec3& t = material.transmittance;
  return t.r + t.g + t.b < 1.5f;
}

/// Into the bound buffer, for calls that once took an address.
const void* Offset(size_t bytes) {
  return reinterpret_cast<const void*>(bytes);  // NOLINT(performance-no-int-to-ptr): OpenGL's own interface.
}

}  // namespace

absl::StatusOr<GpuScene> GpuScene::Create(const Scene& scene) {
  if (absl::Status status = Validate(scene); !status.ok()) return status;
  GLint max_texture_size = 0;
  glGetIntegerv(GL_MAX_TEXTURE_SIZE, &max_texture_size);
  for (size_t i = 0; i < scene.alpha_textures.size(); ++i) {
    const AlphaTexture& texture = scene.alpha_textures[i];
    if (std::max(texture.width, texture.height) > max_texture_size) {
      return absl::InvalidArgumentError(
          absl::StrFormat("alpha_textures[%d]: %dx%d, OpenGL takes up to %d a side", i, texture.width,
                          texture.height, max_texture_size));
    }
  }
  GpuScene gpu;
  gpu.AddGeometry(scene);
  gpu.AddTextures(scene);
  if (absl::Status status = GlStatus("uploading the scene"); !status.ok()) return status;
  return gpu;
}

void GpuScene::AddGeometry(const Scene& scene) {
  // 1. Order: opaque casters first, then cutouts by texture, so that depth passes need one draw call a
  // texture. Opaque
  //    materials that let most light through stand behind the opaque casters.
  std::vector<int> order(scene.materials.size());
  std::iota(order.begin(), order.end(), 0);
  const auto key = [&](int index) {
    const Material& m = scene.materials[static_cast<size_t>(index)];
    return std::tuple(m.alpha_texture, !CastsShadow(m), m.alpha_cutoff, index);
  };
  std::sort(order.begin(), order.end(), [&](int a, int b) { return key(a) < key(b); });
  std::vector<std::vector<const Instance*>> instances_of(scene.materials.size());
  for (const Instance& instance : scene.instances) {
    const Mesh& mesh = scene.meshes[static_cast<size_t>(instance.mesh)];
    instances_of[static_cast<size_t>(mesh.material)].push_back(&instance);
  }

  // 2. Flatten.
  std::vector<Vertex> vertices;
  std::vector<uint32_t> indices;
  const auto extend = [](std::vector<Run>& runs, const Run& run) {
    const bool continues = !runs.empty() && runs.back().first + runs.back().count == run.first &&
                           runs.back().alpha_texture == run.alpha_texture &&
                           runs.back().alpha_cutoff == run.alpha_cutoff;
    if (continues) {
      runs.back().count += run.count;
    } else {
      runs.push_back(run);
    }
  };
  for (const int index : order) {
    const Material& material = scene.materials[static_cast<size_t>(index)];
    MaterialRun added;
    added.diffuse = material.diffuse;
    added.color_texture = material.color_texture;
    added.run.first = static_cast<int>(indices.size());
    for (const Instance* instance : instances_of[static_cast<size_t>(index)]) {
      const Mesh& mesh = scene.meshes[static_cast<size_t>(instance->mesh)];
      const glm::mat3 linear(instance->world_from_object);
      // Normals stay orthogonal to surfaces under the cofactor matrix, which also exists for singular
      // placements.
      const glm::mat3 normal_matrix(glm::cross(linear[1], linear[2]), glm::cross(linear[2], linear[0]),
                                    glm::cross(linear[0], linear[1]));
      const auto base = static_cast<uint32_t>(vertices.size());
      for (size_t v = 0; v < mesh.positions.size(); ++v) {
        Vertex vertex{};
        vertex.ws_position = instance->world_from_object * glm::vec4(mesh.positions[v], 1.0f);
        if (!mesh.normals.empty()) vertex.ws_normal = normal_matrix * mesh.normals[v];
        if (!mesh.uvs.empty()) vertex.uv = mesh.uvs[v];
        ws_bounds_.Add(glm::dvec3(vertex.ws_position));
        vertices.push_back(vertex);
      }
      for (const glm::uvec3& t : mesh.triangles) {
        indices.insert(indices.end(), {base + t.x, base + t.y, base + t.z});
      }
    }
    added.run.count = static_cast<int>(indices.size()) - added.run.first;
    if (added.run.count == 0) continue;
    added.run.alpha_texture = material.alpha_texture;
    // A cutoff of 0 lets nothing be a hole; half a step below the integer keeps the comparison away from
    // rounding.
    added.run.alpha_cutoff = (static_cast<float>(material.alpha_cutoff) - 0.5f) / 255.0f;
    if (CastsShadow(material)) extend(casters_, added.run);
    extend(surfaces_, added.run);
    materials_.push_back(added);
  }

  // 3. Upload.
  glBindVertexArray(vertex_array_.name());
  glBindBuffer(GL_ARRAY_BUFFER, vertices_.name());
  glBufferData(GL_ARRAY_BUFFER, static_cast<GLsizeiptr>(vertices.size() * sizeof(Vertex)), vertices.data(),
               GL_STATIC_DRAW);
  glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, indices_.name());
  glBufferData(GL_ELEMENT_ARRAY_BUFFER, static_cast<GLsizeiptr>(indices.size() * sizeof(uint32_t)),
               indices.data(), GL_STATIC_DRAW);
  const std::pair<int, size_t> attributes[] = {
      {3, offsetof(Vertex, ws_position)}, {3, offsetof(Vertex, ws_normal)}, {2, offsetof(Vertex, uv)}};
  GLuint location = 0;
  for (const auto& [components, offset] : attributes) {
    glEnableVertexAttribArray(location);
    glVertexAttribPointer(location++, components, GL_FLOAT, GL_FALSE, sizeof(Vertex), Offset(offset));
  }
  glBindVertexArray(0);
}

void GpuScene::AddTextures(const Scene& scene) {
  glPixelStorei(GL_UNPACK_ALIGNMENT, 1);
  for (const AlphaTexture& source : scene.alpha_textures) {
    BindForFetch(GL_TEXTURE_2D, alpha_textures_.emplace_back());
    glTexImage2D(GL_TEXTURE_2D, 0, GL_R8, source.width, source.height, 0, GL_RED, GL_UNSIGNED_BYTE,
                 source.alpha.data());
  }
  for (const ColorTexture& source : scene.color_textures) {
    glBindTexture(GL_TEXTURE_2D, color_textures_.emplace_back().name());
    glTexImage2D(GL_TEXTURE_2D, 0, GL_SRGB8, source.width, source.height, 0, GL_RGB, GL_UNSIGNED_BYTE,
                 source.rgb.data());
    glGenerateMipmap(GL_TEXTURE_2D);
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_LINEAR_MIPMAP_LINEAR);
  }
}

float GpuScene::ws_rounding() const {
  if (ws_bounds_.empty()) return 0.0f;
  const glm::dvec3 largest = glm::max(glm::abs(ws_bounds_.min), glm::abs(ws_bounds_.max));
  // Some 80 steps of a float at the scene's rim: a centimetre for a scene of a kilometre.
  return static_cast<float>(std::max({largest.x, largest.y, largest.z})) * 1e-5f;
}

void GpuScene::DrawRun(const Run& run, const ShaderProgram& program) const {
  program.Set("is_cutout", run.alpha_texture >= 0 ? 1 : 0);
  if (run.alpha_texture >= 0) {
    glActiveTexture(GL_TEXTURE0 + kAlphaUnit);
    glBindTexture(GL_TEXTURE_2D, alpha_textures_[static_cast<size_t>(run.alpha_texture)].name());
    program.Set("alpha_texture", kAlphaUnit);
    program.Set("alpha_cutoff", run.alpha_cutoff);
  }
  glDrawElements(GL_TRIANGLES, run.count, GL_UNSIGNED_INT,
                 Offset(static_cast<size_t>(run.first) * sizeof(uint32_t)));
}

void GpuScene::DrawCasters(const ShaderProgram& program) const {
  glBindVertexArray(vertex_array_.name());
  for (const Run& run : casters_) DrawRun(run, program);
}

void GpuScene::DrawSurfaces(const ShaderProgram& program) const {
  glBindVertexArray(vertex_array_.name());
  for (const Run& run : surfaces_) DrawRun(run, program);
}

void GpuScene::DrawMaterials(const ShaderProgram& program) const {
  glBindVertexArray(vertex_array_.name());
  for (const MaterialRun& material : materials_) {
    program.Set("diffuse", material.diffuse);
    program.Set("has_color_texture", material.color_texture >= 0 ? 1 : 0);
    if (material.color_texture >= 0) {
      glActiveTexture(GL_TEXTURE0 + kColorUnit);
      glBindTexture(GL_TEXTURE_2D, color_textures_[static_cast<size_t>(material.color_texture)].name());
      program.Set("color_texture", kColorUnit);
    }
    DrawRun(material.run, program);
  }
}

}  // namespace shadowfit
