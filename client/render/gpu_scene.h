#pragma once

#include <glm/glm.hpp>
#include <vector>

#include "absl/status/statusor.h"
#include "client/render/gl_objects.h"
#include "client/render/shader_program.h"
#include "core/scene/scene.h"

namespace shadowfit {

/// A scene in OpenGL buffers: instances flattened into world space, triangles sorted so that all opaque
/// casters are one draw call. Vertex attributes: 0 world position, 1 world normal, 2 texture coordinates.
class GpuScene {
 public:
  static absl::StatusOr<GpuScene> Create(const Scene& scene);

  /// Draws geometry with the program in use, which contains shaders/cutout.glsl (uniforms `is_cutout`,
  /// `alpha_texture`, `alpha_cutoff`). Casters are all materials that stop at least half of the light.
  void DrawCasters(const ShaderProgram& program) const;
  /// The same for all that a camera sees.
  void DrawSurfaces(const ShaderProgram& program) const;
  /// The same with each material's uniforms: `diffuse`, `color_texture`, `has_color_texture`.
  void DrawMaterials(const ShaderProgram& program) const;

  const Bounds& ws_bounds() const { return ws_bounds_; }

  /// A length that covers the rounding of world coordinates on their way through the rasteriser.
  float ws_rounding() const;

  static constexpr int kAlphaUnit = 0;
  static constexpr int kColorUnit = 1;

 private:
  /// A run of the index buffer with one alpha texture (or none).
  struct Run {
    int first = 0;
    int count = 0;
    int alpha_texture = -1;
    float alpha_cutoff = 0.0f;
  };
  struct MaterialRun {
    Run run;
    glm::vec3 diffuse{0.0f};
    int color_texture = -1;
  };

  GpuScene() = default;
  void AddGeometry(const Scene& scene);
  void AddTextures(const Scene& scene);
  void DrawRun(const Run& run, const ShaderProgram& program) const;

  Bounds ws_bounds_;
  GlVertexArray vertex_array_;
  GlBuffer vertices_;
  GlBuffer indices_;
  std::vector<Run> casters_;
  std::vector<Run> surfaces_;
  std::vector<MaterialRun> materials_;
  std::vector<GlTexture> alpha_textures_;
  std::vector<GlTexture> color_textures_;
};

}  // namespace shadowfit
