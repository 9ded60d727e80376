#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <vector>

#include "core/frame/images.h"

namespace shadowfit {

inline constexpr uint32_t kNoPrimitive = 0xffffffffu;

/// What a camera sees through its pixel centres, found by rays. One entry a pixel, row 0 at the bottom.
struct VisibleSurface {
  int width = 0;
  int height = 0;
  std::vector<float> depth;           ///< Window depth in the camera's clip convention.
  std::vector<uint32_t> primitive;    ///< Triangle of the truth scene; kNoPrimitive where nothing is seen.
  std::vector<glm::dvec3> ws_point;   ///< On the triangle's plane; meaningless where nothing is seen.
  std::vector<glm::dvec3> ws_normal;  ///< Geometric unit normal, turned towards the viewer.

  size_t size() const { return primitive.size(); }
  DepthView Depth() const { return BottomFirst(depth.data(), width, height); }
};

/// How a light stands to a visible pixel.
enum class PixelLight : uint8_t {
  /// Nothing is seen there, or the side that is seen faces away from the light or lies outside a spot's cone:
  /// the pixel is dark whatever the shadow map says, and takes no part in any count.
  kNotConcerned,
  kLit,
  kShadowed,
};

/// One light's PixelLight a pixel, in the order of the surface.
using ShadowMask = std::vector<PixelLight>;

}  // namespace shadowfit
