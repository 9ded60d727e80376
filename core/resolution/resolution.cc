#include "core/resolution/resolution.h"

#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <bit>
#include <chrono>
#include <cmath>
#include <iterator>
#include <limits>
#include <set>
#include <span>

#include "absl/strings/str_format.h"
#include "core/resolution/light_maps.h"
#include "core/resolution/tile_blocks.h"
#include "core/resolution/tile_kernel.h"
#include "core/resolution/tile_placement.h"

namespace shadowfit {
namespace {

using resolution::BlockMask;
using resolution::Extremes;
using resolution::kBlocks;
using resolution::kBlockWidth;
using resolution::LightMap;
using resolution::PlacedBlocks;
using resolution::PlacedMap;
using resolution::PlannedMap;
using resolution::Tile;
using resolution::TileBlocks;
using resolution::TileDepths;
using resolution::TileExtent;
using resolution::TileMap;
using resolution::TilePlacer;

/// What one tile has to say to one map.
struct TileBound {
  Extremes settled;          // Of the blocks that were computed in double precision.
  BlockMask open = 0;        // The others, as far as they hold samples.
  Extremes outer;            // Bounds for these.
  BlockMask unmeasured = 0;  // Those of the open ones that no pixel was looked at of, and of the others, ...
  glm::dvec2 measured{resolution::kUnbounded};  // ... bounds of their smallest boxes.
  glm::dvec2 promise{resolution::kUnbounded};   // A guess at the unmeasured blocks' smallest boxes.
  int64_t pixels = 0;
  double least_along = resolution::kUnbounded;
  double most_along = -resolution::kUnbounded;
};

/// The part of the window depths that belongs to samples: in [0,1], without the background's value.
void SetSampleRange(ClipDepth convention, Tile* tile) {
  tile->lowest = convention == ClipDepth::kReversedZeroToOne ? std::nextafter(0.0F, 1.0F) : 0.0F;
  tile->highest = convention == ClipDepth::kReversedZeroToOne ? 1.0F : std::nextafter(1.0F, 0.0F);
}

/// Reduces some blocks of a tile, in the arithmetic of T.
template <typename T>
TileExtent ReduceBlocks(Tile tile, BlockMask mask, const TileMap& map) {
  TileExtent all;
  TileDepths<T> depths;
  for (int block = 0; block < kBlocks; ++block) {
    if ((mask >> block & 1) == 0) continue;
    tile.begin = block * kBlockWidth;
    while (block + 1 < kBlocks && (mask >> (block + 1) & 1) != 0) ++block;
    tile.end = std::min(tile.width, (block + 1) * kBlockWidth);
    resolution::PrepareTile(tile, &depths);
    TileExtent extent;
    resolution::ReduceTile(tile, depths, map, &extent);
    all.Add(extent);
  }
  return all;
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
  std::vector<TileBlocks> blocks;  // [tile]
  std::vector<TileBound> bounds;   // [map][tile]
  std::atomic<int> settled{0};     // Tiles times maps, in double precision.
  std::atomic<int64_t> visits{0};  // Pixels times maps that were projected one by one.
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
  void CountVisits(const Tile& tile, BlockMask mask) {
    const int last = (tile.width - 1) / kBlockWidth;  // May be narrow.
    const int missing = (mask >> last & 1) != 0 ? (last + 1) * kBlockWidth - tile.width : 0;
    visits.fetch_add((int64_t{std::popcount(mask)} * kBlockWidth - missing) * tile.height,
                     std::memory_order_relaxed);
  }
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
  tile.end = tile.width;
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
  TileBlocks& common = blocks[static_cast<size_t>(index)];
  resolution::SummarizeTile(tile, &common);
  const int map_count = static_cast<int>(maps.size());
  for (int map = 0; map < map_count; ++map) BoundOf(map, index) = {};
  BlockMask with_samples = 0;
  for (int block = 0; block < kBlocks; ++block) {
    with_samples |= BlockMask{common.samples[block] > 0} << block;
  }
  if (with_samples == 0) return;
  uint32_t* counts = nullptr;
  TileDepths<float> depths;
  if (histogram) {
    std::vector<uint32_t>& own = histograms.local();
    own.resize(maps.size() * 2 * resolution::kHistogramBins);
    counts = own.data();
    resolution::PrepareTile(tile, &depths);
  }
  const TilePlacer placer(tile, resolution::BoundsOf(common));
  for (int map = 0; map < map_count; ++map) {
    const PlannedMap& planned = maps[static_cast<size_t>(map)];
    PlacedMap placed = placer.Place(planned, false);
    if (placed.where == PlacedMap::Where::kOutside) continue;
    if (counts != nullptr) {
      placed.map.histogram_x = counts + static_cast<size_t>(map) * 2 * resolution::kHistogramBins;
      placed.map.histogram_y = placed.map.histogram_x + resolution::kHistogramBins;
    }
    const bool in_double = placed.where == PlacedMap::Where::kInDouble;
    TileBound& bound = BoundOf(map, index);
    if (!placed.before_light || (in_double && histogram)) {
      const TileExtent extent = ReduceBlocks<double>(tile, with_samples, placed.map);
      CountVisits(tile, with_samples);
      settled.fetch_add(1, std::memory_order_relaxed);
      bound.settled = resolution::BoundsFrom(planned, placed, extent, true);
      bound.pixels = extent.pixels;
      bound.least_along = extent.least_along;
      bound.most_along = extent.most_along;
      continue;
    }
    TileExtent extent;
    if (histogram) {
      resolution::ReduceTile(tile, depths, placed.map, &extent);
      CountVisits(tile, with_samples);
      bound.open = with_samples;
    } else {
      PlacedBlocks view;
      resolution::PlaceBlocks(planned, placed, tile, common, &view);
      const auto measure = [&](BlockMask mask) {
        CountVisits(tile, mask);
        return in_double ? ReduceBlocks<double>(tile, mask, placed.map)
                         : ReduceBlocks<float>(tile, mask, placed.map);
      };
      if (view.edge != 0) extent = measure(view.edge);
      bound.open = view.inside | (extent.pixels > 0 ? view.edge : 0);
      BlockMask unknown = 0;  // Any of these may hold the smallest box.
      for (int block = 0; block < kBlocks; ++block) {
        const BlockMask bit = BlockMask{1} << block;
        if ((view.inside & bit) == 0) continue;
        const Extremes& bounds = view.bounds[block];
        bound.pixels += common.samples[block];
        const bool is_known = bounds.smallest.x > 0.0 && bounds.smallest.y > 0.0;
        if (!is_known) unknown |= bit;
        bound.outer.Add(
            {bounds.low, bounds.high, is_known ? bounds.smallest : glm::dvec2(resolution::kUnbounded)});
        for (int axis = 0; axis < 2; ++axis) {
          const double least = bounds.smallest[axis];
          if (least > 0.0) bound.promise[axis] = std::min(bound.promise[axis], least);
        }
      }
      bound.unmeasured = view.inside & ~unknown;
      if (unknown != 0) {
        bound.measured = resolution::BoundsFrom(planned, placed, measure(unknown), in_double).smallest;
        bound.outer.smallest = glm::min(bound.outer.smallest, bound.measured);
      }
    }
    const Extremes measured = resolution::BoundsFrom(planned, placed, extent, in_double);
    bound.outer.Add(measured);
    bound.measured = glm::min(bound.measured, measured.smallest);
    bound.pixels += extent.pixels;
    bound.least_along = placed.least_along;
    bound.most_along = placed.most_along;
  }
}

void ResolutionEstimator::Workspace::ReduceAll(const Cancellation& cancellation) {
  tiles_x = (depth.width + resolution::kTileWidth - 1) / resolution::kTileWidth;
  tiles_y = (depth.height + resolution::kTileHeight - 1) / resolution::kTileHeight;
  bounds.resize(maps.size() * static_cast<size_t>(tile_count()));
  blocks.resize(static_cast<size_t>(tile_count()));
  settled = 0;
  visits = 0;
  for (std::vector<uint32_t>& counts : histograms) std::fill(counts.begin(), counts.end(), 0);
  tbb::parallel_for(0, tiles_y, [&](int row) {
    if (cancellation.Requested()) return;
    for (int column = 0; column < tiles_x; ++column) ReduceTile(row * tiles_x + column);
  });
  if (!histogram) return;
  histogram_sum.assign(maps.size() * 2 * resolution::kHistogramBins, 0);
  for (const std::vector<uint32_t>& counts : histograms) {
    const size_t shared = std::min(counts.size(), histogram_sum.size());
    for (size_t i = 0; i < shared; ++i) histogram_sum[i] += counts[i];
  }
}

/// Makes the bounds of one map certain, as far as they matter.
class ResolutionEstimator::Settler {
 public:
  Settler(Workspace* work, int map, const Cancellation& cancellation)
      : work_(*work),
        cancellation_(cancellation),
        planned_(work->maps[static_cast<size_t>(map)]),
        bounds_(&work->BoundOf(map, 0), static_cast<size_t>(work->tile_count())) {
    for (const TileBound& bound : bounds_) certain_.Add(bound.settled);
  }

