#include "client/render/gl_objects.h"

#include "absl/strings/str_format.h"

namespace shadowfit {

void BindForFetch(GLenum target, const GlTexture& texture) {
  glBindTexture(target, texture.name());
  if (target == GL_TEXTURE_2D_MULTISAMPLE) return;
  glTexParameteri(target, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
  glTexParameteri(target, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
  glTexParameteri(target, GL_TEXTURE_MAX_LEVEL, 0);
}

absl::Status CheckFramebuffer(const char* what) {
  const GLenum status = glCheckFramebufferStatus(GL_FRAMEBUFFER);
  if (status == GL_FRAMEBUFFER_COMPLETE) return absl::OkStatus();
  return absl::InternalError(
      absl::StrFormat("OpenGL: the framebuffer for %s is incomplete (0x%04x)", what, status));
}

}  // namespace shadowfit
