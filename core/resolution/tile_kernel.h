#pragma once

#include <cstdint>

#include "core/frame/images.h"

namespace shadowfit::resolution {

/// A tile's pixels share one local coordinate system, small enough that float arithmetic in it is accurate.
inline constexpr int kTileWidth = 128;
inline constexpr int kTileHeight = 16;

/// Bins of the histograms of pixel box sizes: 32 an octave, by the leading bits of a positive float.
inline constexpr int kHistogramShift = 18;
inline constexpr int kHistogramBins = 1 << 13;

/// Which of the picture a tile is, and which depths count.
struct Tile {
  DepthView depth;
  int x0 = 0, y0 = 0;            ///< First pixel.
  int width = 0, height = 0;     ///< At most kTileWidth x kTileHeight.
  float lowest = 0.0F;           ///< A pixel is a sample where lowest <= depth <= highest.
  float highest = 1.0F;          ///< NaN compares false and so is none.
  float reference_depth = 0.0F;  ///< Origin of local depth.
};

/// Extremes of the depths of a tile's samples and of the pixels around it, which its corners average in;
/// least > most where there is none.
struct DepthExtremes {
  float least = 1.0F;
  float most = 0.0F;
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
  double min[2];  ///< Bounds of the boxes and of the centres.
  double max[2];
  double smallest[2];  ///< Least width and least height of a box.
  double least_along;  ///< Of the centres' along/w. In double precision alone.
  double most_along;
  int64_t pixels = 0;
};

DepthExtremes FindDepthExtremes(const Tile& tile);

/// Reduces one tile for `count` maps. Corner depths are the mean of the samples among the four pixels around
/// the corner; beyond the picture's border a pixel is extrapolated linearly from the two inside, which is
/// exact on planes. The two versions are the same source: one in float, one in double.
void ReduceTileInFloat(const Tile& tile, const TileMap* maps, int count, TileExtent* extents);
void ReduceTileInDouble(const Tile& tile, const TileMap* maps, int count, TileExtent* extents);

}  // namespace shadowfit::resolution
