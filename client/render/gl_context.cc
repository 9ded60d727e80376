#include "client/render/gl_context.h"

#include <GL/osmesa.h>

#include "absl/strings/str_format.h"
#include "client/render/gl.h"

namespace shadowfit {

void GlContext::Deleter::operator()(osmesa_context* context) const { OSMesaDestroyContext(context); }

absl::StatusOr<GlContext> GlContext::Create() {
  const int attributes[] = {OSMESA_FORMAT,
                            OSMESA_RGBA,
                            OSMESA_DEPTH_BITS,
                            0,
                            OSMESA_PROFILE,
                            OSMESA_CORE_PROFILE,
                            OSMESA_CONTEXT_MAJOR_VERSION,
                            3,
                            OSMESA_CONTEXT_MINOR_VERSION,
                            3,
                            0};
  GlContext context(OSMesaCreateContextAttribs(attributes, nullptr));
  if (context.context_ == nullptr) {
    return absl::UnavailableError("OpenGL: OSMesa cannot make a 3.3 core context");
  }
  if (!OSMesaMakeCurrent(context.context_.get(), context.pixel_.get(), GL_UNSIGNED_BYTE, 1, 1)) {
    return absl::UnavailableError("OpenGL: OSMesa cannot make its context current");
  }
  return context;
}

void GlContext::MakeCurrent() {
  if (OSMesaGetCurrentContext() == context_.get()) return;
  OSMesaMakeCurrent(context_.get(), pixel_.get(), GL_UNSIGNED_BYTE, 1, 1);
}

absl::Status GlStatus(const char* doing) {
  const GLenum error = glGetError();
  if (error == GL_NO_ERROR) return absl::OkStatus();
  while (glGetError() != GL_NO_ERROR) {
  }
  const std::string message = absl::StrFormat("OpenGL: error 0x%04x while %s", error, doing);
  return error == GL_OUT_OF_MEMORY ? absl::ResourceExhaustedError(message) : absl::InternalError(message);
}

}  // namespace shadowfit
