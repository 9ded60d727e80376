#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <limits>

#include "core/resolution/light_maps.h"
#include "core/resolution/tile_blocks.h"
#include "core/resolution/tile_kernel.h"

/// Maps as the tiles of a depth buffer see them: which tiles and blocks a light's volume holds, in which
/// arithmetic a tile can be reduced, and what bounds follow. Internal to resolution.h.
namespace shadowfit::resolution {

inline constexpr double kUnbounded = std::numeric_limits<double>::infinity();

/// A map of a light, ready to be placed in any tile.
struct PlannedMap {
  LightMap map;
  // Homogeneous picture coordinates of (NDC x, NDC y, window depth, 1).
  glm::dvec4 x, y, w;
  // Homogeneous along-ray coordinate of the same; divided by w it is what DepthRange bounds.
  glm::dvec4 along;
  bool cone = false;
  glm::dmat3 cone_form{0.0};  // Inside where p^T form p >= 0 ...
  glm::dvec3 cone_axis{0.0};  // ... and axis . p > 0, p = (x w, y w, w).
};

/// Bounds and least width and height of boxes.
struct Extremes {
  glm::dvec2 low{kUnbounded};
  glm::dvec2 high{-kUnbounded};
  glm::dvec2 smallest{kUnbounded};

  void Add(const Extremes& other) {
    low = glm::min(low, other.low);
    high = glm::max(high, other.high);
    smallest = glm::min(smallest, other.smallest);
  }
  /// Whether what has these extremes may add anything.
  bool MayExtend(const Extremes& known) const {
    return low.x < known.low.x || low.y < known.low.y || high.x > known.high.x || high.y > known.high.y ||
           smallest.x < known.smallest.x || smallest.y < known.smallest.y;
  }
};

using BlockMask = uint32_t;
static_assert(kBlocks <= 32);

/// A map as one tile sees it.
struct PlacedMap {
  enum class Where { kOutside, kInFloat, kInDouble } where = Where::kOutside;
  TileMap map;
  glm::dvec2 origin{0.0};  // Picture coordinates of the tile's reference point.
  // Picture coordinates of the tile's part of the frustum, where all of it lies before the light.
  glm::dvec2 hull_low{kUnbounded};
  glm::dvec2 hull_high{-kUnbounded};
  // For the error of the float kernel: least w, and the sums of the sizes of each row's terms.
  bool before_light = false;  // All of the tile.
  double least_w = 0.0;
  double x_size = 0.0, y_size = 0.0, w_size = 0.0;
  double least_along = kUnbounded;  // Over the tile's part of the frustum, where it lies before the light.
  double most_along = -kUnbounded;

  /// Bound on the error of a float picture coordinate of size up to `reach` relative to the origin.
  double FloatError(int axis, double reach) const;
};

/// Window depths of a tile's samples and of their pixels' corners; least > most without any.
struct DepthBounds {
  double least = 2.0;
  double most = -1.0;
};

DepthBounds BoundsOf(const TileBlocks& blocks);

/// Places maps in one tile.
class TilePlacer {
 public:
  TilePlacer(const Tile& tile, const DepthBounds& range);

  /// `in_double` asks for double precision where float would serve, too.
  PlacedMap Place(const PlannedMap& planned, bool in_double) const;

 private:
  void ToLocal(const glm::dvec4& row, double* local) const;

  glm::dvec4 reference_;
  glm::dvec2 step_;
  glm::dvec2 half_;
  double low_depth_;
  double high_depth_;
};

/// How the blocks of a tile lie to a map. Those without samples are in no mask.
struct PlacedBlocks {
  BlockMask inside = 0;      // The light's volume holds them wholly.
  BlockMask edge = 0;        // It may hold some of their pixels.
  Extremes bounds[kBlocks];  // By what a block's pixels have in common.
};

/// By what the pixels of each block have in common.
void PlaceBlocks(const PlannedMap& planned, const PlacedMap& placed, const Tile& tile,
                 const TileBlocks& common, PlacedBlocks* blocks);

/// Turns what the kernel found into bounds that hold for certain.
Extremes BoundsFrom(const PlannedMap& planned, const PlacedMap& placed, const TileExtent& extent,
                    bool in_double);

}  // namespace shadowfit::resolution
