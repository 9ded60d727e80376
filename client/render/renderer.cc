#include "client/render/renderer.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_format.h"
#include "client/render/shader_sources.h"
#include "core/math/ray_space.h"

namespace shadowfit {
namespace {

absl::Status CheckSize(const char* name, MapSize size) {
  GLint limit = 0;
  glGetIntegerv(GL_MAX_TEXTURE_SIZE, &limit);
  if (std::min(size.width, size.height) >= 1 && std::max(size.width, size.height) <= limit)
    return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrFormat("%s: %dx%d, 1 to %d a side are accepted", name, size.width, size.height, limit));
}

absl::Status CheckLight(size_t i, const LightView& view, MapSize size, DepthFormat format) {
  if (const absl::StatusOr<RaySpace> space = RaySpace::Create(view.light); !space.ok()) {
    return absl::InvalidArgumentError(absl::StrFormat("lights[%d].%s", i, space.status().message()));
  }
  if (!(view.map_size == size)) {
    return absl::InvalidArgumentError(absl::StrFormat("lights[%d].map_size: %dx%d, but the map has %dx%d", i,
                                                      view.map_size.width, view.map_size.height, size.width,
                                                      size.height));
  }
  for (int entry = 0; entry < 16; ++entry) {
    if (!std::isfinite(view.clip_from_world[entry / 4][entry % 4])) {
      return absl::InvalidArgumentError(
          absl::StrFormat("lights[%d].clip_from_world[%d]: not finite", i, entry));
    }
  }
  if (!view.test) return absl::OkStatus();
  const StandardTest& test = *view.test;
  if (test.format != format) {
    return absl::InvalidArgumentError(absl::StrFormat("lights[%d].test.format: not that of the maps", i));
  }
  if (test.pcf_radius < 0 || test.pcf_radius > kMaxPcfRadius) {
    return absl::InvalidArgumentError(absl::StrFormat("lights[%d].test.pcf_radius: %d is outside 0 to %d", i,
                                                      test.pcf_radius, kMaxPcfRadius));
  }
  for (const auto& [value, name] : {std::pair(test.constant, "constant"), std::pair(test.slope, "slope")}) {
    if (!std::isfinite(value)) {
      return absl::InvalidArgumentError(absl::StrFormat("lights[%d].test.%s: not finite", i, name));
    }
  }
  if (std::isnan(test.clamp)) {
    return absl::InvalidArgumentError(absl::StrFormat("lights[%d].test.clamp: not a number", i));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<Renderer::Programs> Renderer::CreatePrograms() {
  using namespace shaders;
  absl::StatusOr<ShaderProgram> depth =
      ShaderProgram::Create({k_surface_vert}, {k_cutout_glsl, k_depth_frag});
  if (!depth.ok()) return depth.status();
  absl::StatusOr<ShaderProgram> samples = ShaderProgram::Create(
      {k_surface_vert}, {k_cutout_glsl, k_lights_glsl, k_shadow_test_glsl, k_samples_frag});
  if (!samples.ok()) return samples.status();
  absl::StatusOr<ShaderProgram> picture = ShaderProgram::Create(
      {k_surface_vert}, {k_lights_glsl, k_shadow_test_glsl, k_atmosphere_glsl, k_picture_frag});
  if (!picture.ok()) return picture.status();
  absl::StatusOr<ShaderProgram> sky = ShaderProgram::Create({k_sky_vert}, {k_atmosphere_glsl, k_sky_frag});
  if (!sky.ok()) return sky.status();
  return Programs{*std::move(depth), *std::move(samples), *std::move(picture), *std::move(sky)};
}

absl::StatusOr<std::unique_ptr<Renderer>> Renderer::Create(const Scene& scene,
                                                           const RendererOptions& options) {
  absl::StatusOr<GlContext> context = GlContext::Create();
  if (!context.ok()) return context.status();
  if (absl::Status status = CheckSize("screen", options.screen); !status.ok()) return status;
  if (absl::Status status = CheckSize("samples", options.samples); !status.ok()) return status;
  absl::StatusOr<GpuScene> gpu_scene = GpuScene::Create(scene);
  if (!gpu_scene.ok()) return gpu_scene.status();
  absl::StatusOr<Programs> programs = CreatePrograms();
  if (!programs.ok()) return programs.status();
  absl::StatusOr<SamplePass> samples = SamplePass::Create(options.samples);
  if (!samples.ok()) return samples.status();
  absl::StatusOr<SamplePass> screen_samples = SamplePass::Create(options.screen);
  if (!screen_samples.ok()) return screen_samples.status();
  absl::StatusOr<PicturePass> picture = PicturePass::Create(options.screen, false);
  if (!picture.ok()) return picture.status();
  absl::StatusOr<PicturePass> smooth_picture = PicturePass::Create(options.screen, true);
  if (!smooth_picture.ok()) return smooth_picture.status();
  return std::unique_ptr<Renderer>(new Renderer(
      *std::move(context), options, *std::move(gpu_scene), *std::move(programs), *std::move(samples),
      *std::move(screen_samples), *std::move(picture), *std::move(smooth_picture)));
}

Renderer::Renderer(GlContext context, RendererOptions options, GpuScene scene, Programs programs,
                   SamplePass samples, SamplePass screen_samples, PicturePass picture,
                   PicturePass smooth_picture)
    : context_(std::move(context)),
      options_(options),
      scene_(std::move(scene)),
      programs_(std::move(programs)),
      samples_(std::move(samples)),
      screen_samples_(std::move(screen_samples)),
      picture_(std::move(picture)),
      smooth_picture_(std::move(smooth_picture)) {}

Renderer::~Renderer() { context_.MakeCurrent(); }

absl::StatusOr<ShadowMaps> Renderer::CreateShadowMaps(std::span<const MapSize> sizes, DepthFormat format) {
  context_.MakeCurrent();
  return ShadowMaps::Create(sizes, format);
}

absl::Status Renderer::DrawShadowMaps(std::span<const LightView> lights, ShadowMaps* maps) {
  if (lights.size() != maps->sizes().size()) {
    return absl::InvalidArgumentError(
        absl::StrFormat("lights: %d, but there are %d maps", lights.size(), maps->sizes().size()));
  }
  for (size_t i = 0; i < lights.size(); ++i) {
    if (absl::Status status = CheckLight(i, lights[i], maps->sizes()[i], maps->format()); !status.ok())
      return status;
  }
  context_.MakeCurrent();
  maps->Draw(scene_, programs_.depth, lights);
  return GlStatus("drawing shadow maps");
}

void Renderer::Finish() {
  context_.MakeCurrent();
  glFinish();
}

absl::Status Renderer::DrawSamples(const Camera& camera, const ShadowMaps& maps, SampleBuffers* buffers) {
  context_.MakeCurrent();
  samples_.Draw(scene_, programs_.samples, camera, maps, buffers);
  return GlStatus("drawing samples");
}

absl::Status Renderer::DrawShadowBits(const Camera& camera, const ShadowMaps& maps, SampleBuffers* buffers) {
  context_.MakeCurrent();
  screen_samples_.Draw(scene_, programs_.samples, camera, maps, buffers);
  return GlStatus("drawing shadow bits");
}

absl::StatusOr<Picture> Renderer::DrawPicture(const Camera& camera, const ShadowMaps& maps,
                                              bool antialiased) {
  context_.MakeCurrent();
  const PicturePass& pass = antialiased ? smooth_picture_ : picture_;
  Picture picture = pass.Draw(scene_, programs_.picture, programs_.sky, programs_.depth, camera, maps);
  if (absl::Status status = GlStatus("drawing a picture"); !status.ok()) return status;
  return picture;
}

}  // namespace shadowfit
