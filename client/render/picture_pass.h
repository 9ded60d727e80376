#pragma once

#include <cstdint>
#include <vector>

#include "absl/status/statusor.h"
#include "client/render/gl_objects.h"
#include "client/render/gpu_scene.h"
#include "client/render/shader_program.h"
#include "client/render/shadow_maps.h"
#include "core/frame/camera.h"

namespace shadowfit {

/// A finished picture: sRGB, 8 bits a channel, row 0 at the bottom.
struct Picture {
  int width = 0;
  int height = 0;
  std::vector<uint8_t> rgb;
};

/// The shading pass: the scene under its lights, with their shadow maps, and the sky.
class PicturePass {
 public:
  /// `antialiased`: several samples a pixel, so that poles and rails are not jagged. Shadows are tested once
  /// a pixel either way.
  static absl::StatusOr<PicturePass> Create(MapSize size, bool antialiased);

  /// `program`: surface.vert with picture.frag; `sky_program`: sky.vert with sky.frag; `depth_program`:
  /// surface.vert with depth.frag.
  Picture Draw(const GpuScene& scene, const ShaderProgram& program, const ShaderProgram& sky_program,
               const ShaderProgram& depth_program, const Camera& camera, const ShadowMaps& maps) const;

 private:
  explicit PicturePass(MapSize size) : size_(size) {}

  MapSize size_;
  GlTexture samples_;
  GlTexture sample_depth_;
  GlFramebuffer sample_framebuffer_;
  GlTexture color_;
  GlFramebuffer framebuffer_;
  GlVertexArray no_attributes_;
};

}  // namespace shadowfit
