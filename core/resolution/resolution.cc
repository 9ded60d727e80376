#include "core/resolution/resolution.h"

#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <bit>
#include <chrono>
#include <cmath>
#include <limits>
#include <set>

#include "absl/strings/str_format.h"
#include "core/resolution/light_maps.h"
#include "core/resolution/tile_kernel.h"

namespace shadowfit {
namespace {

using resolution::LightMap;
using resolution::Tile;
using resolution::TileDepths;
using resolution::TileExtent;
using resolution::TileMap;

constexpr double kInfinity = std::numeric_limits<double>::infinity();

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

/// What one tile has to say to one map. Certain once settled; until then, outer bounds.
struct TileBound {
  bool empty = true;
  bool settled = false;
  glm::dvec2 low{kInfinity};
  glm::dvec2 high{-kInfinity};
  glm::dvec2 smallest{kInfinity};
  int64_t pixels = 0;
  double least_along = kInfinity;
  double most_along = -kInfinity;
};

/// The part of the window depths that belongs to samples: in [0,1], without the background's value.
void SetSampleRange(ClipDepth convention, Tile* tile) {
  tile->lowest = convention == ClipDepth::kReversedZeroToOne ? std::nextafter(0.0F, 1.0F) : 0.0F;
  tile->highest = convention == ClipDepth::kReversedZeroToOne ? 1.0F : std::nextafter(1.0F, 0.0F);
}

/// A map as one tile sees it.
struct PlacedMap {
  enum class Where { kOutside, kInFloat, kInDouble } where = Where::kOutside;
  TileMap map;
  glm::dvec2 origin{0.0};  // Picture coordinates of the tile's reference point.
  // Picture coordinates of the tile's part of the frustum, where all of it lies before the light.
  glm::dvec2 hull_low{kInfinity};
  glm::dvec2 hull_high{-kInfinity};
  // For the error of the float kernel: least w, and the sums of the sizes of each row's terms.
  double least_w = 0.0;
  double x_size = 0.0, y_size = 0.0, w_size = 0.0;
  double least_along = kInfinity;  // Over the tile's part of the frustum, where it lies before the light.
  double most_along = -kInfinity;

  /// Bound on the error of a float picture coordinate of size up to `reach` relative to the origin.
  double FloatError(int axis, double reach) const {
    const double size = axis == 0 ? x_size : y_size;
    return kFloatError * (kRoundings * (size + reach * w_size) / least_w + kReciprocalRoundings * reach);
  }
};

double SizeOfTerms(const double* row, const glm::dvec3& reach) {
  return std::abs(row[0]) * reach.x + std::abs(row[1]) * reach.y + std::abs(row[2]) * reach.z +
         std::abs(row[3]);
}

class TilePlacer {
 public:
  /// `least` and `most` bound the local depths of the tile's samples and of their neighbours.
  TilePlacer(const Tile& tile, double least, double most)
      : reference_(-1.0 + (2.0 * tile.x0 + tile.width) / tile.depth.width,
                   -1.0 + (2.0 * tile.y0 + tile.height) / tile.depth.height, tile.reference_depth, 1.0),
        step_(2.0 / tile.depth.width, 2.0 / tile.depth.height),
        half_(0.5 * tile.width, 0.5 * tile.height),
        low_depth_(least),
        high_depth_(most) {
    // At the picture's border, corners average extrapolated depths: beyond the extremes by up to one and a
    // half times the range.
    if (tile.x0 == 0 || tile.y0 == 0 || tile.x0 + tile.width == tile.depth.width ||
        tile.y0 + tile.height == tile.depth.height) {
      low_depth_ = std::max(0.0 - tile.reference_depth, least - 1.5 * (most - least));
      high_depth_ = std::min(1.0 - tile.reference_depth, most + 1.5 * (most - least));
    }
  }

