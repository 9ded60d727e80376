#include "client/render/sample_pass.h"

#include "client/render/gl_context.h"

namespace shadowfit {

absl::StatusOr<SamplePass> SamplePass::Create(MapSize size) {
  SamplePass pass(size);
  BindForFetch(GL_TEXTURE_2D, pass.depth_);
  glTexImage2D(GL_TEXTURE_2D, 0, GL_DEPTH_COMPONENT32F, size.width, size.height, 0, GL_DEPTH_COMPONENT,
               GL_FLOAT, nullptr);
  BindForFetch(GL_TEXTURE_2D, pass.bits_);
  glTexImage2D(GL_TEXTURE_2D, 0, GL_R32UI, size.width, size.height, 0, GL_RED_INTEGER, GL_UNSIGNED_INT,
               nullptr);
  glBindFramebuffer(GL_FRAMEBUFFER, pass.framebuffer_.name());
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_TEXTURE_2D, pass.depth_.name(), 0);
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, pass.bits_.name(), 0);
  if (absl::Status status = CheckFramebuffer("samples"); !status.ok()) return status;
  if (absl::Status status = GlStatus("making the sample buffers"); !status.ok()) return status;
  return pass;
}

void SamplePass::Draw(const GpuScene& scene, const ShaderProgram& program, const Camera& camera,
                      const ShadowMaps& maps, SampleBuffers* buffers) const {
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.name());
  glViewport(0, 0, size_.width, size_.height);
  glEnable(GL_DEPTH_TEST);
  const GLuint no_bits[4] = {0, 0, 0, 0};
  glClearBufferuiv(GL_COLOR, 0, no_bits);
  glClear(GL_DEPTH_BUFFER_BIT);
  program.Use();
  program.Set("clip_from_world", glm::mat4(camera.clip_from_world()));
  maps.Bind(program, scene);
  scene.DrawSurfaces(program);

  buffers->width = size_.width;
  buffers->height = size_.height;
  const size_t pixels = static_cast<size_t>(size_.width) * static_cast<size_t>(size_.height);
  buffers->depth.resize(pixels);
  buffers->bits.resize(pixels);
  glPixelStorei(GL_PACK_ALIGNMENT, 4);
  glReadPixels(0, 0, size_.width, size_.height, GL_DEPTH_COMPONENT, GL_FLOAT, buffers->depth.data());
  glReadPixels(0, 0, size_.width, size_.height, GL_RED_INTEGER, GL_UNSIGNED_INT, buffers->bits.data());
}

}  // namespace shadowfit
