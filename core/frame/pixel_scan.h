#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "core/frame/images.h"
#include "core/frame/lane_list.h"

namespace shadowfit {

// The passes that read a frame's pictures, vectorised with run-time dispatch (Highway). None sums, so that
// their results are the same on every machine.

/// How a pixel's depth becomes its inverse distance: the homogeneous coordinate of the unprojected point,
/// proportional to the reciprocal of view distance and so affine on planes; NDC depth, up to a constant, for
/// an orthographic camera. It is `constant + per_x x + per_y y + per_depth (d - background)`: counted from
/// the background's depth on, so that near and far terms have one sign and float does not cancel.
struct InverseDistanceLaw {
  double constant = 0.0;
  double per_x = 0.0;
  double per_y = 0.0;
  double per_depth = 1.0;
  float background = 1.0f;       ///< Window depth of the background: 1, or 0 for reversed depth.
  bool must_be_positive = true;  ///< Perspective: other pixels lie behind the viewer.
};

/// A frame's pixels with a rim on every side, so that neighbours need no bounds check. Rows begin at whole
/// vectors; the rim left of a row is also that right of the row below.
struct PixelPlanes {
  /// Below, above and beside the picture: of an active pixel's neighbours the surface goes on to theirs.
  static constexpr int kRimRows = 2;
  static constexpr int kRimColumns = kMostLanes;

  int width = 0;
  int height = 0;
  std::ptrdiff_t stride = 0;
  AlignedVector<float> window_depth;      ///< Meaningless where there is no surface.
  AlignedVector<float> inverse_distance;  ///< NaN in the rim and where there is no surface.
  AlignedVector<uint32_t> bits;           ///< 0 in the rim.

  void Resize(int new_width, int new_height);
  std::ptrdiff_t Index(int x, int y) const { return (y + kRimRows) * stride + x + kRimColumns; }
  /// To the neighbours on the left, on the right, below and above.
  std::array<std::ptrdiff_t, 4> NeighbourSteps() const { return {-1, 1, -stride, stride}; }
  bool Visible(std::ptrdiff_t i) const {
    const float distance = inverse_distance[static_cast<size_t>(i)];
    return distance == distance;
  }
};

/// One bit a pixel of the planes, rim included: bit i % 8 of byte i / 8 belongs to index i.
struct PackedBits {
  int width = 0;
  int height = 0;
  std::ptrdiff_t stride = 0;
  std::vector<uint8_t> bytes;
};

/// How much inverse distance may bend, as a second difference, on one surface: a share of its value (on
/// planes under perspective the second difference is zero) plus a constant (orthographic).
struct BendTolerance {
  float relative = 0.0f;
  float absolute = 0.0f;
};

struct VisibleDepths {
  int count = 0;
  float smallest = std::numeric_limits<float>::infinity();
  float largest = -std::numeric_limits<float>::infinity();
};

/// Fills the planes' depths; those that are NaN, infinite, the background's or outside [0,1] have no surface.
VisibleDepths ScanDepth(const DepthView& depth, const InverseDistanceLaw& law, PixelPlanes* planes);

/// Fills `planes->bits` with those of `bits` that are in `lights`.
void CopyBits(const BitsView& bits, uint32_t lights, PixelPlanes* planes);

/// Where there is a surface.
void PackVisible(const PixelPlanes& planes, PackedBits* packed);

/// One light's bits.
void PackLight(const PixelPlanes& planes, uint32_t light_bit, PackedBits* packed);

}  // namespace shadowfit