  PlacedMap Place(const PlannedMap& planned, bool in_double) const {
    PlacedMap placed;
    TileMap& local = placed.map;
    ToLocal(planned.x, local.x);
    ToLocal(planned.y, local.y);
    ToLocal(planned.w, local.w);
    ToLocal(planned.along, local.along);

    // 1. The tile's part of the view frustum is the hull of eight points, and everything asked of it is
    // linear or convex: what holds at the points holds inside.
    double least_w = kInfinity;
    double least_inside[4] = {kInfinity, kInfinity, kInfinity, kInfinity};
    double most_inside[4] = {-kInfinity, -kInfinity, -kInfinity, -kInfinity};
    double most_w = -kInfinity;
    bool cone_holds_all = true;
    for (int corner = 0; corner < 8; ++corner) {
      const double lx = (corner & 1) != 0 ? half_.x : -half_.x;
      const double ly = (corner & 2) != 0 ? half_.y : -half_.y;
      const double lz = (corner & 4) != 0 ? high_depth_ : low_depth_;
      const auto at = [&](const double* row) { return row[0] * lx + row[1] * ly + row[2] * lz + row[3]; };
      const glm::dvec3 p(at(local.x), at(local.y), at(local.w));
      least_w = std::min(least_w, p.z);
      most_w = std::max(most_w, p.z);
      const double inside[4] = {p.z - p.x, p.z + p.x, p.z - p.y, p.z + p.y};
      for (int i = 0; i < 4; ++i) {
        least_inside[i] = std::min(least_inside[i], inside[i]);
        most_inside[i] = std::max(most_inside[i], inside[i]);
      }
      if (planned.cone) {
        cone_holds_all = cone_holds_all && glm::dot(p, planned.cone_form * p) > 0.0 &&
                         glm::dot(planned.cone_axis, p) > 0.0;
      }
      if (p.z > 0.0) {
        placed.hull_low = glm::min(placed.hull_low, glm::dvec2(p) / p.z);
        placed.hull_high = glm::max(placed.hull_high, glm::dvec2(p) / p.z);
        placed.least_along = std::min(placed.least_along, at(local.along) / p.z);
        placed.most_along = std::max(placed.most_along, at(local.along) / p.z);
      }
    }
    if (!(most_w > 0.0)) return placed;
    if (planned.map.bounded) {
      for (const double most : most_inside) {
        if (most < 0.0) return placed;
      }
    }
    local.in_square = planned.map.bounded && !planned.map.inscribed_cone &&
                      !(least_w > 0.0 && *std::min_element(least_inside, least_inside + 4) > 1e-9 * most_w);
    local.in_cone = planned.cone && !(least_w > 0.0 && cone_holds_all);

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

 private:
  void ToLocal(const glm::dvec4& row, double* local) const {
    local[0] = row.x * step_.x;
    local[1] = row.y * step_.y;
    local[2] = row.z;
    local[3] = glm::dot(row, reference_);
  }

  glm::dvec4 reference_;
  glm::dvec2 step_;
  glm::dvec2 half_;
  double low_depth_;
  double high_depth_;
};

/// Turns what the kernel found into bounds that hold for certain.
void SetBound(const PlannedMap& planned, const PlacedMap& placed, const TileExtent& extent, bool in_double,
              TileBound* bound) {
  *bound = {};
  bound->settled = in_double;
  bound->empty = extent.pixels == 0;
  if (bound->empty) return;
  bound->pixels = extent.pixels;
  bound->least_along = in_double ? extent.least_along : placed.least_along;
  bound->most_along = in_double ? extent.most_along : placed.most_along;
  for (int axis = 0; axis < 2; ++axis) {
    double error = 0.0;
    if (in_double) {
      bound->low[axis] = placed.origin[axis] + extent.min[axis];
      bound->high[axis] = placed.origin[axis] + extent.max[axis];
    } else if (placed.map.in_square || placed.map.in_cone) {
      error = placed.FloatError(axis, std::max(std::abs(extent.min[axis]), std::abs(extent.max[axis])));
      bound->low[axis] = placed.origin[axis] + extent.min[axis] - error;
      bound->high[axis] = placed.origin[axis] + extent.max[axis] + error;
    } else {
      const double low = placed.hull_low[axis];
      const double high = placed.hull_high[axis];
      error = placed.FloatError(axis, std::max(placed.origin[axis] - low, high - placed.origin[axis]));
      const double rounding = 1e-12 * std::max(std::abs(low), std::abs(high));
      bound->low[axis] = low - rounding;
      bound->high[axis] = high + rounding;
    }
    bound->smallest[axis] =
        std::max(0.0, extent.smallest[axis] * (1.0 - 2.0 * kFloatError * (error > 0.0)) - 2.0 * error);
    if (!(bound->smallest[axis] >= 0.0)) bound->smallest[axis] = 0.0;
    if (planned.map.bounded) {
      if (bound->low[axis] < -1.0 + kEdgeSnap) bound->low[axis] = -1.0;
      if (bound->high[axis] > 1.0 - kEdgeSnap) bound->high[axis] = 1.0;
    }
  }
}

/// For the few tiles that float cannot serve at all.
void ReduceInDouble(const Tile& tile, const TileMap& map, TileExtent* extent) {
  TileDepths<double> depths;
  resolution::PrepareTile(tile, &depths);
  resolution::ReduceTile(tile, depths, map, extent);
}

absl::Status CheckPictures(const ResolutionRequest& request) {
  const DepthView& depth = request.depth;
  if (depth.width < 1 || depth.width > kMaxDepthBufferSide || depth.height < 1 ||
      depth.height > kMaxDepthBufferSide) {
    return absl::InvalidArgumentError(absl::StrFormat("depth: size %dx%d is outside 1x1 to %dx%d",
                                                      depth.width, depth.height, kMaxDepthBufferSide,
                                                      kMaxDepthBufferSide));
  }
  if (depth.bottom_row == nullptr) return absl::InvalidArgumentError("depth: no data");
  const MapSize& screen = request.screen;
  if (screen == MapSize{}) return absl::OkStatus();
  if (screen.width < 1 || screen.width > kMaxResolution || screen.height < 1 ||
      screen.height > kMaxResolution) {
    return absl::InvalidArgumentError(absl::StrFormat("screen: size %dx%d is outside 1x1 to %dx%d",
                                                      screen.width, screen.height, kMaxResolution,
                                                      kMaxResolution));
  }
  return absl::OkStatus();
}

/// `scale` from the box of a depth pixel to that of a screen pixel, as a factor on needed texels.
double ScreenScale(const ResolutionRequest& request) {
  if (request.screen == MapSize{}) return 1.0;
  return std::max(double(request.screen.width) / request.depth.width,
                  double(request.screen.height) / request.depth.height);
}

double NeededTexels(double extent, double smallest, double scale) {
  if (!(extent > 0.0)) return 1.0;
  return std::min(kNeedCeiling, extent / smallest * scale);  // A box of no width needs infinitely many.
}

int LeastSize(SizeRounding rounding) { return rounding == SizeRounding::kMultipleOf8 ? 8 : 1; }

float BinFloor(int bin) {
  return std::bit_cast<float>(static_cast<uint32_t>(bin) << resolution::kHistogramShift);
}

/// The need that leaves no more than (100 - percentile) % of the pixels unsatisfied, at a bin's edge.
double PercentileNeed(const uint32_t* histogram, double percentile, double extent, double scale) {
  int64_t total = 0;
  for (int bin = 0; bin < resolution::kHistogramBins; ++bin) total += histogram[bin];
  const double spare = static_cast<double>(total) * (100.0 - percentile) / 100.0;
  int64_t left_out = 0;
  for (int bin = 0; bin < resolution::kHistogramBins; ++bin) {
    left_out += histogram[bin];
    if (static_cast<double>(left_out) > spare) return NeededTexels(extent, BinFloor(bin), scale);
  }
  return 1.0;
}

std::vector<ResolutionBin> Bins(const uint32_t* histogram, double extent, double scale) {
  std::vector<ResolutionBin> bins;
  for (int bin = resolution::kHistogramBins - 1; bin >= 0; --bin) {
    if (histogram[bin] == 0) continue;
    bins.push_back({.texels = NeededTexels(extent, BinFloor(bin), scale), .pixels = histogram[bin]});
  }
  return bins;
}

DepthRange RangeOf(const RaySpace& ray_space, double least_along, double most_along) {
  DepthRange range;
  if (ray_space.is_directional()) {
    // Widened a little, so that a flat receiver keeps a range at all.
    const double slack =
        1e-6 * std::max({most_along - least_along, std::abs(least_along), std::abs(most_along), 1e-30});
    range.near_q_over_w = least_along - slack;
    range.far_q_over_w = most_along + slack;
  } else {
    // The quotient is 1/w: largest at the near plane. A receiver right at the light would leave no precision
    // to the rest, so the near plane is no nearer than a thousandth of the far one; casters before it are
    // clamped.
    range.far_q_over_w = least_along * (1.0 - 1e-6);
    range.near_q_over_w = std::min(most_along, 1e3 * std::max(least_along, 1e-300)) * (1.0 + 1e-6);
  }
  return range;
}

}  // namespace

absl::Status Validate(const ResolutionOptions& options) {
  const int least = options.rounding == SizeRounding::kMultipleOf8 ? 8 : 1;
  if (options.max_size < least || options.max_size > kMaxResolution) {
    return absl::InvalidArgumentError(
        absl::StrFormat("max_size: %d is outside [%d, %d]", options.max_size, least, kMaxResolution));
  }
  if (!(options.percentile > 0.0 && options.percentile <= 100.0)) {
    return absl::InvalidArgumentError(
        absl::StrFormat("percentile: %g is outside (0, 100]", options.percentile));
  }
  return absl::OkStatus();
}

int RoundedSize(double needed, SizeRounding rounding, int max_size) {
  const double whole = std::ceil(needed - kTexelTolerance);
  const int size = whole >= max_size ? max_size : std::max(1, static_cast<int>(whole));
  switch (rounding) {
    case SizeRounding::kExact:
      return size;
    case SizeRounding::kMultipleOf8:
      return std::min((size + 7) / 8, max_size / 8) * 8;
    case SizeRounding::kPowerOfTwo:
      return static_cast<int>(std::min(std::bit_ceil(static_cast<unsigned>(size)),
                                       std::bit_floor(static_cast<unsigned>(max_size))));
  }
  return size;
}

struct ResolutionEstimator::Workspace {
  // One request.
  DepthView depth;
  ClipDepth convention = ClipDepth::kNegativeOneToOne;
  std::vector<RaySpace> ray_spaces;
  std::vector<int> first_map;  // Of each light, and one past the last.
  std::vector<PlannedMap> maps;
  bool histogram = false;

