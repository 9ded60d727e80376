#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "core/frame/camera.h"
#include "core/frame/images.h"
#include "core/math/light.h"
#include "core/math/ray_space.h"
#include "core/math/shadow_projection.h"
#include "core/reference/truth_scene.h"
#include "core/reference/visible_surface.h"

namespace shadowfit {

/// One view of a scene, prepared for counting wrong pixels of many lights and many matrices: the final
/// picture that is judged, and the small one that an optimizer gets to see.
struct ViewStudy {
  Camera camera;
  VisibleSurface screen;   ///< The final picture.
  VisibleSurface samples;  ///< The low-resolution depth buffer of TR-07-07's first pass.

  static ViewStudy Create(const TruthScene& scene, const Camera& camera, MapSize screen_size = {750, 750},
                          MapSize sample_size = {180, 180});
};

/// The truth about one light in one view.
struct LightStudy {
  Light light;
  RaySpace ray_space;
  ShadowMask screen;
  std::vector<uint32_t> bits;  ///< Beside ViewStudy::samples; bit 0 set = in shadow.
  int concerned_pixels = 0;    ///< On the screen.
  int shadowed_pixels = 0;     ///< On the screen.

  static absl::StatusOr<LightStudy> Create(const TruthScene& scene, const ViewStudy& view,
                                           const Light& light);

  BitsView Bits(const ViewStudy& view) const {
    return BottomFirst(bits.data(), view.samples.width, view.samples.height);
  }
};

/// Pixels of the screen that these maps of the light classify wrongly; see ShadowFromMaps.
absl::StatusOr<int> WrongPixels(const TruthScene& scene, const ViewStudy& view, const LightStudy& light,
                                std::span<const ShadowProjection> projections);

/// Sets bit `bit` where the mask says shadow and clears it elsewhere.
void WriteBit(const ShadowMask& mask, int bit, std::vector<uint32_t>* bits);

}  // namespace shadowfit
