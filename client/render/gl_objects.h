#pragma once

#include <utility>

#include "absl/status/status.h"
#include "client/render/gl.h"

namespace shadowfit {

/// Owns one OpenGL object name. Must die while its context is current.
template <void (*Generate)(GLsizei, GLuint*), void (*Delete)(GLsizei, const GLuint*)>
class GlObject {
 public:
  GlObject() { Generate(1, &name_); }
  ~GlObject() {
    if (name_ != 0) Delete(1, &name_);
  }
  GlObject(GlObject&& other) noexcept : name_(std::exchange(other.name_, 0)) {}
  GlObject& operator=(GlObject&& other) noexcept {
    std::swap(name_, other.name_);
    return *this;
  }

  GLuint name() const { return name_; }

 private:
  GLuint name_ = 0;
};

namespace gl_internal {
inline void GenTextures(GLsizei n, GLuint* names) { glGenTextures(n, names); }
inline void DeleteTextures(GLsizei n, const GLuint* names) { glDeleteTextures(n, names); }
inline void GenBuffers(GLsizei n, GLuint* names) { glGenBuffers(n, names); }
inline void DeleteBuffers(GLsizei n, const GLuint* names) { glDeleteBuffers(n, names); }
inline void GenVertexArrays(GLsizei n, GLuint* names) { glGenVertexArrays(n, names); }
inline void DeleteVertexArrays(GLsizei n, const GLuint* names) { glDeleteVertexArrays(n, names); }
inline void GenFramebuffers(GLsizei n, GLuint* names) { glGenFramebuffers(n, names); }
inline void DeleteFramebuffers(GLsizei n, const GLuint* names) { glDeleteFramebuffers(n, names); }
}  // namespace gl_internal

using GlTexture = GlObject<gl_internal::GenTextures, gl_internal::DeleteTextures>;
using GlBuffer = GlObject<gl_internal::GenBuffers, gl_internal::DeleteBuffers>;
using GlVertexArray = GlObject<gl_internal::GenVertexArrays, gl_internal::DeleteVertexArrays>;
using GlFramebuffer = GlObject<gl_internal::GenFramebuffers, gl_internal::DeleteFramebuffers>;

/// Binds a texture of which texelFetch reads level 0: nearest, no mipmaps.
void BindForFetch(GLenum target, const GlTexture& texture);

/// Internal where the bound framebuffer cannot be drawn to.
absl::Status CheckFramebuffer(const char* what);

}  // namespace shadowfit