  int tiles_x = 0, tiles_y = 0;
  std::vector<TileBound> bounds;  // [map][tile]
  struct Item {
    int map;
    int tile;
  };
  std::vector<Item> to_settle;
  int settled = 0;
  tbb::enumerable_thread_specific<std::vector<uint32_t>> histograms;  // [map][axis][bin]
  std::vector<uint32_t> histogram_sum;

  int tile_count() const { return tiles_x * tiles_y; }
  TileBound& BoundOf(int map, int tile) {
    return bounds[static_cast<size_t>(map) * static_cast<size_t>(tile_count()) + static_cast<size_t>(tile)];
  }
  const uint32_t* HistogramOf(int map, int axis) const {
    return &histogram_sum[(static_cast<size_t>(map) * 2 + static_cast<size_t>(axis)) *
                          resolution::kHistogramBins];
  }

  absl::Status Plan(const ResolutionRequest& request);
  Tile MakeTile(int index) const;
  void ReduceTile(int index);
  void ReduceAll(const Cancellation& cancellation);
  void Settle(const Cancellation& cancellation);
  void SettleExtent(int map, const Cancellation& cancellation);
  glm::dvec2 SettleSmallest(int map, const glm::dvec2& extent, double scale, int max_size,
                            const Cancellation& cancellation);
  void MeetExtent(int map, bool settled_only, glm::dvec2* low, glm::dvec2* high);
};

absl::Status ResolutionEstimator::Workspace::Plan(const ResolutionRequest& request) {
  const absl::StatusOr<Camera> camera = Camera::Create(request.camera);
  if (!camera.ok())
    return absl::InvalidArgumentError(absl::StrFormat("camera.%s", camera.status().message()));
  depth = request.depth;
  convention = request.camera.clip_depth;
  ray_spaces.clear();
  first_map.assign(1, 0);
  maps.clear();

  // Window depth is an affine function of NDC depth. A camera's homogeneous w has one sign in its frustum;
  // make it +.
  const double depth_scale = NdcFromWindowDepth(convention, 1.0) - NdcFromWindowDepth(convention, 0.0);
  const double depth_offset = NdcFromWindowDepth(convention, 0.0);
  glm::dmat4 ws_from_window = camera->world_from_clip();
  ws_from_window[3] += ws_from_window[2] * depth_offset;
  ws_from_window[2] *= depth_scale;
  if (camera->WsFromNdc({0.0, 0.0, NearNdc(convention)}).w < 0.0) ws_from_window = -ws_from_window;

  if (request.lights.empty()) return absl::InvalidArgumentError("lights: empty, at least one is needed");
  std::set<uint32_t> ids;
  for (size_t i = 0; i < request.lights.size(); ++i) {
    const ResolutionLight& light = request.lights[i];
    if (!ids.insert(light.id).second) {
      return absl::InvalidArgumentError(absl::StrFormat("lights[%d].id: %d is not unique", i, light.id));
    }
    absl::StatusOr<RaySpace> ray_space = RaySpace::Create(light.light);
    if (!ray_space.ok()) {
      constexpr const char* kKinds[] = {"point", "spot", "directional"};  // In the order of the variant.
      return absl::InvalidArgumentError(
          absl::StrFormat("lights[%d].%s.%s", i, kKinds[light.light.index()], ray_space.status().message()));
    }
    const absl::StatusOr<std::vector<LightMap>> light_maps =
        resolution::MapsOfLight(light.light, *ray_space, *camera, light.clip_from_world);
    if (!light_maps.ok()) {
      return absl::InvalidArgumentError(absl::StrFormat("lights[%d].%s", i, light_maps.status().message()));
    }

    glm::dmat4x3 ray_from_window;
    glm::dvec4 along;
    for (int column = 0; column < 4; ++column) {
      const glm::dvec4& ws = ws_from_window[column];
      ray_from_window[column] = ray_space->linear() * glm::dvec3(ws) + ray_space->offset() * ws.w;
      along[column] =
          ray_space->is_directional() ? glm::dot(ray_space->ws_direction(), glm::dvec3(ws)) : ws.w;
    }
    for (const LightMap& map : *light_maps) {
      PlannedMap planned;
      planned.map = map;
      planned.along = along;
      const glm::dmat4x3 picture_from_window = map.picture_from_ray * ray_from_window;
      for (int column = 0; column < 4; ++column) {
        planned.x[column] = picture_from_window[column].x;
        planned.y[column] = picture_from_window[column].y;
        planned.w[column] = picture_from_window[column].z;
      }
      if (ray_space->cos_outer()) {
        // r is in the cone where r_z^2 >= cos^2 |r|^2 and r_z > 0; r = picture_from_ray^-1 p.
        const double cos2 = *ray_space->cos_outer() * *ray_space->cos_outer();
        const glm::dmat3 ray_from_picture = glm::inverse(map.picture_from_ray);
        const glm::dmat3 form(glm::dvec3(-cos2, 0, 0), glm::dvec3(0, -cos2, 0), glm::dvec3(0, 0, 1.0 - cos2));
        planned.cone = true;
        planned.cone_form = glm::transpose(ray_from_picture) * form * ray_from_picture;
        planned.cone_axis = glm::transpose(ray_from_picture)[2];
      }
      maps.push_back(planned);
    }
    ray_spaces.push_back(*std::move(ray_space));
    first_map.push_back(static_cast<int>(maps.size()));
  }
  return absl::OkStatus();
}

Tile ResolutionEstimator::Workspace::MakeTile(int index) const {
  Tile tile;
  tile.depth = depth;
  tile.x0 = index % tiles_x * resolution::kTileWidth;
  tile.y0 = index / tiles_x * resolution::kTileHeight;
  tile.width = std::min(resolution::kTileWidth, depth.width - tile.x0);
  tile.height = std::min(resolution::kTileHeight, depth.height - tile.y0);
  SetSampleRange(convention, &tile);
  // The depth of any sample serves as reference; the further from the others, the more tiles need double
  // precision.
  tile.reference_depth = static_cast<float>(BackgroundWindowDepth(convention));
  constexpr int kProbes = 4;
  for (int probe = 0; probe < kProbes * kProbes; ++probe) {
    // From the middle outwards, roughly.
    const int i = (probe % kProbes * 2 + 5) % 8;
    const int j = (probe / kProbes * 2 + 5) % 8;
    const float z = depth.At(tile.x0 + tile.width * i / 8, tile.y0 + tile.height * j / 8);
    if (!(z >= tile.lowest && z <= tile.highest)) continue;
    tile.reference_depth = z;
    break;
  }
  return tile;
}

void ResolutionEstimator::Workspace::ReduceTile(int index) {
  const Tile tile = MakeTile(index);
  const int map_count = static_cast<int>(maps.size());
  TileDepths<float> depths;
  resolution::PrepareTile(tile, &depths);
  if (depths.least > depths.most) {
    for (int map = 0; map < map_count; ++map) BoundOf(map, index) = {.settled = true};
    return;
  }
  uint32_t* counts = nullptr;
  if (histogram) {
    std::vector<uint32_t>& own = histograms.local();
    own.resize(maps.size() * 2 * resolution::kHistogramBins);
    counts = own.data();
  }
  const TilePlacer placer(tile, depths.least, depths.most);
  TileExtent extent;
  for (int map = 0; map < map_count; ++map) {
    const PlannedMap& planned = maps[static_cast<size_t>(map)];
    PlacedMap placed = placer.Place(planned, false);
    if (placed.where == PlacedMap::Where::kOutside) {
      BoundOf(map, index) = {.settled = true};
      continue;
    }
    if (counts != nullptr) {
      placed.map.histogram_x = counts + static_cast<size_t>(map) * 2 * resolution::kHistogramBins;
      placed.map.histogram_y = placed.map.histogram_x + resolution::kHistogramBins;
    }
    const bool in_double = placed.where == PlacedMap::Where::kInDouble;
    if (in_double) {
      ReduceInDouble(tile, placed.map, &extent);
    } else {
      resolution::ReduceTile(tile, depths, placed.map, &extent);
    }
    SetBound(planned, placed, extent, in_double, &BoundOf(map, index));
  }
}

void ResolutionEstimator::Workspace::ReduceAll(const Cancellation& cancellation) {
  tiles_x = (depth.width + resolution::kTileWidth - 1) / resolution::kTileWidth;
  tiles_y = (depth.height + resolution::kTileHeight - 1) / resolution::kTileHeight;
  bounds.resize(maps.size() * static_cast<size_t>(tile_count()));
  settled = 0;
  for (std::vector<uint32_t>& counts : histograms) std::fill(counts.begin(), counts.end(), 0);
  tbb::parallel_for(0, tiles_y, [&](int row) {
    if (cancellation.Requested()) return;
    for (int column = 0; column < tiles_x; ++column) ReduceTile(row * tiles_x + column);
  });
  for (const TileBound& bound : bounds) settled += bound.settled && !bound.empty ? 1 : 0;
  if (!histogram) return;
  histogram_sum.assign(maps.size() * 2 * resolution::kHistogramBins, 0);
  for (const std::vector<uint32_t>& counts : histograms) {
    const size_t shared = std::min(counts.size(), histogram_sum.size());
    for (size_t i = 0; i < shared; ++i) histogram_sum[i] += counts[i];
  }
}

void ResolutionEstimator::Workspace::Settle(const Cancellation& cancellation) {
  settled += static_cast<int>(to_settle.size());
  tbb::parallel_for(size_t{0}, to_settle.size(), [&](size_t i) {
    if (cancellation.Requested()) return;
    const auto [map, index] = to_settle[i];
    const PlannedMap& planned = maps[static_cast<size_t>(map)];
    const Tile tile = MakeTile(index);
    TileDepths<double> depths;
    resolution::PrepareTile(tile, &depths);
    const PlacedMap placed = TilePlacer(tile, depths.least, depths.most).Place(planned, true);
    TileExtent extent;
    resolution::ReduceTile(tile, depths, placed.map, &extent);
    SetBound(planned, placed, extent, true, &BoundOf(map, index));
  });
}

void ResolutionEstimator::Workspace::MeetExtent(int map, bool settled_only, glm::dvec2* low,
                                                glm::dvec2* high) {
  *low = glm::dvec2(kInfinity);
  *high = glm::dvec2(-kInfinity);
  for (int tile = 0; tile < tile_count(); ++tile) {
    const TileBound& bound = BoundOf(map, tile);
    if (bound.empty || (settled_only && !bound.settled)) continue;
    *low = glm::min(*low, bound.low);
    *high = glm::max(*high, bound.high);
  }
}

/// Settles tiles until no other can widen the extent, the outermost on each side first: where a bound is
/// loose, the tiles behind it often turn out to need no settling.
void ResolutionEstimator::Workspace::SettleExtent(int map, const Cancellation& cancellation) {
  while (!cancellation.Requested()) {
    glm::dvec2 low;
    glm::dvec2 high;
    MeetExtent(map, true, &low, &high);
    constexpr int kSides = 4;
    constexpr int kPerSide = 2;
    struct Reach {
      double beyond = 0.0;  // How far a tile may reach beyond what is certain.
      int tile = -1;
    };
    Reach outermost[kSides][kPerSide];
    for (int tile = 0; tile < tile_count(); ++tile) {
      const TileBound& bound = BoundOf(map, tile);
      if (bound.empty || bound.settled) continue;
      const double beyond[kSides] = {low.x - bound.low.x, low.y - bound.low.y, bound.high.x - high.x,
                                     bound.high.y - high.y};
      for (int side = 0; side < kSides; ++side) {
        Reach reach{beyond[side], tile};
        for (Reach& best : outermost[side]) {
          if (reach.beyond > best.beyond) std::swap(reach, best);
        }
      }
    }
    to_settle.clear();
    for (const auto& side : outermost) {
      for (const Reach& reach : side) {
        const bool listed = std::any_of(to_settle.begin(), to_settle.end(),
                                        [&](const Item& item) { return item.tile == reach.tile; });
        if (reach.tile >= 0 && !listed) to_settle.push_back({map, reach.tile});
      }
    }
    if (to_settle.empty()) return;
    Settle(cancellation);
  }
}

/// Settles tiles until no other can change the number of texels: first the one that seems to hold the
/// smallest box, then all whose lower bound would need more texels than are certain.
glm::dvec2 ResolutionEstimator::Workspace::SettleSmallest(int map, const glm::dvec2& extent, double scale,
                                                          int max_size, const Cancellation& cancellation) {
  to_settle.clear();
  for (int axis = 0; axis < 2; ++axis) {
    int best = -1;
    for (int tile = 0; tile < tile_count(); ++tile) {
      const TileBound& bound = BoundOf(map, tile);
      if (bound.empty || (best >= 0 && !(bound.smallest[axis] < BoundOf(map, best).smallest[axis]))) continue;
      best = tile;
    }
    if (best < 0 || BoundOf(map, best).settled) continue;
    if (to_settle.empty() || to_settle[0].tile != best) to_settle.push_back({map, best});
  }
  Settle(cancellation);

  const auto smallest_settled = [&] {
    glm::dvec2 smallest(kInfinity);
    for (int tile = 0; tile < tile_count(); ++tile) {
      const TileBound& bound = BoundOf(map, tile);
      if (bound.settled && !bound.empty) smallest = glm::min(smallest, bound.smallest);
    }
    return smallest;
  };
  const glm::dvec2 smallest = smallest_settled();
  glm::dvec2 threshold;
  for (int axis = 0; axis < 2; ++axis) {
    const int texels =
        RoundedSize(NeededTexels(extent[axis], smallest[axis], scale), SizeRounding::kExact, max_size);
    threshold[axis] = texels >= max_size ? 0.0 : extent[axis] * scale / (texels + kTexelTolerance);
  }
  to_settle.clear();
  for (int tile = 0; tile < tile_count(); ++tile) {
    const TileBound& bound = BoundOf(map, tile);
    if (bound.empty || bound.settled) continue;
    if (bound.smallest.x < threshold.x || bound.smallest.y < threshold.y) to_settle.push_back({map, tile});
  }
  Settle(cancellation);
  return smallest_settled();
}

ResolutionEstimator::ResolutionEstimator() : workspace_(std::make_unique<Workspace>()) {}
ResolutionEstimator::~ResolutionEstimator() = default;
ResolutionEstimator::ResolutionEstimator(ResolutionEstimator&&) noexcept = default;
ResolutionEstimator& ResolutionEstimator::operator=(ResolutionEstimator&&) noexcept = default;

absl::Status ResolutionEstimator::Estimate(const ResolutionRequest& request, const ResolutionOptions& options,
                                           const Cancellation& cancellation, ResolutionSummary* summary) {
  const auto start = std::chrono::steady_clock::now();
  if (absl::Status status = Validate(options); !status.ok()) return status;
  if (absl::Status status = CheckPictures(request); !status.ok()) return status;
  Workspace& work = *workspace_;
  if (absl::Status status = work.Plan(request); !status.ok()) return status;
  work.histogram = options.histogram || options.percentile < 100.0;
  work.ReduceAll(cancellation);

  const double scale = ScreenScale(request);
  summary->lights.resize(request.lights.size());
  for (size_t i = 0; i < request.lights.size(); ++i) {
    LightEstimate& light = summary->lights[i];
    light.id = request.lights[i].id;
    light.recommended = {LeastSize(options.rounding), LeastSize(options.rounding)};
    light.maps.clear();
    for (int map = work.first_map[i]; map < work.first_map[i + 1]; ++map) {
      if (cancellation.Requested()) break;
      const PlannedMap& planned = work.maps[static_cast<size_t>(map)];
      MapEstimate estimate;
      estimate.recommended = {LeastSize(options.rounding), LeastSize(options.rounding)};
      work.SettleExtent(map, cancellation);
      glm::dvec2 low;
      glm::dvec2 high;
      work.MeetExtent(map, true, &low, &high);
      if (low.x <= high.x) {
        const glm::dvec2 extent = high - low;
        estimate.crop_min = low;
        estimate.crop_max = high;
        estimate.smallest_patch = work.SettleSmallest(map, extent, scale, options.max_size, cancellation);
        double least_along = kInfinity;
        double most_along = -kInfinity;
        for (int tile = 0; tile < work.tile_count(); ++tile) {
          const TileBound& bound = work.BoundOf(map, tile);
          estimate.pixels += bound.pixels;
          least_along = std::min(least_along, bound.least_along);
          most_along = std::max(most_along, bound.most_along);
        }
        int size[2];
        for (int axis = 0; axis < 2; ++axis) {
          double& needed = estimate.needed[axis];
          needed = NeededTexels(extent[axis], estimate.smallest_patch[axis], scale);
          if (options.percentile < 100.0) {
            needed = std::min(
                needed, PercentileNeed(work.HistogramOf(map, axis), options.percentile, extent[axis], scale));
          }
          size[axis] = RoundedSize(needed, options.rounding, options.max_size);
          estimate.limited = estimate.limited || size[axis] < std::ceil(needed - kTexelTolerance);
        }
        estimate.recommended = {size[0], size[1]};
        if (options.histogram) {
          estimate.histogram_x = Bins(work.HistogramOf(map, 0), extent.x, scale);
          estimate.histogram_y = Bins(work.HistogramOf(map, 1), extent.y, scale);
        }
        estimate.depth_range = RangeOf(work.ray_spaces[i], least_along, most_along);
      }
      // The crop as rows: u = (x - low) / (high - low) * size.
      const glm::dmat3 rows = glm::transpose(planned.map.picture_from_ray);
      glm::dmat3 crop = rows;
      for (int axis = 0; axis < 2; ++axis) {
        const double extent = std::max(estimate.crop_max[axis] - estimate.crop_min[axis], 1e-12);
        const int texels = axis == 0 ? estimate.recommended.width : estimate.recommended.height;
        crop[axis] = (rows[axis] - estimate.crop_min[axis] * rows[2]) * (texels / extent);
      }
      estimate.projection = {glm::transpose(crop), estimate.recommended};
      estimate.clip_from_world = ClipFromWorld(work.ray_spaces[i], estimate.projection, estimate.depth_range,
                                               request.output_clip_depth);
      light.recommended.width = std::max(light.recommended.width, estimate.recommended.width);
      light.recommended.height = std::max(light.recommended.height, estimate.recommended.height);
      light.maps.push_back(std::move(estimate));
    }
  }
  if (cancellation.Requested()) {
    return cancellation.DeadlinePassed()
               ? absl::DeadlineExceededError("the deadline passed during the estimate")
               : absl::CancelledError("the estimate was cancelled");
  }
  summary->tiles = static_cast<int>(work.bounds.size());
  summary->settled_tiles = work.settled;
  summary->seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return absl::OkStatus();
}

}  // namespace shadowfit
