#pragma once

#include <glm/glm.hpp>

namespace shadowfit {

/// How a projection maps depth to normalised device coordinates (NDC). Engines use all three.
enum class ClipDepth {
  kNegativeOneToOne,   ///< OpenGL: near at z = -1, far at z = +1.
  kZeroToOne,          ///< Direct3D, Vulkan, Metal: near at 0, far at 1.
  kReversedZeroToOne,  ///< near at 1, far at 0.
};

/// NDC depth of a window depth in [0,1]. Window depth is what a depth buffer holds.
constexpr double NdcFromWindowDepth(ClipDepth convention, double window_depth) {
  return convention == ClipDepth::kNegativeOneToOne ? 2.0 * window_depth - 1.0 : window_depth;
}

/// Window depth of the far plane, where nothing was drawn.
constexpr double BackgroundWindowDepth(ClipDepth convention) {
  return convention == ClipDepth::kReversedZeroToOne ? 0.0 : 1.0;
}

/// NDC depth of the near and the far plane.
constexpr double NearNdc(ClipDepth convention) {
  return convention == ClipDepth::kNegativeOneToOne ? -1.0 : convention == ClipDepth::kZeroToOne ? 0.0 : 1.0;
}
constexpr double FarNdc(ClipDepth convention) {
  return convention == ClipDepth::kReversedZeroToOne ? 0.0 : 1.0;
}

}  // namespace shadowfit