  /// What is certain by now.
  const Extremes& certain() const { return certain_; }

  /// Settles tiles until no other can widen the extent, the outermost on each side first: where a bound is
  /// loose, the tiles behind it often turn out to need no settling.
  void SettleExtent() {
    // Nothing is certain at first; only what is about as far out as anything is worth a look.
    Extremes known;
    for (const TileBound& bound : bounds_) {
      known.Add(bound.settled);
      known.Add(bound.outer);
    }
    const glm::dvec2 inwards = 0.01 * (known.high - known.low);
    known.low += inwards;
    known.high -= inwards;
    known.smallest = glm::dvec2(-resolution::kUnbounded);
    while (!cancellation_.Requested()) {
      constexpr int kSides = 4;
      constexpr int kPerSide = 2;
      struct Reach {
        double beyond = 0.0;  // How far a tile may reach beyond what is known.
        int tile = -1;
      };
      Reach outermost[kSides][kPerSide];
      for (int tile = 0; tile < tile_count(); ++tile) {
        const TileBound& bound = bounds_[static_cast<size_t>(tile)];
        if (bound.open == 0) continue;
        const double beyond[kSides] = {known.low.x - bound.outer.low.x, known.low.y - bound.outer.low.y,
                                       bound.outer.high.x - known.high.x, bound.outer.high.y - known.high.y};
        for (int side = 0; side < kSides; ++side) {
          Reach reach{beyond[side], tile};
          for (Reach& best : outermost[side]) {
            if (reach.beyond > best.beyond) std::swap(reach, best);
          }
        }
      }
      tiles_.clear();
      for (const auto& side : outermost) {
        for (const Reach& reach : side) List(reach.tile);
      }
      if (tiles_.empty() && known.low == certain_.low && known.high == certain_.high) return;
      SettleListed(known);
      known.low = certain_.low;
      known.high = certain_.high;
    }
  }

