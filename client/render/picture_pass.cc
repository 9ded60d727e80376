#include "client/render/picture_pass.h"

#include "client/render/gl_context.h"

namespace shadowfit {
namespace {

constexpr GLint kSamplesPerPixel = 4;

/// The first directional light is the sun.
void SetAtmosphere(const ShaderProgram& program, const ShadowMaps& maps) {
  glm::vec3 ws_towards_sun(0.0f);
  glm::vec3 color(0.0f);
  for (const LightView& view : maps.lights()) {
    if (const auto* sun = std::get_if<DirectionalLight>(&view.light)) {
      ws_towards_sun = -glm::normalize(sun->ws_direction);
      color = view.power;
      break;
    }
  }
  program.Set("ws_towards_sun", ws_towards_sun);
  program.Set("sun_color", color);
}

}  // namespace

absl::StatusOr<PicturePass> PicturePass::Create(MapSize size, bool antialiased) {
  PicturePass pass(size);
  const GLenum target = antialiased ? GL_TEXTURE_2D_MULTISAMPLE : GL_TEXTURE_2D;
  const auto attach = [&](const GlTexture& texture, GLint format, GLenum pixel_format, GLenum attachment) {
    BindForFetch(target, texture);
    if (antialiased) {
      glTexImage2DMultisample(target, kSamplesPerPixel, static_cast<GLenum>(format), size.width, size.height,
                              GL_TRUE);
    } else {
      glTexImage2D(target, 0, format, size.width, size.height, 0, pixel_format, GL_FLOAT, nullptr);
    }
    glFramebufferTexture2D(GL_FRAMEBUFFER, attachment, target, texture.name(), 0);
  };
  glBindFramebuffer(GL_FRAMEBUFFER, pass.sample_framebuffer_.name());
  attach(pass.samples_, GL_RGBA8, GL_RGBA, GL_COLOR_ATTACHMENT0);
  attach(pass.sample_depth_, GL_DEPTH_COMPONENT32F, GL_DEPTH_COMPONENT, GL_DEPTH_ATTACHMENT);
  if (absl::Status status = CheckFramebuffer("pictures"); !status.ok()) return status;

  BindForFetch(GL_TEXTURE_2D, pass.color_);
  glTexImage2D(GL_TEXTURE_2D, 0, GL_RGBA8, size.width, size.height, 0, GL_RGBA, GL_UNSIGNED_BYTE, nullptr);
  glBindFramebuffer(GL_FRAMEBUFFER, pass.framebuffer_.name());
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, pass.color_.name(), 0);
  if (absl::Status status = CheckFramebuffer("finished pictures"); !status.ok()) return status;
  if (absl::Status status = GlStatus("making the picture buffers"); !status.ok()) return status;
  return pass;
}

Picture PicturePass::Draw(const GpuScene& scene, const ShaderProgram& program,
                          const ShaderProgram& sky_program, const ShaderProgram& depth_program,
                          const Camera& camera, const ShadowMaps& maps) const {
  glBindFramebuffer(GL_FRAMEBUFFER, sample_framebuffer_.name());
  glViewport(0, 0, size_.width, size_.height);
  glEnable(GL_DEPTH_TEST);
  glClear(GL_DEPTH_BUFFER_BIT);

  // Depth first, so that each sample is shaded once, and with the holes of cutouts: shading draws what has
  // this depth.
  depth_program.Use();
  depth_program.Set("clip_from_world", glm::mat4(camera.clip_from_world()));
  scene.DrawSurfaces(depth_program);

  glDepthFunc(GL_EQUAL);
  program.Use();
  program.Set("clip_from_world", glm::mat4(camera.clip_from_world()));
  program.Set("ws_eye", glm::vec3(camera.ws_eye()));
  SetAtmosphere(program, maps);
  maps.Bind(program, scene);
  scene.DrawMaterials(program);

  glDepthFunc(GL_LEQUAL);
  sky_program.Use();
  sky_program.Set("world_from_clip", glm::mat4(camera.world_from_clip()));
  SetAtmosphere(sky_program, maps);
  glBindVertexArray(no_attributes_.name());
  glDrawArrays(GL_TRIANGLES, 0, 3);
  glDepthFunc(GL_LESS);

  glBindFramebuffer(GL_READ_FRAMEBUFFER, sample_framebuffer_.name());
  glBindFramebuffer(GL_DRAW_FRAMEBUFFER, framebuffer_.name());
  glBlitFramebuffer(0, 0, size_.width, size_.height, 0, 0, size_.width, size_.height, GL_COLOR_BUFFER_BIT,
                    GL_NEAREST);
  Picture picture{size_.width, size_.height, {}};
  picture.rgb.resize(static_cast<size_t>(size_.width) * static_cast<size_t>(size_.height) * 3);
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.name());
  glPixelStorei(GL_PACK_ALIGNMENT, 1);
  glReadPixels(0, 0, size_.width, size_.height, GL_RGB, GL_UNSIGNED_BYTE, picture.rgb.data());
  return picture;
}

}  // namespace shadowfit
