#pragma once

#include <limits>

#include "core/bias/depth_test.h"

namespace shadowfit {

/// Which triangles are drawn into the map. The front is where a triangle's corners run counter-clockwise.
enum class CasterFaces {
  kBoth,
  kFront,  ///< Those whose front faces the light.
  kBack,   ///< Those whose back faces the light: needs closed objects, and leaks at thin ones.
};

/// How the comparison keeps a surface from shadowing itself.
enum class BiasKind {
  kConstant,
  kSlopeScaled,    ///< Constant plus slope times (|dz/du| + |dz/dv|) of the receiver, clamped.
  kReceiverPlane,  ///< The receiver's tangent plane is compared at the texel's centre; plus constant.
};

/// How the taps of percentage-closer filtering are weighed.
enum class PcfKernel {
  kBox,   ///< All alike.
  kTent,  ///< Along each axis r + 1 in the middle, falling to 1 at the rim.
};

inline constexpr int kMaxPcfRadius = 16;

/// The standard shadow map's test of one light. The software renderer and the reference know the same one.
struct StandardTest {
  DepthFormat format = DepthFormat::kFloat32;
  BiasKind bias = BiasKind::kSlopeScaled;
  double constant = 0.0;  ///< In window depth, see SafeBias.
  double slope = 0.0;
  /// (2 r + 1)^2 texels are compared, those beyond the map being lit; where one answer is asked for, the
  /// weighty half's. At most kMaxPcfRadius.
  int pcf_radius = 0;
  CasterFaces casters = CasterFaces::kBoth;
  PcfKernel kernel = PcfKernel::kBox;
  double clamp = std::numeric_limits<double>::infinity();  ///< Of constant and slope together.
};

}  // namespace shadowfit