  /// Settles tiles until no other can change the number of texels, given the final extent. First those that
  /// seem to hold the smallest boxes: by what their pixels have in common, by the pixels of all blocks of
  /// which nothing is known, and by those of all blocks that may hold a still smaller one. Then all that
  /// would need more texels than are certain.
  void SettleSmallest(double scale, int max_size) {
    SettleLeast([](const TileBound& bound) { return bound.promise; });
    SettleLeast([](const TileBound& bound) { return bound.measured; });
    MeasureBelow(certain_.smallest);
    SettleLeast([](const TileBound& bound) { return bound.outer.smallest; });
    const glm::dvec2 extent = certain_.high - certain_.low;
    glm::dvec2 threshold;
    for (int axis = 0; axis < 2; ++axis) {
      const double need = NeededTexels(extent[axis], certain_.smallest[axis], scale);
      const int texels = RoundedSize(need, SizeRounding::kExact, max_size);
      // No pixel left may need more than this.
      const double most = texels < max_size ? texels + kTexelTolerance : need * (1.0 + kNeedTolerance);
      threshold[axis] = extent[axis] * scale / most;
    }
    ListBelow(threshold, [](const TileBound&) { return true; });
    SettleListed(BoxesBelow(threshold));
  }

 private:
  int tile_count() const { return static_cast<int>(bounds_.size()); }

  static Extremes BoxesBelow(const glm::dvec2& size) {
    return {.low = glm::dvec2(-resolution::kUnbounded),
            .high = glm::dvec2(resolution::kUnbounded),
            .smallest = size};
  }

  void List(int tile) {
    if (tile >= 0 && std::find(tiles_.begin(), tiles_.end(), tile) == tiles_.end()) tiles_.push_back(tile);
  }

  template <typename Condition>
  void ListBelow(const glm::dvec2& size, const Condition& condition) {
    tiles_.clear();
    for (int tile = 0; tile < tile_count(); ++tile) {
      const TileBound& bound = bounds_[static_cast<size_t>(tile)];
      const bool below = bound.outer.smallest.x < size.x || bound.outer.smallest.y < size.y;
      if (bound.open != 0 && below && condition(bound)) tiles_.push_back(tile);
    }
  }

