#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "core/cancellation.h"
#include "core/scene/bounds.h"

namespace shadowfit {

/// How opaque a cutout material is across its texture: alpha in [0,1], row 0 at v = 0 (the bottom), repeated
/// outside [0,1]. OpenGL, Embree and every mask method read it with AlphaAt and so see the same holes.
struct AlphaTexture {
  int width = 0;
  int height = 0;
  std::vector<uint8_t> alpha;  ///< width * height values, 255 = opaque.

  /// Nearest texel, repeated.
  uint8_t AlphaAt(glm::vec2 uv) const;
};

/// RGB picture for display; 8 bits a channel, row 0 at v = 0.
struct ColorTexture {
  int width = 0;
  int height = 0;
  std::vector<uint8_t> rgb;
};

struct Material {
  std::string name;
  glm::vec3 diffuse{0.8f};  ///< Linear reflectance in [0,1].
  int color_texture = -1;   ///< Index into Scene::color_textures, or -1.
  int alpha_texture = -1;   ///< Index into Scene::alpha_textures, or -1: a cutout where it is given.
  uint8_t alpha_cutoff =
      128;  ///< A cutout blocks light where AlphaAt >= alpha_cutoff, and is a hole elsewhere.
  glm::vec3 transmittance{0.0f};  ///< Of light that passes; 0 is opaque, (1,1,1) casts no shadow.
};

/// Indexed triangles of one material. All triangles cast and receive on both sides.
struct Mesh {
  std::vector<glm::vec3> positions;   ///< Object space, metres by convention.
  std::vector<glm::vec3> normals;     ///< Shading normals, one a position, or empty.
  std::vector<glm::vec2> uvs;         ///< One a position, or empty. Needed by textured materials.
  std::vector<glm::uvec3> triangles;  ///< Indices into positions.
  int material = 0;
};

/// A placed mesh.
struct Instance {
  int mesh = 0;
  glm::mat4x3 world_from_object{1.0f};  ///< Affine; column-major, last column the translation.
};

struct Scene {
  std::string name;
  std::vector<Material> materials;
  std::vector<AlphaTexture> alpha_textures;
  std::vector<ColorTexture> color_textures;
  std::vector<Mesh> meshes;
  std::vector<Instance> instances;

  size_t TriangleCount() const;  ///< Of all instances.
  Bounds WsBounds() const;
};

/// Checks every index, size and value; the message names the field, as "meshes[3].triangles[17].y: 9 ...".
/// Cancelled or DeadlineExceeded once `cancellation` (may be null) asks.
absl::Status Validate(const Scene& scene, const Cancellation* cancellation = nullptr);

}  // namespace shadowfit
