#pragma once

#include <glm/glm.hpp>
#include <memory>
#include <span>

#include "absl/status/statusor.h"
#include "client/render/gl_context.h"
#include "client/render/gpu_scene.h"
#include "client/render/light_block.h"
#include "client/render/picture_pass.h"
#include "client/render/sample_pass.h"
#include "client/render/shader_program.h"
#include "client/render/shadow_maps.h"
#include "core/frame/camera.h"
#include "core/scene/scene.h"

namespace shadowfit {

struct RendererOptions {
  MapSize screen{1024, 768};  ///< Of finished pictures.
  MapSize samples{208,
                  156};  ///< Of the low-resolution pass: as many pixels as 180x180, in the screen's aspect.
};

/// Draws a scene with shadow maps, in software (OSMesa): no display and no GPU needed. Cameras and light
/// matrices are in OpenGL's depth convention. Use from one thread at a time.
class Renderer {
 public:
  /// InvalidArgument where a size is not positive or beyond OpenGL's limit, or Validate() refuses the scene.
  static absl::StatusOr<std::unique_ptr<Renderer>> Create(const Scene& scene, const RendererOptions& options);
  ~Renderer();
  Renderer(const Renderer&) = delete;
  Renderer& operator=(const Renderer&) = delete;

  /// Room for the shadow maps of a set of lights.
  absl::StatusOr<ShadowMaps> CreateShadowMaps(std::span<const MapSize> sizes,
                                              DepthFormat format = DepthFormat::kFloat32);

  /// One depth pass a light. InvalidArgument where a light is malformed, a matrix is not finite, or number or
  /// sizes differ from those that the maps were made for.
  absl::Status DrawShadowMaps(std::span<const LightView> lights, ShadowMaps* maps);

  /// The low-resolution pass, read back.
  absl::Status DrawSamples(const Camera& camera, const ShadowMaps& maps, SampleBuffers* buffers);

  /// The same at the screen's resolution: which pixels of the picture each map shadows.
  absl::Status DrawShadowBits(const Camera& camera, const ShadowMaps& maps, SampleBuffers* buffers);

  /// `antialiased` smooths the outlines of surfaces, not those of shadows, and takes some four times as long.
  absl::StatusOr<Picture> DrawPicture(const Camera& camera, const ShadowMaps& maps, bool antialiased = false);

  /// Waits until all is drawn, for those who measure time.
  void Finish();

  const Bounds& ws_bounds() const { return scene_.ws_bounds(); }
  const RendererOptions& options() const { return options_; }

 private:
  struct Programs {
    ShaderProgram depth;
    ShaderProgram samples;
    ShaderProgram picture;
    ShaderProgram sky;
  };
  Renderer(GlContext context, RendererOptions options, GpuScene scene, Programs programs, SamplePass samples,
           SamplePass screen_samples, PicturePass picture, PicturePass smooth_picture);
  static absl::StatusOr<Programs> CreatePrograms();

  GlContext context_;  // First, so that it outlives what was made in it.
  RendererOptions options_;
  GpuScene scene_;
  Programs programs_;
  SamplePass samples_;
  SamplePass screen_samples_;
  PicturePass picture_;
  PicturePass smooth_picture_;
};

}  // namespace shadowfit