  /// The tiles whose value is least along each axis.
  template <typename Value>
  void SettleLeast(const Value& value_of) {
    tiles_.clear();
    for (int axis = 0; axis < 2; ++axis) {
      int best = -1;
      double least = certain_.smallest[axis];
      for (int tile = 0; tile < tile_count(); ++tile) {
        const TileBound& bound = bounds_[static_cast<size_t>(tile)];
        const double value = value_of(bound)[axis];
        if (bound.open == 0 || !(value < least)) continue;
        least = value;
        best = tile;
      }
      List(best);
    }
    SettleListed(BoxesBelow(certain_.smallest));
  }

  void SettleListed(const Extremes& known) {
    tbb::parallel_for(size_t{0}, tiles_.size(), [&](size_t i) {
      if (!cancellation_.Requested()) SettleTile(tiles_[i], known);
    });
    for (const int tile : tiles_) certain_.Add(bounds_[static_cast<size_t>(tile)].settled);
  }

  /// A tile, where the map sees it, and the bounds of its blocks there.
  struct PlacedTile {
    Tile tile;
    PlacedMap placed;
    PlacedBlocks blocks;
  };
  PlacedTile PlaceTile(int index, bool in_double) {
    PlacedTile at;
    at.tile = work_.MakeTile(index);
    const TileBlocks& common = work_.blocks[static_cast<size_t>(index)];
    at.placed = TilePlacer(at.tile, resolution::BoundsOf(common)).Place(planned_, in_double);
    resolution::PlaceBlocks(planned_, at.placed, at.tile, common, &at.blocks);
    return at;
  }

  /// Computes, in double precision, the open blocks of a tile that may add to what is known.
  void SettleTile(int index, const Extremes& known) {
    TileBound& bound = bounds_[static_cast<size_t>(index)];
    const PlacedTile at = PlaceTile(index, true);
    BlockMask wanted = 0;
    bound.outer = {};
    bound.promise = glm::dvec2(resolution::kUnbounded);
    for (int block = 0; block < kBlocks; ++block) {
      const BlockMask bit = BlockMask{1} << block;
      if ((bound.open & bit) == 0) continue;
      Extremes bounds = at.blocks.bounds[block];
      if ((bound.unmeasured & bit) == 0) bounds.smallest = glm::max(bounds.smallest, bound.measured);
      if (bounds.MayExtend(known)) {
        wanted |= bit;
      } else {
        bound.outer.Add(bounds);
      }
    }
    bound.open &= ~wanted;
    bound.unmeasured &= ~wanted;
    const TileExtent extent = ReduceBlocks<double>(at.tile, wanted, at.placed.map);
    work_.CountVisits(at.tile, wanted);
    work_.settled.fetch_add(1, std::memory_order_relaxed);
    bound.settled.Add(resolution::BoundsFrom(planned_, at.placed, extent, true));
  }

  /// Looks at the pixels of all blocks that may hold a box smaller than `size`.
  void MeasureBelow(const glm::dvec2& size) {
    ListBelow(size, [](const TileBound& bound) { return bound.unmeasured != 0; });
    tbb::parallel_for(size_t{0}, tiles_.size(), [&](size_t i) {
      if (!cancellation_.Requested()) MeasureTile(tiles_[i], size);
    });
  }

  void MeasureTile(int index, const glm::dvec2& size) {
    TileBound& bound = bounds_[static_cast<size_t>(index)];
    const PlacedTile at = PlaceTile(index, false);
    BlockMask wanted = 0;
    glm::dvec2 others(resolution::kUnbounded);
    for (int block = 0; block < kBlocks; ++block) {
      const BlockMask bit = BlockMask{1} << block;
      if ((bound.unmeasured & bit) == 0) continue;
      if (at.blocks.bounds[block].MayExtend(BoxesBelow(size))) {
        wanted |= bit;
      } else {
        others = glm::min(others, at.blocks.bounds[block].smallest);
      }
    }
    const bool in_double = at.placed.where == PlacedMap::Where::kInDouble;
    const TileExtent extent = in_double ? ReduceBlocks<double>(at.tile, wanted, at.placed.map)
                                        : ReduceBlocks<float>(at.tile, wanted, at.placed.map);
    work_.CountVisits(at.tile, wanted);
    bound.unmeasured &= ~wanted;
    bound.measured =
        glm::min(bound.measured, resolution::BoundsFrom(planned_, at.placed, extent, in_double).smallest);
    bound.outer.smallest = glm::min(bound.measured, others);
  }

