#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "core/frame/images.h"

namespace shadowfit {

// The two passes over all pixels of a frame, vectorised with run-time dispatch (Highway). Neither sums, so
// that their results are the same on every machine.

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

/// Rows are padded by what the widest vector may touch beyond their end.
inline constexpr int kMostLanes = 16;

/// A frame's pixels with a rim of one pixel on every side, so that neighbours need no bounds check.
struct PixelPlanes {
  int width = 0;
  int height = 0;
  std::ptrdiff_t stride = 0;
  std::vector<float> inverse_distance;  ///< NaN in the rim and where there is no surface.
  std::vector<uint32_t> bits;           ///< 0 in the rim.

  void Resize(int new_width, int new_height);
  std::ptrdiff_t Index(int x, int y) const { return (y + 1) * stride + x + 1; }
  bool Visible(std::ptrdiff_t i) const { return At(i) == At(i); }
  float At(std::ptrdiff_t i) const { return inverse_distance[static_cast<size_t>(i)]; }
  uint32_t Bits(std::ptrdiff_t i) const { return bits[static_cast<size_t>(i)]; }
};

/// How much inverse distance may bend, as a second difference, on one surface: a share of its value (on
/// planes under perspective the second difference is zero) plus a constant (orthographic).
struct BendTolerance {
  float relative = 0.0f;
  float absolute = 0.0f;
  float At(float inverse_distance) const { return relative * inverse_distance + absolute; }
};

struct VisibleDepths {
  int count = 0;
  float smallest = std::numeric_limits<float>::infinity();
  float largest = -std::numeric_limits<float>::infinity();
};

/// Fills `planes->inverse_distance`; depths that are NaN, infinite, the background's or outside [0,1] have no
/// surface.
VisibleDepths ScanDepth(const DepthView& depth, const InverseDistanceLaw& law, PixelPlanes* planes);

/// Fills `planes->bits` with those of `bits` that are in `lights`.
void CopyBits(const BitsView& bits, uint32_t lights, PixelPlanes* planes);

/// Indices (PixelPlanes::Index) of the visible pixels that may touch a shadow's boundary: whose bits differ
/// from a neighbour's, or that are shadowed beside a bend, row by row. Most pixels are inside a lit or a
/// shadowed region, and are settled here. The answer lies in `scratch`.
std::span<const int32_t> FindBoundaryCandidates(const PixelPlanes& planes, const BendTolerance& tolerance,
                                                std::vector<int32_t>* scratch);

}  // namespace shadowfit
