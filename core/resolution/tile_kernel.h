#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>

#include "core/frame/images.h"

namespace shadowfit::resolution {

/// A tile's pixels share one local coordinate system, small enough that float arithmetic in it is accurate.
inline constexpr int kTileWidth = 256;
inline constexpr int kTileHeight = 8;

/// No vector of floats is wider.
inline constexpr int kColumnStep = 32;

/// Bins of the histograms of pixel box sizes: 32 an octave, by the leading bits of a positive float.
inline constexpr int kHistogramShift = 18;
inline constexpr int kHistogramBins = 1 << 13;

/// Which of the picture a tile is, and which depths count.
struct Tile {
  DepthView depth;
  int x0 = 0, y0 = 0;            ///< First pixel.
  int width = 0, height = 0;     ///< At most kTileWidth x kTileHeight.
  int begin = 0, end = 0;        ///< Columns to look at; `begin` is a multiple of kColumnStep.
  float lowest = 0.0F;           ///< A pixel is a sample where lowest <= depth <= highest.
  float highest = 1.0F;          ///< NaN compares false and so is none.
  float reference_depth = 0.0F;  ///< Origin of local depth; best near the samples' own.
};

/// Room for one more pixel on every side of a tile, and for whole vectors beyond the last.
inline constexpr int kTileStride = kTileWidth + 64;

/// A tile's depth relative to its reference depth, in the columns to look at, shared by all maps. T is float
/// or double.
template <typename T>
struct TileDepths {
  /// Row j, column i is pixel (i - 1, j - 1) of the tile; NaN where there is no sample. Beyond the picture's
  /// border a pixel is extrapolated linearly from the two inside, which is exact on planes.
  alignas(128) T pixels[(kTileHeight + 2) * kTileStride];
  /// Row j, column i is the lower left corner of pixel (i, j): the mean of the samples among the four around
  /// it.
  alignas(128) T corners[(kTileHeight + 1) * kTileStride];
};

/// One light map's projection in a tile's local coordinates: lx, ly in pixels from the tile's centre, lz =
/// window depth - reference_depth. Each row (c0, c1, c2, c3) means c0 lx + c1 ly + c2 lz + c3. The picture
/// coordinates x/w and y/w are relative to a reference point of the tile; differences between them are all
/// that box sizes need.
struct TileMap {
  double x[4], y[4], w[4];
  double along[4];  ///< Along-ray coordinate times w of the same scale; read in double precision alone.
  bool in_square = false;  ///< Take only centres with square_low <= (x/w, y/w) <= square_high.
  double square_low[2], square_high[2];
  bool in_cone =
      false;  ///< Take only centres (X, Y) = (x/w, y/w) with c0 X^2 + c1 XY + c2 Y^2 + c3 X + c4 Y + c5 >= 0.
  double cone[6];
  double
      cone_axis[3];  ///< And, in double precision alone, with a0 X + a1 Y + a2 > 0: not the opposite nappe.
  uint32_t* histogram_x = nullptr;  ///< kHistogramBins counters of box widths, or none.
  uint32_t* histogram_y = nullptr;  ///< The same of box heights.
};

/// What a tile's participating pixels reduce to for one map. A pixel takes part where it is a sample, its
/// centre is inside, and all four corners have w > 0. Its box is the bounding box of the corners in picture
/// coordinates. The infinities stand where no pixel takes part.
struct TileExtent {
  static constexpr double kInfinity = std::numeric_limits<double>::infinity();
  /// Bounds of the boxes and of the centres. In float, infinite where the map asks for neither square nor
  /// cone: the tile is inside as a whole.
  double min[2] = {kInfinity, kInfinity};
  double max[2] = {-kInfinity, -kInfinity};
  double smallest[2] = {kInfinity, kInfinity};  ///< Least width and least height of a box.
  double least_along = kInfinity;               ///< Of the centres' along/w. In double precision alone.
  double most_along = -kInfinity;
  int64_t pixels = 0;

  void Add(const TileExtent& other) {
    for (int axis = 0; axis < 2; ++axis) {
      min[axis] = std::min(min[axis], other.min[axis]);
      max[axis] = std::max(max[axis], other.max[axis]);
      smallest[axis] = std::min(smallest[axis], other.smallest[axis]);
    }
    least_along = std::min(least_along, other.least_along);
    most_along = std::max(most_along, other.most_along);
    pixels += other.pixels;
  }
};

void PrepareTile(const Tile& tile, TileDepths<float>* depths);
void PrepareTile(const Tile& tile, TileDepths<double>* depths);

/// Reduces one tile for one map. The two versions are the same source.
void ReduceTile(const Tile& tile, const TileDepths<float>& depths, const TileMap& map, TileExtent* extent);
void ReduceTile(const Tile& tile, const TileDepths<double>& depths, const TileMap& map, TileExtent* extent);

}  // namespace shadowfit::resolution
