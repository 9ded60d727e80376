#include "core/resolution/tile_placement.h"

#include <algorithm>
#include <cmath>

namespace shadowfit::resolution {
namespace {

// Half a unit in the last place of a float, relative.
constexpr double kFloatError = 0x1p-24;
// Rounding errors that a local coordinate of the float kernel gathers, in units of kFloatError times the sum
// of its terms' sizes: coefficient 1, products and sums 5, local depth 1, mean of four depths 3; 12 with
// room.
constexpr double kRoundings = 12.0;
// The same of its reciprocal, relative: the estimate's 4.25, products 2, with room.
constexpr double kReciprocalRoundings = 8.0;
// In float, pixels beyond the edge of the light's volume by less than this (in clip coordinates) are let in:
// what float sees is a superset of the truth, so its minimum is a lower bound.
constexpr double kVolumeMargin = 1e-5;
// Exact bounds this near to the edge of the volume are at the edge.
constexpr double kEdgeSnap = 1e-12;

double SizeOfTerms(const double* row, const glm::dvec3& reach) {
  return std::abs(row[0]) * reach.x + std::abs(row[1]) * reach.y + std::abs(row[2]) * reach.z +
         std::abs(row[3]);
}

/// Bounds of (X, Y, 1)^T form (X, Y, 1) over a rectangle, by its expansion about the middle.
void BoundForm(const glm::dmat3& form, const glm::dvec2& low, const glm::dvec2& high, double* least,
               double* most) {
  const glm::dvec3 middle(0.5 * (low + high), 1.0);
  const glm::dvec2 half = 0.5 * (high - low);
  const glm::dvec3 product = form * middle;
  const double reach = 2.0 * (std::abs(product.x) * half.x + std::abs(product.y) * half.y) +
                       std::abs(form[0][0]) * half.x * half.x + std::abs(form[1][1]) * half.y * half.y +
                       2.0 * std::abs(form[0][1]) * half.x * half.y;
  *least = glm::dot(middle, product) - reach;
  *most = glm::dot(middle, product) + reach;
}

}  // namespace

double PlacedMap::FloatError(int axis, double reach) const {
  const double size = axis == 0 ? x_size : y_size;
  return kFloatError * (kRoundings * (size + reach * w_size) / least_w + kReciprocalRoundings * reach);
}

DepthBounds BoundsOf(const TileBlocks& blocks) {
  DepthBounds range;
  for (int block = 0; block < kBlocks; ++block) {
    if (blocks.samples[block] == 0) continue;
    range.least = std::min(range.least, double{blocks.least[block]});
    range.most = std::max(range.most, double{blocks.most[block]});
  }
  return range;
}

TilePlacer::TilePlacer(const Tile& tile, const DepthBounds& range)
    : reference_(-1.0 + (2.0 * tile.x0 + tile.width) / tile.depth.width,
                 -1.0 + (2.0 * tile.y0 + tile.height) / tile.depth.height, tile.reference_depth, 1.0),
      step_(2.0 / tile.depth.width, 2.0 / tile.depth.height),
      half_(0.5 * tile.width, 0.5 * tile.height),
      low_depth_(range.least - tile.reference_depth),
      high_depth_(range.most - tile.reference_depth) {}

PlacedMap TilePlacer::Place(const PlannedMap& planned, bool in_double) const {
  PlacedMap placed;
  TileMap& local = placed.map;
  ToLocal(planned.x, local.x);
  ToLocal(planned.y, local.y);
  ToLocal(planned.w, local.w);
  ToLocal(planned.along, local.along);

  // 1. The tile's part of the view frustum is a box in local coordinates, at whose corners linear forms are
  // extreme; so are the quotients, and what holds at the corners of something convex holds inside.
  const double middle_depth = 0.5 * (low_depth_ + high_depth_);
  const double half_depth = 0.5 * (high_depth_ - low_depth_);
  const auto middle = [&](const double* row) { return row[2] * middle_depth + row[3]; };
  const auto reach_of = [&](double x, double y, double z) {
    return std::abs(x) * half_.x + std::abs(y) * half_.y + std::abs(z) * half_depth;
  };
  const double w_middle = middle(local.w);
  const double w_reach = reach_of(local.w[0], local.w[1], local.w[2]);
  double least_w = w_middle - w_reach;
  const double most_w = w_middle + w_reach;
  if (!(most_w > 0.0)) return placed;
  bool square_holds_all = true;
  if (planned.map.bounded) {
    for (const double* row : {local.x, local.y}) {
      for (const double sign : {-1.0, 1.0}) {  // 0 <= w -+ x
        const double inside = w_middle + sign * middle(row);
        const double reach =
            reach_of(local.w[0] + sign * row[0], local.w[1] + sign * row[1], local.w[2] + sign * row[2]);
        if (inside + reach < 0.0) return placed;
        square_holds_all = square_holds_all && inside - reach > 1e-9 * most_w;
      }
    }
  }
  bool cone_holds_all = planned.cone;
  for (int corner = 0; corner < 8; ++corner) {
    const double lx = (corner & 1) != 0 ? half_.x : -half_.x;
    const double ly = (corner & 2) != 0 ? half_.y : -half_.y;
    const double lz = (corner & 4) != 0 ? high_depth_ : low_depth_;
    const auto at = [&](const double* row) { return row[0] * lx + row[1] * ly + row[2] * lz + row[3]; };
    const glm::dvec3 p(at(local.x), at(local.y), at(local.w));
    cone_holds_all =
        cone_holds_all && glm::dot(p, planned.cone_form * p) > 0.0 && glm::dot(planned.cone_axis, p) > 0.0;
    if (!(p.z > 0.0)) continue;
    const double by_w = 1.0 / p.z;
    placed.hull_low = glm::min(placed.hull_low, glm::dvec2(p) * by_w);
    placed.hull_high = glm::max(placed.hull_high, glm::dvec2(p) * by_w);
    placed.least_along = std::min(placed.least_along, at(local.along) * by_w);
    placed.most_along = std::max(placed.most_along, at(local.along) * by_w);
  }
  local.in_square =
      planned.map.bounded && !planned.map.inscribed_cone && !(least_w > 0.0 && square_holds_all);
  local.in_cone = planned.cone && !(least_w > 0.0 && cone_holds_all);
  placed.before_light = least_w > 0.0;

  // 2. Picture coordinates relative to those of the reference point, and w relative to its w.
  if (local.w[3] > 0.0) placed.origin = {local.x[3] / local.w[3], local.y[3] / local.w[3]};
  const double scale = 1.0 / (local.w[3] > 0.0 ? local.w[3] : most_w);
  for (int i = 0; i < 4; ++i) {
    local.x[i] = (local.x[i] - placed.origin.x * local.w[i]) * scale;
    local.y[i] = (local.y[i] - placed.origin.y * local.w[i]) * scale;
    local.w[i] *= scale;
    local.along[i] *= scale;
  }
  least_w *= scale;

  // 3. Can float do it?
  const glm::dvec3 reach(half_, std::max(std::abs(low_depth_), std::abs(high_depth_)));
  placed.least_w = least_w;
  placed.x_size = SizeOfTerms(local.x, reach);
  placed.y_size = SizeOfTerms(local.y, reach);
  placed.w_size = SizeOfTerms(local.w, reach);
  // How large a local coordinate inside the volume can be. (With some of the tile behind the light, float
  // is out of the question, and so the hull is whole where it is looked at.)
  glm::dvec2 widest;
  bool float_serves = least_w > 0.0;
  for (int axis = 0; axis < 2; ++axis) {
    const double origin = placed.origin[axis];
    widest[axis] = std::max(origin - placed.hull_low[axis], placed.hull_high[axis] - origin);
    if (!planned.map.bounded) continue;
    widest[axis] = std::min(widest[axis], 1.0 + std::abs(origin));
    float_serves = float_serves && placed.FloatError(axis, widest[axis]) < 0.25 * kVolumeMargin;
  }
  in_double = in_double || !float_serves;
  placed.where = in_double ? PlacedMap::Where::kInDouble : PlacedMap::Where::kInFloat;

  // 4. The light's volume in local coordinates: p = T p', where T adds the origin.
  const double margin = in_double ? 0.0 : kVolumeMargin;
  for (int axis = 0; axis < 2; ++axis) {
    local.square_low[axis] = -1.0 - margin - placed.origin[axis];
    local.square_high[axis] = 1.0 + margin - placed.origin[axis];
  }
  if (local.in_cone) {
    const glm::dmat3 shift(glm::dvec3(1, 0, 0), glm::dvec3(0, 1, 0), glm::dvec3(placed.origin, 1));
    const glm::dmat3 form = glm::transpose(shift) * planned.cone_form * shift;
    const glm::dvec3 axis = glm::transpose(shift) * planned.cone_axis;
    const double terms[6] = {form[0][0],       2.0 * form[0][1], form[1][1],
                             2.0 * form[0][2], 2.0 * form[1][2], form[2][2]};
    const double x = widest.x;
    const double y = widest.y;
    const double sizes[6] = {x * x, x * y, y * y, x, y, 1.0};
    double rounding = 0.0;
    for (int i = 0; i < 6; ++i) {
      local.cone[i] = terms[i];
      rounding += kRoundings * kFloatError * std::abs(terms[i]) * sizes[i];
    }
    // Coordinates that are wrong by the margin, and the rounding of the form's own terms, change it by no
    // more.
    const double slope = 2.0 * std::abs(terms[0]) * x + std::abs(terms[1]) * (x + y) +
                         2.0 * std::abs(terms[2]) * y + std::abs(terms[3]) + std::abs(terms[4]);
    if (!in_double) local.cone[5] += 1.5 * margin * slope + rounding;
    for (int i = 0; i < 3; ++i) local.cone_axis[i] = axis[i];
  }
  return placed;
}

void TilePlacer::ToLocal(const glm::dvec4& row, double* local) const {
  local[0] = row.x * step_.x;
  local[1] = row.y * step_.y;
  local[2] = row.z;
  local[3] = glm::dot(row, reference_);
}

void PlaceBlocks(const PlannedMap& planned, const PlacedMap& placed, const Tile& tile,
                 const TileBlocks& common, PlacedBlocks* blocks) {
  PatchBounds patches;
  BoundPatches(tile, common, placed.map, &patches);
  *blocks = {};
  for (int block = 0; block < kBlocks; ++block) {
    if (common.samples[block] == 0) continue;
    Extremes& bounds = blocks->bounds[block];
    for (int axis = 0; axis < 2; ++axis) {
      const double low = placed.origin[axis] + patches.low[axis][block];
      const double high = placed.origin[axis] + patches.high[axis][block];
      const double rounding =
          1e-12 * (std::abs(placed.origin[axis]) + std::max(std::abs(low), std::abs(high)));
      bounds.low[axis] = std::max(placed.hull_low[axis], low) - rounding;
      bounds.high[axis] = std::min(placed.hull_high[axis], high) + rounding;
      bounds.smallest[axis] = patches.smallest[axis][block];
    }
    const BlockMask bit = BlockMask{1} << block;
    bool inside = true;
    bool outside = false;
    constexpr double kMargin = 1e-9;
    if (placed.map.in_square) {
      inside = glm::all(glm::greaterThan(bounds.low, glm::dvec2(kMargin - 1.0))) &&
               glm::all(glm::lessThan(bounds.high, glm::dvec2(1.0 - kMargin)));
      outside = glm::any(glm::lessThan(bounds.high, glm::dvec2(-1.0 - kMargin))) ||
                glm::any(glm::greaterThan(bounds.low, glm::dvec2(1.0 + kMargin)));
    }
    if (placed.map.in_cone) {
      double least;
      double most;
      BoundForm(planned.cone_form, bounds.low, bounds.high, &least, &most);
      const glm::dvec3& axis = planned.cone_axis;
      const glm::dvec2 middle = 0.5 * (bounds.low + bounds.high);
      const glm::dvec2 half = 0.5 * (bounds.high - bounds.low);
      const double ahead = axis.x * middle.x + axis.y * middle.y + axis.z;
      const double reach = std::abs(axis.x) * half.x + std::abs(axis.y) * half.y;
      const double margin = kMargin * (std::abs(most) + std::abs(least) + 1.0);
      inside = inside && least > margin && ahead - reach > margin;
      outside = outside || most < -margin || ahead + reach < -margin;
    }
    if (outside) continue;
    if (planned.map.bounded) {
      bounds.low = glm::max(bounds.low, glm::dvec2(-1.0));
      bounds.high = glm::min(bounds.high, glm::dvec2(1.0));
    }
    (inside ? blocks->inside : blocks->edge) |= bit;
  }
}

Extremes BoundsFrom(const PlannedMap& planned, const PlacedMap& placed, const TileExtent& extent,
                    bool in_double) {
  Extremes bounds;
  if (extent.pixels == 0) return bounds;
  for (int axis = 0; axis < 2; ++axis) {
    double error = 0.0;
    if (in_double) {
      bounds.low[axis] = placed.origin[axis] + extent.min[axis];
      bounds.high[axis] = placed.origin[axis] + extent.max[axis];
    } else if (placed.map.in_square || placed.map.in_cone) {
      error = placed.FloatError(axis, std::max(std::abs(extent.min[axis]), std::abs(extent.max[axis])));
      bounds.low[axis] = placed.origin[axis] + extent.min[axis] - error;
      bounds.high[axis] = placed.origin[axis] + extent.max[axis] + error;
    } else {
      const double low = placed.hull_low[axis];
      const double high = placed.hull_high[axis];
      error = placed.FloatError(axis, std::max(placed.origin[axis] - low, high - placed.origin[axis]));
      const double rounding = 1e-12 * std::max(std::abs(low), std::abs(high));
      bounds.low[axis] = low - rounding;
      bounds.high[axis] = high + rounding;
    }
    bounds.smallest[axis] =
        std::max(0.0, extent.smallest[axis] * (1.0 - 2.0 * kFloatError * (error > 0.0)) - 2.0 * error);
    if (!(bounds.smallest[axis] >= 0.0)) bounds.smallest[axis] = 0.0;
    if (planned.map.bounded) {
      if (bounds.low[axis] < -1.0 + kEdgeSnap) bounds.low[axis] = -1.0;
      if (bounds.high[axis] > 1.0 - kEdgeSnap) bounds.high[axis] = 1.0;
    }
  }
  return bounds;
}

}  // namespace shadowfit::resolution