  Workspace& work_;
  const Cancellation& cancellation_;
  const PlannedMap& planned_;
  const std::span<TileBound> bounds_;
  Extremes certain_;
  std::vector<int> tiles_;
};

ResolutionEstimator::ResolutionEstimator() : workspace_(std::make_unique<Workspace>()) {}
ResolutionEstimator::~ResolutionEstimator() = default;
ResolutionEstimator::ResolutionEstimator(ResolutionEstimator&&) noexcept = default;
ResolutionEstimator& ResolutionEstimator::operator=(ResolutionEstimator&&) noexcept = default;

MapEstimate ResolutionEstimator::EstimateMap(const ResolutionRequest& request,
                                             const ResolutionOptions& options, const RaySpace& ray_space,
                                             int map, const Cancellation& cancellation) {
  Workspace& work = *workspace_;
  MapEstimate estimate;
  estimate.recommended = {LeastSize(options.rounding), LeastSize(options.rounding)};
  Settler settler(&work, map, cancellation);
  settler.SettleExtent();
  const glm::dvec2 low = settler.certain().low;
  const glm::dvec2 high = settler.certain().high;
  if (low.x <= high.x) {
    const double scale = ScreenScale(request);
    settler.SettleSmallest(scale, options.max_size);
    const glm::dvec2 extent = high - low;
    estimate.crop_min = low;
    estimate.crop_max = high;
    estimate.smallest_patch = settler.certain().smallest;
    double least_along = resolution::kUnbounded;
    double most_along = -resolution::kUnbounded;
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
    estimate.depth_range = RangeOf(ray_space, least_along, most_along);
  }
  // The crop as rows: u = (x - low) / (high - low) * size.
  const glm::dmat3 rows = glm::transpose(work.maps[static_cast<size_t>(map)].map.picture_from_ray);
  glm::dmat3 crop = rows;
  for (int axis = 0; axis < 2; ++axis) {
    const double extent = std::max(estimate.crop_max[axis] - estimate.crop_min[axis], 1e-12);
    const int texels = axis == 0 ? estimate.recommended.width : estimate.recommended.height;
    crop[axis] = (rows[axis] - estimate.crop_min[axis] * rows[2]) * (texels / extent);
  }
  estimate.projection = {glm::transpose(crop), estimate.recommended};
  estimate.clip_from_world =
      ClipFromWorld(ray_space, estimate.projection, estimate.depth_range, request.output_clip_depth);
  return estimate;
}

absl::Status ResolutionEstimator::Estimate(const ResolutionRequest& request, const ResolutionOptions& options,
                                           const Cancellation& cancellation, ResolutionSummary* summary) {
  const auto start = std::chrono::steady_clock::now();
  if (absl::Status status = Validate(options); !status.ok()) return status;
  if (absl::Status status = CheckPictures(request); !status.ok()) return status;
  Workspace& work = *workspace_;
  if (absl::Status status = work.Plan(request); !status.ok()) return status;
  work.histogram = options.histogram || options.percentile < 100.0;
  work.ReduceAll(cancellation);

  std::vector<MapEstimate> estimates(work.maps.size());
  tbb::parallel_for(size_t{0}, request.lights.size(), [&](size_t light) {
    tbb::parallel_for(work.first_map[light], work.first_map[light + 1], [&](int map) {
      if (cancellation.Requested()) return;
      estimates[static_cast<size_t>(map)] =
          EstimateMap(request, options, work.ray_spaces[light], map, cancellation);
    });
  });
  summary->lights.resize(request.lights.size());
  for (size_t i = 0; i < request.lights.size(); ++i) {
    LightEstimate& light = summary->lights[i];
    light.id = request.lights[i].id;
    light.recommended = {LeastSize(options.rounding), LeastSize(options.rounding)};
    light.maps.assign(std::make_move_iterator(estimates.begin() + work.first_map[i]),
                      std::make_move_iterator(estimates.begin() + work.first_map[i + 1]));
    for (const MapEstimate& map : light.maps) {
      light.recommended.width = std::max(light.recommended.width, map.recommended.width);
      light.recommended.height = std::max(light.recommended.height, map.recommended.height);
    }
  }
  if (absl::Status status = CancellationStatus(&cancellation, "the estimate"); !status.ok()) return status;
  summary->tiles = static_cast<int>(work.bounds.size());
  summary->settled_tiles = work.settled;
  summary->visited_share = static_cast<double>(work.visits) /
                           (static_cast<double>(work.maps.size()) * work.depth.width * work.depth.height);
  summary->seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return absl::OkStatus();
}

}  // namespace shadowfit
