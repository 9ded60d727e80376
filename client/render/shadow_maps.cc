#include "client/render/shadow_maps.h"

#include <algorithm>

#include "absl/strings/str_format.h"
#include "client/render/gl_context.h"
#include "core/math/ray_space.h"

namespace shadowfit {
namespace {

constexpr int kShadowMapsUnit = 2;

/// Rounding of depth in the rasteriser: a few dozen steps of a float near 1.
constexpr float kNdcBias = 4e-6f;

GLint InternalFormat(DepthFormat format) {
  switch (format) {
    case DepthFormat::kUnorm16:
      return GL_DEPTH_COMPONENT16;
    case DepthFormat::kUnorm24:
      return GL_DEPTH_COMPONENT24;
    case DepthFormat::kFloat32:
      break;
  }
  return GL_DEPTH_COMPONENT32F;
}

/// A matrix that turns counter-clockwise triangles, as the light sees them, clockwise.
bool Mirrors(const LightView& view) {
  const absl::StatusOr<RaySpace> ray_space = RaySpace::Create(view.light);
  ShadowProjection projection;
  return ray_space.ok() && ProjectionFromClip(*ray_space, view.clip_from_world, view.map_size, &projection) &&
         glm::determinant(projection.texel_from_ray) > 0.0;  // See KeepWinding().
}

/// Draws only the faces that cast.
void CullFaces(const LightView& view) {
  if (!view.test || view.test->casters == CasterFaces::kBoth) {
    glDisable(GL_CULL_FACE);
    return;
  }
  glEnable(GL_CULL_FACE);
  glFrontFace(Mirrors(view) ? GL_CW : GL_CCW);
  glCullFace(view.test->casters == CasterFaces::kFront ? GL_BACK : GL_FRONT);
}

}  // namespace

absl::StatusOr<ShadowMaps> ShadowMaps::Create(std::span<const MapSize> sizes, DepthFormat format) {
  if (sizes.empty() || sizes.size() > static_cast<size_t>(LightBlock::kMaxLights)) {
    return absl::InvalidArgumentError(
        absl::StrFormat("lights: %d, 1 to %d are accepted", sizes.size(), LightBlock::kMaxLights));
  }
  GLint max_size = 0;
  glGetIntegerv(GL_MAX_TEXTURE_SIZE, &max_size);
  MapSize layer;
  for (size_t i = 0; i < sizes.size(); ++i) {
    const MapSize& size = sizes[i];
    if (std::min(size.width, size.height) < 1 || std::max(size.width, size.height) > max_size) {
      return absl::InvalidArgumentError(absl::StrFormat(
          "lights[%d].map_size: %dx%d, OpenGL takes 1 to %d a side", i, size.width, size.height, max_size));
    }
    layer = {std::max(layer.width, size.width), std::max(layer.height, size.height)};
  }
  ShadowMaps maps;
  maps.sizes_.assign(sizes.begin(), sizes.end());
  maps.format_ = format;
  BindForFetch(GL_TEXTURE_2D_ARRAY, maps.depth_);
  glTexImage3D(GL_TEXTURE_2D_ARRAY, 0, InternalFormat(format), layer.width, layer.height,
               static_cast<GLsizei>(sizes.size()), 0, GL_DEPTH_COMPONENT, GL_FLOAT, nullptr);
  glBindFramebuffer(GL_FRAMEBUFFER, maps.framebuffer_.name());
  glFramebufferTextureLayer(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, maps.depth_.name(), 0, 0);
  glDrawBuffer(GL_NONE);
  glReadBuffer(GL_NONE);
  maps.block_.Upload({});
  if (absl::Status status = CheckFramebuffer("shadow maps"); !status.ok()) return status;
  if (absl::Status status = GlStatus("making shadow maps"); !status.ok()) return status;
  return maps;
}

void ShadowMaps::Draw(const GpuScene& scene, const ShaderProgram& depth_program,
                      std::span<const LightView> lights) {
  lights_.assign(lights.begin(), lights.end());
  block_.Upload(lights);
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.name());
  depth_program.Use();
  glEnable(GL_DEPTH_TEST);
  // Casters between the light and the near plane shadow what lies behind it; they are pressed onto it, not
  // clipped.
  glEnable(GL_DEPTH_CLAMP);
  for (size_t i = 0; i < lights.size(); ++i) {
    glFramebufferTextureLayer(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, depth_.name(), 0, static_cast<GLint>(i));
    glViewport(0, 0, sizes_[i].width, sizes_[i].height);
    glClear(GL_DEPTH_BUFFER_BIT);
    CullFaces(lights[i]);
    depth_program.Set("clip_from_world", glm::mat4(lights[i].clip_from_world));
    scene.DrawCasters(depth_program);
  }
  glDisable(GL_CULL_FACE);
  glDisable(GL_DEPTH_CLAMP);
}

void ShadowMaps::Bind(const ShaderProgram& program, const GpuScene& scene) const {
  glActiveTexture(GL_TEXTURE0 + kShadowMapsUnit);
  glBindTexture(GL_TEXTURE_2D_ARRAY, depth_.name());
  program.Set("shadow_maps", kShadowMapsUnit);
  program.Set("ws_bias", scene.ws_rounding());
  program.Set("ndc_bias", kNdcBias);
  program.BindBlock("Lights", LightBlock::kBinding);
  block_.Bind();
}

std::vector<float> ShadowMaps::ReadDepth(int light) const {
  const MapSize size = sizes_[static_cast<size_t>(light)];
  std::vector<float> depth(static_cast<size_t>(size.width) * static_cast<size_t>(size.height));
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.name());
  glFramebufferTextureLayer(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, depth_.name(), 0, light);
  glReadPixels(0, 0, size.width, size.height, GL_DEPTH_COMPONENT, GL_FLOAT, depth.data());
  return depth;
}

}  // namespace shadowfit
