#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
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

/// One bit a pixel, rows of bytes, with a border of zeros.
class PackedBits {
 public:
  /// Clears where the size is another.
  void Resize(int width, int height);
  /// Where the row's pixel 0 begins: whole bytes, the lowest bit first. Up to kMostLanes - 1 pixels beyond
  /// its end may be written, with zeros.
  uint8_t* Row(int y) { return bytes_.data() + Offset(y) + kBorder; }
  /// The 5x5 bits around a pixel: bit 5 row + column.
  uint32_t Around(int x, int y) const {
    uint32_t window = 0;
    for (int row = 0; row < 5; ++row) {
      const auto first = static_cast<size_t>(x + 8 * kBorder - 2);
      uint32_t bits;
      std::memcpy(&bits, bytes_.data() + Offset(y + row - 2) + first / 8, sizeof(bits));
      window |= (bits >> first % 8 & 31u) << (5 * row);
    }
    return window;
  }

 private:
  static constexpr int kBorder = 1;      // Bytes before a row, ...
  static constexpr int kBorderRows = 2;  // ... rows below and above.
  size_t Offset(int y) const { return static_cast<size_t>(y + kBorderRows) * stride_; }

  int width_ = 0;
  int height_ = 0;
  size_t stride_ = 0;
  std::vector<uint8_t> bytes_;
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

/// Where there is a surface.
void PackVisible(const PixelPlanes& planes, PackedBits* packed);

/// One light's bits.
void PackLight(const PixelPlanes& planes, uint32_t light_bit, PackedBits* packed);

/// Indices (PixelPlanes::Index) of the visible pixels that may touch a shadow's boundary: whose bits differ
/// from a neighbour's, or that are shadowed beside a bend, row by row. Most pixels are inside a lit or a
/// shadowed region, and are settled here. The answer lies in `scratch`.
std::span<const int32_t> FindBoundaryCandidates(const PixelPlanes& planes, const BendTolerance& tolerance,
                                                std::vector<int32_t>* scratch);

}  // namespace shadowfit
