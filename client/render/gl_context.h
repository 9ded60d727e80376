#pragma once

#include <memory>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

struct osmesa_context;

namespace shadowfit {

/// An OpenGL 3.3 core context of Mesa's software rasteriser. All drawing goes to framebuffer objects; the
/// context's own picture is one pixel. A context is current on one thread at a time.
class GlContext {
 public:
  static absl::StatusOr<GlContext> Create();

  /// Makes the context current on the calling thread.
  void MakeCurrent();

 private:
  struct Deleter {
    void operator()(osmesa_context* context) const;
  };
  explicit GlContext(osmesa_context* context) : context_(context), pixel_(new unsigned char[4]) {}

  std::unique_ptr<osmesa_context, Deleter> context_;
  std::unique_ptr<unsigned char[]> pixel_;  // Stays put when the context is moved.
};

/// Internal with the name of the first pending OpenGL error, and clears them all; OK where there is none.
absl::Status GlStatus(const char* doing);

}  // namespace shadowfit
