#pragma once

#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "client/render/gl_objects.h"
#include "client/render/gpu_scene.h"
#include "client/render/light_block.h"
#include "client/render/shader_program.h"

namespace shadowfit {

/// The shadow maps of a frame's lights: one layer a light of a depth texture array, in which a map smaller
/// than the array fills the lower left corner. Remembers the lights and matrices that it was drawn with,
/// because a map means nothing without them. Renderer makes these; they must die before it.
class ShadowMaps {
 public:
  static absl::StatusOr<ShadowMaps> Create(std::span<const MapSize> sizes,
                                           DepthFormat format = DepthFormat::kFloat32);

  /// What the maps hold; empty before they are drawn, and then no light shines.
  std::span<const LightView> lights() const { return lights_; }
  std::span<const MapSize> sizes() const { return sizes_; }
  DepthFormat format() const { return format_; }

  /// Window depth of one map, row 0 at the bottom.
  std::vector<float> ReadDepth(int light) const;

  /// Draws every light's casters with `depth_program` (surface.vert, depth.frag). One light a map, of
  /// its size.
  void Draw(const GpuScene& scene, const ShaderProgram& depth_program, std::span<const LightView> lights);

  /// Binds maps and lights for a program that contains lights.glsl and shadow_test.glsl.
  void Bind(const ShaderProgram& program, const GpuScene& scene) const;

 private:
  ShadowMaps() = default;

  GlTexture depth_;
  GlFramebuffer framebuffer_;
  LightBlock block_;
  std::vector<MapSize> sizes_;
  DepthFormat format_ = DepthFormat::kFloat32;
  std::vector<LightView> lights_;
};

}  // namespace shadowfit
