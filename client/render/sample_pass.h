#pragma once

#include <cstdint>
#include <vector>

#include "absl/status/statusor.h"
#include "client/render/gl_objects.h"
#include "client/render/gpu_scene.h"
#include "client/render/shader_program.h"
#include "client/render/shadow_maps.h"
#include "core/frame/camera.h"
#include "core/frame/images.h"

namespace shadowfit {

/// What the service reads of a frame: window depth, and a bit a light that is set where the light's shadow
/// map leaves the pixel in shadow. Row 0 at the bottom.
struct SampleBuffers {
  int width = 0;
  int height = 0;
  std::vector<float> depth;
  std::vector<uint32_t> bits;

  DepthView Depth() const { return BottomFirst(depth.data(), width, height); }
  BitsView Bits() const { return BottomFirst(bits.data(), width, height); }
};

/// TR-07-07's first pass: the scene from the camera into a depth and a bit buffer. At 180x180 or so it feeds
/// the optimizer; at the screen's size it tells which pixels the maps shadow.
class SamplePass {
 public:
  static absl::StatusOr<SamplePass> Create(MapSize size);

  /// `program`: surface.vert with samples.frag. `buffers` keeps its memory from call to call.
  void Draw(const GpuScene& scene, const ShaderProgram& program, const Camera& camera, const ShadowMaps& maps,
            SampleBuffers* buffers) const;

 private:
  explicit SamplePass(MapSize size) : size_(size) {}

  MapSize size_;
  GlTexture depth_;
  GlTexture bits_;
  GlFramebuffer framebuffer_;
};

}  // namespace shadowfit
