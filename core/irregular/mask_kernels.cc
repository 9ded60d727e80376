#include "core/irregular/mask_kernels.h"

#include <algorithm>
#include <atomic>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

// AVX-512, AVX2, and SSE4 for what is older.
#define HWY_DISABLED_TARGETS (HWY_SSSE3 | HWY_AVX3_DL)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/irregular/mask_kernels.cc"
#include <hwy/cache_control.h>
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace shadowfit::irregular {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

using DF = hn::CappedTag<float, kPacket>;
using DI = hn::RebindToSigned<DF>;
using DU = hn::RebindToUnsigned<DF>;
using DH = hn::Half<DF>;
using DD = hn::Rebind<double, DH>;
using VF = hn::Vec<DF>;
using VI = hn::Vec<DI>;
using VH = hn::Vec<DH>;
using VD = hn::Vec<DD>;
using MF = hn::Mask<DF>;

constexpr float kInfinity = std::numeric_limits<float>::infinity();
const DF df;
const DI di;
const DU du;
const DH dh;
const DD dd;
// CappedTag keeps this a compile-time constant, at most kPacket.
constexpr int kLanes = static_cast<int>(hn::MaxLanes(DF()));
static_assert(kPacket % kLanes == 0 && kLanes >= 2);

HWY_INLINE uint32_t BitsOf(MF mask) {
  uint8_t bytes[8] = {};
  hn::StoreMaskBits(df, mask, bytes);
  uint32_t bits;
  std::memcpy(&bits, bytes, sizeof(bits));
  return bits;
}

HWY_INLINE float LargestLane(VF v) { return hn::GetLane(hn::MaxOfLanes(df, v)); }

// ---------------------------------------------------------------------------------------------------------
// Samples

/// kLanes samples of one tile.
struct Strip {
  VF r[3];
  VF error;  ///< Bound on the distance between r and the true surface point.
  MF sample, facing_away, outside_cone;
};

HWY_INLINE MF NoLanes() { return hn::MaskFromVec(hn::Zero(df)); }

HWY_INLINE VF CombineHalves(VH low, VH high) { return hn::Combine(df, high, low); }

/// Where a tile's pixels lie against its first one, in homogeneous ray coordinates.
struct TileOffsets {
  alignas(64) double h[4][kPacket];
};

void SetUpOffsets(const RayFromPixel& m, TileOffsets* offsets) {
  for (int i = 0; i < 4; ++i) {
    for (int lane = 0; lane < kPacket; ++lane) {
      offsets->h[i][lane] = (lane % kTileWidth) * m.col_x[i] + (lane / kTileWidth) * m.col_y[i];
    }
  }
}

/// Unprojection in double precision, straight into ray coordinates: the homogeneous quotient cancels digits
/// in proportion to the ratio of far and near plane, which single precision does not have to spare.
HWY_INLINE Strip StripFromDepth(const LightFrame& frame, const LayerSource& layer, VF z, const double base[4],
                                const TileOffsets& offsets, int first) {
  Strip strip;
  strip.sample = hn::And(hn::And(hn::Ge(z, hn::Zero(df)), hn::Le(z, hn::Set(df, 1.0f))),
                         hn::Ne(z, hn::Set(df, layer.background)));

  const RayFromPixel& m = layer.ray_from_pixel;
  VH half_r[3][2], half_inverse_w[2];
  hn::Mask<DH> half_in_cone[2] = {hn::MaskFromVec(hn::Zero(dh)), hn::MaskFromVec(hn::Zero(dh))};
  for (int half = 0; half < 2; ++half) {
    const VD depth = hn::PromoteTo(dd, half == 0 ? hn::LowerHalf(dh, z) : hn::UpperHalf(dh, z));
    VD h[4];
    for (int i = 0; i < 4; ++i) {
      const VD at = hn::Load(dd, offsets.h[i] + first + half * kLanes / 2);
      h[i] = hn::MulAdd(depth, hn::Set(dd, m.col_z[i]), hn::Add(hn::Set(dd, base[i]), at));
    }
    const VD inverse_w = hn::Div(hn::Set(dd, 1.0), h[3]);
    half_inverse_w[half] = hn::DemoteTo(dh, inverse_w);
    VD r[3];
    for (int i = 0; i < 3; ++i) {
      r[i] = hn::Mul(h[i], inverse_w);
      half_r[i][half] = hn::DemoteTo(dh, r[i]);
    }
    if (frame.has_cone) {
      const VD length = hn::Sqrt(hn::MulAdd(r[0], r[0], hn::MulAdd(r[1], r[1], hn::Mul(r[2], r[2]))));
      const auto in_cone = hn::Ge(r[2], hn::Mul(hn::Set(dd, frame.cos_outer), length));
      half_in_cone[half] =
          hn::Gt(hn::DemoteTo(dh, hn::IfThenElseZero(in_cone, hn::Set(dd, 1.0))), hn::Zero(dh));
    }
  }
  // d(h/W)/dz = (dh/dz - r dW/dz) / W: how far the sample moves along its view ray with its depth.
  const VF w_slope = hn::Set(df, static_cast<float>(m.col_z[3]));
  VF slope2 = hn::Zero(df);
  for (int i = 0; i < 3; ++i) {
    strip.r[i] = CombineHalves(half_r[i][0], half_r[i][1]);
    const VF s = hn::NegMulAdd(strip.r[i], w_slope, hn::Set(df, static_cast<float>(m.col_z[i])));
    slope2 = hn::MulAdd(s, s, slope2);
  }
  const VF inverse_w = CombineHalves(half_inverse_w[0], half_inverse_w[1]);
  const VF depth_error =
      hn::MulAdd(z, hn::Set(df, layer.depth_relative_error), hn::Set(df, layer.depth_absolute_error));
  strip.error = hn::Mul(hn::Mul(hn::Sqrt(slope2), hn::Abs(inverse_w)), depth_error);
  strip.outside_cone = NoLanes();
  if (frame.has_cone) {
    strip.outside_cone = hn::Not(hn::MaskFromVec(
        CombineHalves(hn::VecFromMask(dh, half_in_cone[0]), hn::VecFromMask(dh, half_in_cone[1]))));
  }
  return strip;
}

HWY_INLINE Strip StripFromPositions(const LightFrame& frame, const glm::vec3* positions) {
  HWY_ALIGN float r[3][kLanes];
  HWY_ALIGN float outside[kLanes];
  for (int i = 0; i < kLanes; ++i) {
    const glm::dvec3 from_origin = glm::dvec3(positions[i]) - frame.ws_origin;
    double ray[3];
    for (int row = 0; row < 3; ++row) {
      ray[row] = frame.rotation[row][0] * from_origin.x + frame.rotation[row][1] * from_origin.y +
                 frame.rotation[row][2] * from_origin.z;
      r[row][i] = static_cast<float>(ray[row]);
    }
    const double length = std::sqrt(ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2]);
    outside[i] = frame.has_cone && !(ray[2] >= frame.cos_outer * length) ? 1.0f : 0.0f;
  }
  Strip strip;
  for (int i = 0; i < 3; ++i) strip.r[i] = hn::Load(df, r[i]);
  strip.error = hn::Zero(df);
  strip.sample = hn::Not(NoLanes());
  strip.outside_cone = hn::Gt(hn::Load(df, outside), hn::Zero(df));
  return strip;
}

/// One tile's pixels of a picture, and `outside` for those beyond it.
template <typename T>
HWY_INLINE void LoadTile(const ImageView<T>& image, int x0, int y0, T* out,
                         float outside = std::numeric_limits<float>::quiet_NaN()) {
  if (x0 + kTileWidth <= image.width && y0 + kTileHeight <= image.height) {
    for (int y = 0; y < kTileHeight; ++y) {
      std::memcpy(out + y * kTileWidth, image.Row(y0 + y) + x0, kTileWidth * sizeof(T));
    }
    return;
  }
  for (int lane = 0; lane < kPacket; ++lane) {
    const int x = x0 + lane % kTileWidth, y = y0 + lane / kTileWidth;
    out[lane] = x < image.width && y < image.height ? image.Row(y)[x] : T(outside);
  }
}

/// What remains when all pixels of a tile are unknown.
struct Tile {
  VF z[kPacket / kLanes];  ///< Window depth.
  alignas(64) glm::vec3 positions[kPacket];
  alignas(64) glm::vec3 normals[kPacket];
  double base[4];  ///< Homogeneous ray coordinates of the first pixel, without its depth.
};

/// False where the tile shows background only.
HWY_INLINE bool ReadTile(const LayerSource& layer, int x0, int y0, Tile* tile) {
  if (layer.ws_normals.bottom_row != nullptr) LoadTile(layer.ws_normals, x0, y0, tile->normals);
  if (layer.ws_positions.bottom_row != nullptr) {
    LoadTile(layer.ws_positions, x0, y0, tile->positions);
    return true;
  }
  HWY_ALIGN float depth[kPacket];
  LoadTile(layer.depth, x0, y0, depth);
  MF any = NoLanes();
  for (int i = 0; i < kPacket / kLanes; ++i) {
    tile->z[i] = hn::Load(df, depth + i * kLanes);
    any = hn::Or(any, hn::And(hn::Le(tile->z[i], hn::Set(df, 1.0f)),
                              hn::Ne(tile->z[i], hn::Set(df, layer.background))));
  }
  const RayFromPixel& m = layer.ray_from_pixel;
  for (int i = 0; i < 4; ++i) tile->base[i] = m.base[i] + x0 * m.col_x[i] + y0 * m.col_y[i];
  return !hn::AllFalse(df, any);
}

HWY_INLINE Strip LoadStrip(const LightFrame& frame, const LayerSource& layer, const Tile& tile,
                           const TileOffsets& offsets, int first) {
  Strip strip = layer.ws_positions.bottom_row != nullptr
                    ? StripFromPositions(frame, tile.positions + first)
                    : StripFromDepth(frame, layer, tile.z[first / kLanes], tile.base, offsets, first);
  const VF length2 =
      hn::MulAdd(strip.r[0], strip.r[0], hn::MulAdd(strip.r[1], strip.r[1], hn::Mul(strip.r[2], strip.r[2])));
  // Not finite: no sample. The bound keeps squares and cross products in range.
  strip.sample = hn::And(strip.sample, hn::Lt(length2, hn::Set(df, 1e34f)));
  // Rounding of r itself, of the triangle's vertices and of the plane's distance: see SetUpBlock.
  strip.error = hn::Add(strip.error, hn::MulAdd(hn::Sqrt(length2), hn::Set(df, 16.0f * kUnitRoundoff),
                                                hn::Set(df, layer.origin_error)));
  strip.facing_away = NoLanes();
  if (layer.ws_normals.bottom_row != nullptr) {
    VF n[3];
    hn::LoadInterleaved3(df, &tile.normals[first].x, n[0], n[1], n[2]);
    // n.(L - X) < 0, with L - X = -rotation^T r; a directional light's rays all run along its third row.
    VF along = hn::Zero(df);
    for (int row = frame.directional ? 2 : 0; row < 3; ++row) {
      VF in_ray_space = hn::Zero(df);
      for (int i = 0; i < 3; ++i) {
        in_ray_space =
            hn::MulAdd(n[i], hn::Set(df, static_cast<float>(frame.rotation[row][i])), in_ray_space);
      }
      along = frame.directional ? in_ray_space : hn::MulAdd(in_ray_space, strip.r[row], along);
    }
    strip.facing_away = hn::Gt(along, hn::Zero(df));
  }
  strip.outside_cone = hn::And(strip.outside_cone, strip.sample);
  strip.facing_away = hn::And(hn::AndNot(strip.outside_cone, strip.facing_away), strip.sample);
  return strip;
}

struct PlaneCoordinates {
  VF u, v, w;
};

/// Samples and triangles must go through the same arithmetic, so that rounding cannot part them.
HWY_INLINE PlaneCoordinates Project(bool directional, const Face& face, const VF r[3]) {
  const VF x = r[(face.axis + 1) % 3];
  const VF y = r[(face.axis + 2) % 3];
  if (directional) return {x, y, r[2]};
  const VF w = hn::Mul(hn::Set(df, face.sign), r[face.axis]);
  const VF inverse_w = hn::Div(hn::Set(df, 1.0f), w);
  return {hn::Mul(x, inverse_w), hn::Mul(y, inverse_w), w};
}

HWY_INLINE VI ClampedInt(VF value, int limit) {
  return hn::ConvertTo(di, hn::Min(hn::Max(value, hn::Zero(df)), hn::Set(df, static_cast<float>(limit))));
}

HWY_INLINE int ScalarClampedInt(float value, int limit) {
  return static_cast<int>(std::min(std::max(value, 0.0f), static_cast<float>(limit)));
}

/// Row * kSubrows + subrow.
HWY_INLINE VI SubrowOf(const Face& face, VF v) {
  const VF bin = hn::Mul(hn::Sub(v, hn::Set(df, face.v_origin)), hn::Set(df, face.v_scale));
  return hn::GatherIndex(di, face.row_of_bin.data(), ClampedInt(bin, kRowBins - 1));
}

HWY_INLINE int ScalarSubrow(const Face& face, float v) {
  const float bin = (v - face.v_origin) * face.v_scale;
  return face.row_of_bin[static_cast<size_t>(ScalarClampedInt(bin, kRowBins - 1))];
}

/// Row * columns + column of plane coordinate u in a row.
HWY_INLINE VI ColumnOf(const Face& face, VI row, VF u) {
  const VF origin = hn::GatherIndex(df, face.row_u_origin.data(), row);
  const VF scale = hn::GatherIndex(df, face.row_u_scale.data(), row);
  const VI column = ClampedInt(hn::Mul(hn::Sub(u, origin), scale), face.columns - 1);
  return hn::Add(hn::Mul(row, hn::Set(di, face.columns)), column);
}

HWY_INLINE uint32_t ScalarColumn(const Face& face, int row, float u) {
  const auto r = static_cast<size_t>(row);
  const int column = ScalarClampedInt((u - face.row_u_origin[r]) * face.row_u_scale[r], face.columns - 1);
  return static_cast<uint32_t>(row * face.columns + column);
}

constexpr int kSubrowShift = 0;
static_assert(kSubrows == 1 << kSubrowShift);

HWY_INLINE VI CellOf(const Face& face, const PlaneCoordinates& p) {
  const VI subrow = SubrowOf(face, p.v);
  const VI column = ColumnOf(face, hn::ShiftRight<kSubrowShift>(subrow), p.u);
  const VI within = hn::And(subrow, hn::Set(di, kSubrows - 1));
  const VI cell = hn::Add(column, hn::Set(di, static_cast<int32_t>(face.first_cell)));
  return hn::Add(hn::ShiftLeft<kSubrowShift>(cell), within);
}

/// Lanes whose ray leaves the cube through this face; ties go to the last axis, and each lane has one face.
HWY_INLINE MF OnFace(const Face& face, const VF r[3]) {
  const VF a[3] = {hn::Abs(r[0]), hn::Abs(r[1]), hn::Abs(r[2])};
  MF on = face.sign > 0.0f ? hn::Gt(r[face.axis], hn::Zero(df)) : hn::Lt(r[face.axis], hn::Zero(df));
  for (int other = 0; other < 3; ++other) {
    if (other == face.axis) continue;
    on = hn::And(on, other > face.axis ? hn::Gt(a[face.axis], a[other]) : hn::Ge(a[face.axis], a[other]));
  }
  return on;
}

/// A single face holds directions up to 75 degrees off its axis. Directional lights' samples all fit.
HWY_INLINE MF FitsSingleFace(bool directional, const Face& face, const VF r[3]) {
  if (directional) return hn::Eq(r[0], r[0]);
  const VF w = hn::Mul(hn::Set(df, face.sign), r[face.axis]);
  const VF limit = hn::Mul(w, hn::Set(df, 4.0f));
  return hn::And(hn::Gt(w, hn::Zero(df)), hn::And(hn::Le(hn::Abs(r[(face.axis + 1) % 3]), limit),
                                                  hn::Le(hn::Abs(r[(face.axis + 2) % 3]), limit)));
}

/// In the order of PacketEntry.
struct PacketBounds {
  alignas(16) float u_min;
  float v_min, minus_u_max, minus_v_max, farthest;

  float u_max() const { return -minus_u_max; }
  float v_max() const { return -minus_v_max; }
};

/// One store, which the load can be served from.
HWY_INLINE MF LanesOf(uint32_t bits) {
  uint8_t bytes[8] = {};
  std::memcpy(bytes, &bits, sizeof(bits));
  return hn::LoadMaskBits(df, bytes);
}

/// All lanes of each of four vectors under an associative operation, one after the other in `out`.
template <typename Operation>
HWY_INLINE void ReduceFour(VF a, VF b, VF c, VF d, const Operation& op, float* out) {
  const hn::Repartition<double, DF> pairs;
  const VF ab = op(hn::InterleaveLower(df, a, b), hn::InterleaveUpper(df, a, b));
  const VF cd = op(hn::InterleaveLower(df, c, d), hn::InterleaveUpper(df, c, d));
  const auto ab_pairs = hn::BitCast(pairs, ab), cd_pairs = hn::BitCast(pairs, cd);
  const VF blocks = op(hn::BitCast(df, hn::InterleaveLower(pairs, ab_pairs, cd_pairs)),
                       hn::BitCast(df, hn::InterleaveUpper(pairs, ab_pairs, cd_pairs)));
  if constexpr (kLanes == 16) {
    const hn::Half<DH> quarter;
    const VH half = op(hn::LowerHalf(dh, blocks), hn::UpperHalf(dh, blocks));
    hn::StoreU(op(hn::LowerHalf(quarter, half), hn::UpperHalf(quarter, half)), quarter, out);
  } else if constexpr (kLanes == 8) {
    hn::StoreU(op(hn::LowerHalf(dh, blocks), hn::UpperHalf(dh, blocks)), dh, out);
  } else {
    hn::StoreU(blocks, df, out);
  }
}

struct Smaller {
  template <typename V>
  HWY_INLINE V operator()(V a, V b) const {
    return hn::Min(a, b);
  }
};
struct Larger {
  template <typename V>
  HWY_INLINE V operator()(V a, V b) const {
    return hn::Max(a, b);
  }
};

/// Bounds of a packet's samples: the lanes in `bits`.
HWY_INLINE PacketBounds BoundPacket(bool directional, const Face& face, const float* packet, uint32_t bits) {
  const VF none = hn::Set(df, kInfinity);
  VF u_min = none, v_min = none, minus_u_max = none, minus_v_max = none, farthest = hn::Neg(none);
  for (int i = 0; i < kPacket; i += kLanes) {
    const VF r[3] = {hn::Load(df, packet + i), hn::Load(df, packet + kPacket + i),
                     hn::Load(df, packet + 2 * kPacket + i)};
    const PlaneCoordinates c = Project(directional, face, r);
    const MF sample = LanesOf(bits >> i);
    u_min = hn::Min(u_min, hn::IfThenElse(sample, c.u, none));
    v_min = hn::Min(v_min, hn::IfThenElse(sample, c.v, none));
    minus_u_max = hn::Min(minus_u_max, hn::IfThenElse(sample, hn::Neg(c.u), none));
    minus_v_max = hn::Min(minus_v_max, hn::IfThenElse(sample, hn::Neg(c.v), none));
    farthest = hn::Max(farthest, hn::IfThenElse(sample, c.w, hn::Neg(none)));
  }
  PacketBounds bounds;
  ReduceFour(u_min, v_min, minus_u_max, minus_v_max, Smaller(), &bounds.u_min);
  bounds.farthest = LargestLane(farthest);
  return bounds;
}

HWY_INLINE void AddBounds(const PacketBounds& bounds, int face, TileCounts* counts) {
  counts->u_min[face] = std::min(counts->u_min[face], bounds.u_min);
  counts->u_max[face] = std::max(counts->u_max[face], bounds.u_max());
  counts->v_min[face] = std::min(counts->v_min[face], bounds.v_min);
  counts->v_max[face] = std::max(counts->v_max[face], bounds.v_max());
  counts->farthest[face] = std::max(counts->farthest[face], bounds.farthest);
}

/// Enters a packet in one row of cells.
HWY_INLINE void Enter(const Face& face, int row, const PacketBounds& bounds, uint32_t packet, uint32_t lanes,
                      PacketEntry* entry, uint32_t* histogram, float* row_reach) {
  const uint32_t cell = face.first_cell + ScalarColumn(face, row, bounds.u_min);
  static_assert(offsetof(PacketEntry, farthest) == offsetof(PacketBounds, farthest));
  std::memcpy(&entry->u_min, &bounds.u_min, 4 * sizeof(float));
  entry->farthest = bounds.farthest;
  entry->packet = packet;
  entry->cell = cell;
  entry->lanes = lanes;
  ++histogram[cell];
  float& reach = row_reach[face.first_row + static_cast<uint32_t>(row)];
  reach = std::max(reach, bounds.u_max() - bounds.u_min);
}

/// Whether these samples lie close enough together to be entered.
HWY_INLINE bool IsCompact(const Face& face, const PacketBounds& bounds) {
  const int first = ScalarSubrow(face, bounds.v_min) / kSubrows;
  const int last = ScalarSubrow(face, bounds.v_max()) / kSubrows;
  if (last - first >= kMostRowsOfPacket) return false;
  const float width = bounds.u_max() - bounds.u_min;
  for (int row = first; row <= last; ++row) {
    if (!(width * face.row_u_scale[static_cast<size_t>(row)] <= kMostColumnsOfPacket)) return false;
  }
  return true;
}

/// Enters some samples of a tile in the rows that they touch.
HWY_INLINE void EnterTile(const TileTask& task, const Face& face, int face_index, const PacketBounds& bounds,
                          uint32_t tile, uint32_t lanes, TileCounts* counts) {
  const int first = ScalarSubrow(face, bounds.v_min) / kSubrows;
  const int last = ScalarSubrow(face, bounds.v_max()) / kSubrows;
  for (int row = first; row <= last; ++row) {
    Enter(face, row, bounds, row > first ? tile | kRepeated : tile, lanes,
          &(*task.entries)[counts->entries++], task.histogram, task.row_reach);
  }
  counts->most_rows[face_index] = std::max(counts->most_rows[face_index], last - first + 1);
  AddBounds(bounds, face_index, counts);
}

/// Enters a tile that shows several surfaces, each for itself; false where there are too many.
HWY_NOINLINE bool EnterSurfaces(const TileTask& task, const Face& face, int face_index, const float* packet,
                                uint32_t tile, uint32_t present, TileCounts* counts) {
  HWY_ALIGN float u[kPacket], v[kPacket];
  for (int i = 0; i < kPacket; i += kLanes) {
    const VF r[3] = {hn::Load(df, packet + i), hn::Load(df, packet + kPacket + i),
                     hn::Load(df, packet + 2 * kPacket + i)};
    const PlaneCoordinates c = Project(task.frame->directional, face, r);
    hn::Store(c.u, df, u + i);
    hn::Store(c.v, df, v + i);
  }
  uint32_t surface[kMostSurfacesOfTile];
  PacketBounds bounds[kMostSurfacesOfTile];
  int count = 0;
  for (uint32_t left = present; left != 0; left &= ~surface[count++]) {
    if (count == kMostSurfacesOfTile) return false;
    // All that is within a cell or two of one sample.
    const int seed = std::countr_zero(left);
    const auto row = static_cast<size_t>(ScalarSubrow(face, v[seed]) / kSubrows);
    const float u_reach = 0.5f * kMostColumnsOfPacket / face.row_u_scale[row];
    const float v_reach = 0.8f * (face.row_v_high[row] - face.row_v_low[row]);
    uint32_t near = 0;
    for (int i = 0; i < kPacket; i += kLanes) {
      const MF near_u =
          hn::Le(hn::Abs(hn::Sub(hn::Load(df, u + i), hn::Set(df, u[seed]))), hn::Set(df, u_reach));
      const MF near_v =
          hn::Le(hn::Abs(hn::Sub(hn::Load(df, v + i), hn::Set(df, v[seed]))), hn::Set(df, v_reach));
      near |= BitsOf(hn::And(near_u, near_v)) << i;
    }
    surface[count] = (near & left) | 1u << seed;
    bounds[count] = BoundPacket(task.frame->directional, face, packet, surface[count]);
    if (!IsCompact(face, bounds[count])) return false;
  }
  for (int i = 0; i < count; ++i) EnterTile(task, face, face_index, bounds[i], tile, surface[i], counts);
  return true;
}

template <typename TileFunction>
HWY_INLINE void ForEachTile(const TileTask& task, const TileFunction& function) {
  for (int y = task.row_begin; y < task.row_end; ++y) {
    if (task.cancellation != nullptr && task.cancellation->Requested()) return;
    for (int x = 0; x < task.tiles_in_row; ++x) function(x, y);
  }
}

void SampleRaysImpl(const TileTask& task, int stride, std::vector<glm::vec3>* rays) {
  TileOffsets offsets;
  SetUpOffsets(task.layer->ray_from_pixel, &offsets);
  Tile tile;
  HWY_ALIGN float r[3][kLanes];
  for (int y = task.row_begin + stride / 2; y < task.row_end; y += stride) {
    for (int x = (y / stride % 2) * stride / 2; x < task.tiles_in_row; x += stride) {
      if (!ReadTile(*task.layer, x * kTileWidth, y * kTileHeight, &tile)) continue;
      const int first = kPacket / 2 / kLanes * kLanes;
      const Strip strip = LoadStrip(*task.frame, *task.layer, tile, offsets, first);
      for (int i = 0; i < 3; ++i) hn::Store(strip.r[i], df, r[i]);
      uint32_t bits = BitsOf(hn::AndNot(hn::Or(strip.outside_cone, strip.facing_away), strip.sample));
      bits &= 1u << (kLanes - 1) | 1u;  // Two stand for the tile.
      for (; bits != 0; bits &= bits - 1) {
        const int i = std::countr_zero(bits);
        rays->emplace_back(r[0][i], r[1][i], r[2][i]);
      }
    }
  }
}

void SetUpTilesImpl(const TileTask& task, TileCounts* counts) {
  const LightFrame& frame = *task.frame;
  const LayerSource& layer = *task.layer;
  const int face_count = task.single_face ? 1 : 6;
  TileOffsets offsets;
  SetUpOffsets(layer.ray_from_pixel, &offsets);
  Tile tile;
  ForEachTile(task, [&](int x, int y) HWY_ATTR {
    const size_t index = layer.first_tile + static_cast<size_t>(y) * static_cast<size_t>(task.tiles_in_row) +
                         static_cast<size_t>(x);
    uint32_t known = 0, known_shadow = 0;
    if (layer.known.bottom_row != nullptr) {
      uint8_t values[kPacket];
      LoadTile(layer.known, x * kTileWidth, y * kTileHeight, values, 0.0f);
      for (int i = 0; i < kPacket; ++i) {
        known |= static_cast<uint32_t>(values[i] != 0) << i;
        known_shadow |= static_cast<uint32_t>(values[i] == 2) << i;
      }
      counts->known += static_cast<size_t>(std::popcount(known));
      counts->samples += static_cast<size_t>(std::popcount(known));
    }
    if (known == 0xFFFFu || !ReadTile(layer, x * kTileWidth, y * kTileHeight, &tile)) {
      task.present[index] = 0;
      task.facing[index] = static_cast<uint16_t>(known_shadow);
      return;
    }
    float* packet = task.packets + index * kPacketFloats;
    uint32_t samples = 0, facing = 0, outside = 0, fits = 0;
    for (int i = 0; i < kPacket; i += kLanes) {
      const Strip strip = LoadStrip(frame, layer, tile, offsets, i);
      hn::Store(strip.r[0], df, packet + i);
      hn::Store(strip.r[1], df, packet + kPacket + i);
      hn::Store(strip.r[2], df, packet + 2 * kPacket + i);
      hn::Store(strip.error, df, packet + 3 * kPacket + i);
      samples |= BitsOf(strip.sample) << i;
      facing |= BitsOf(strip.facing_away) << i;
      outside |= BitsOf(strip.outside_cone) << i;
      if (task.single_face) fits |= BitsOf(FitsSingleFace(frame.directional, task.faces[0], strip.r)) << i;
    }
    samples &= ~known;
    facing &= ~known;
    outside &= ~known;
    const uint32_t present = samples & ~facing & ~outside;
    task.present[index] = static_cast<uint16_t>(present);
    task.facing[index] = static_cast<uint16_t>(facing | known_shadow);
    counts->samples += static_cast<size_t>(std::popcount(samples));
    counts->facing_away += static_cast<size_t>(std::popcount(facing));
    counts->outside_cone += static_cast<size_t>(std::popcount(outside));
    if (present == 0) return;
    const auto number = static_cast<uint32_t>(index);
    if (task.sort_all) {
      counts->off_face += task.single_face ? static_cast<size_t>(std::popcount(present & ~fits)) : 0;
      task.scattered->push_back(number);
      return;
    }
    if (counts->entries + kMostEntriesOfTile > task.entries->size()) {
      task.entries->resize(2 * task.entries->size() + 1024);
    }
    int f = 0;
    if (task.single_face) {
      if ((present & ~fits) != 0) {
        counts->off_face += static_cast<size_t>(std::popcount(present & ~fits));
        return;
      }
    } else {
      for (; f < face_count; ++f) {
        uint32_t on = 0;
        for (int i = 0; i < kPacket; i += kLanes) {
          const VF r[3] = {hn::Load(df, packet + i), hn::Load(df, packet + kPacket + i),
                           hn::Load(df, packet + 2 * kPacket + i)};
          on |= BitsOf(OnFace(task.faces[f], r)) << i;
        }
        if ((present & on) != 0) {
          if ((present & ~on) != 0) f = face_count;
          break;
        }
      }
    }
    if (f < face_count) {
      const PacketBounds bounds = BoundPacket(frame.directional, task.faces[f], packet, present);
      if (IsCompact(task.faces[f], bounds)) {
        EnterTile(task, task.faces[f], f, bounds, number, present, counts);
        return;
      }
      if (EnterSurfaces(task, task.faces[f], f, packet, number, present, counts)) return;
    }
    task.scattered->push_back(number);
  });
}

void BinSamplesImpl(const TileTask& task, std::span<const uint32_t> tiles, uint32_t none, uint32_t* cell,
                    uint32_t* rank, uint32_t* histogram, TileCounts* counts) {
  const int face_count = task.single_face ? 1 : 6;
  const bool directional = task.frame->directional;
  HWY_ALIGN uint32_t cells[kPacket];
  for (size_t t = 0; t < tiles.size(); ++t) {
    if (t % 256 == 0 && task.cancellation != nullptr && task.cancellation->Requested()) return;
    const float* packet = task.packets + size_t{tiles[t]} * kPacketFloats;
    const uint32_t present = task.present[tiles[t]];
    for (int i = 0; i < kPacket; i += kLanes) hn::Store(hn::Set(du, none), du, cells + i);
    for (int f = 0; f < face_count; ++f) {
      const Face& face = task.faces[f];
      uint32_t on = present;
      if (!task.single_face) {
        on = 0;
        for (int i = 0; i < kPacket; i += kLanes) {
          const VF r[3] = {hn::Load(df, packet + i), hn::Load(df, packet + kPacket + i),
                           hn::Load(df, packet + 2 * kPacket + i)};
          on |= BitsOf(OnFace(face, r)) << i;
        }
        on &= present;
      }
      if (on == 0) continue;
      AddBounds(BoundPacket(directional, face, packet, on), f, counts);
      for (int i = 0; i < kPacket; i += kLanes) {
        const VF r[3] = {hn::Load(df, packet + i), hn::Load(df, packet + kPacket + i),
                         hn::Load(df, packet + 2 * kPacket + i)};
        const auto lanes = hn::RebindMask(du, LanesOf(on >> i));
        const auto values = hn::BitCast(du, CellOf(face, Project(directional, face, r)));
        hn::Store(hn::IfThenElse(lanes, values, hn::Load(du, cells + i)), du, cells + i);
      }
    }
    std::memcpy(cell + t * kPacket, cells, sizeof(cells));
    uint32_t* ranks = rank + t * kPacket;
    for (int i = 0; i < kPacket; ++i) ranks[i] = histogram[cells[i]]++;
  }
}

void PlaceSamplesImpl(const TileTask& task, std::span<const uint32_t> tiles, uint32_t none,
                      const uint32_t* start, const uint32_t* rank, uint32_t scrap_place,
                      uint32_t* cell_to_place, float* sorted_packets) {
  for (size_t t = 0; t < tiles.size(); ++t) {
    if (t % 256 == 0 && task.cancellation != nullptr && task.cancellation->Requested()) return;
    const float* packet = task.packets + size_t{tiles[t]} * kPacketFloats;
    for (int i = 0; i < kPacket; i += kLanes) {
      auto* place_out = cell_to_place + t * kPacket + static_cast<size_t>(i);
      const auto cells = hn::LoadU(du, place_out);
      const auto absent = hn::Eq(cells, hn::Set(du, none));
      if (hn::AllTrue(du, absent)) {
        hn::StoreU(hn::Set(du, kNoPlace), du, place_out);
        continue;
      }
      const auto first = hn::GatherIndex(du, start, hn::BitCast(di, cells));
      const auto place = hn::Add(first, hn::LoadU(du, rank + t * kPacket + static_cast<size_t>(i)));
      hn::StoreU(hn::IfThenElse(absent, hn::Set(du, kNoPlace), place), du, place_out);
      const auto target = hn::IfThenElse(absent, hn::Set(du, scrap_place), place);
      // A sample's four numbers together, for its one line of memory to be fetched once.
      HWY_ALIGN uint32_t targets[kLanes];
      HWY_ALIGN float samples[4 * kLanes];
      hn::Store(target, du, targets);
      hn::StoreInterleaved4(hn::Load(df, packet + i), hn::Load(df, packet + kPacket + i),
                            hn::Load(df, packet + 2 * kPacket + i), hn::Load(df, packet + 3 * kPacket + i),
                            df, samples);
      const hn::FixedTag<float, 4> sample;
      for (int lane = 0; lane < kLanes; ++lane) {
        hn::Store(hn::Load(sample, samples + 4 * lane), sample, sorted_packets + size_t{4} * targets[lane]);
      }
    }
  }
}

void TransposePacketsImpl(float* packets, size_t count) {
  for (size_t p = 0; p < count; ++p) {
    float* packet = packets + p * kPacketFloats;
    VF rows[4][kPacket / kLanes];
    for (int i = 0; i < kPacket / kLanes; ++i) {
      hn::LoadInterleaved4(df, packet + 4 * i * kLanes, rows[0][i], rows[1][i], rows[2][i], rows[3][i]);
    }
    for (int row = 0; row < 4; ++row) {
      for (int i = 0; i < kPacket / kLanes; ++i) {
        hn::Store(rows[row][i], df, packet + row * kPacket + i * kLanes);
      }
    }
  }
}

size_t EnterPacketsImpl(const LightFrame& frame, const Face& face, int row, uint32_t begin, uint32_t end,
                        uint32_t first_sorted, const float* sorted_packets, const uint16_t* shadow,
                        PacketEntry* entries, uint32_t* histogram, float* row_reach) {
  size_t count = 0;
  for (uint32_t p = begin; p < end; ++p) {
    const float* packet = sorted_packets + static_cast<size_t>(p - first_sorted) * kPacketFloats;
    const uint32_t lanes = 0xFFFFu & ~uint32_t{shadow[p]};
    const PacketBounds bounds = BoundPacket(frame.directional, face, packet, lanes);
    Enter(face, row, bounds, p, lanes, &entries[count++], histogram, row_reach);
  }
  return count;
}

// ---------------------------------------------------------------------------------------------------------
// Triangles

/// Rows of a set-up block, each with one value a triangle; DeferredTriangle::values holds one column.
enum Row {
  kEdge = 0,       ///< Three edge normals, turned so that the inside is positive.
  kThreshold = 9,  ///< Inside means edge function > threshold.
  kPlane = 12,     ///< Plane normal, turned away from the light.
  kPlaneD = 15,    ///< A point is behind the plane where plane.r > plane_d.
  kPlaneLength = 16,
  kNearest = 17,    ///< Smallest w of the corners.
  kEnd = 18,        ///< Two planes through the light that close a sliver's ends.
  kEndMargin = 24,  ///< They may be passed by kEndMargin * (|x| + |y| + |z or kEndExtent|).
  kEndExtent = 26,
  kSpread = 27,  ///< Squared longest edge over area, as the light sees them.
  kRows = 28,
};
static_assert(kRows <= 32);

struct alignas(64) BlockSetup {
  float rows[kRows][kBlock];
  float r[3][3][kBlock];  ///< Corners in ray coordinates.
};

/// Slivers of a larger spread get planes that close their ends.
constexpr float kSliverSpread = 1024.0f;

struct Corner {
  VF r[3];
};

/// Corners in ray coordinates, single precision, for bounds. The difference to the origin is taken to nearly
/// twice single precision before it is rounded, so that the error is relative to the distance from the light.
HWY_INLINE void TransformBlock(const LightFrame& frame, const float* geometry, int offset,
                               Corner corners[3]) {
  for (int corner = 0; corner < 3; ++corner) {
    VF t[3];
    for (int i = 0; i < 3; ++i) {
      const float high = static_cast<float>(frame.ws_origin[i]);
      const auto low = static_cast<float>(frame.ws_origin[i] - static_cast<double>(high));
      const VF x = hn::Load(df, geometry + (3 * corner + i) * kBlock + offset);
      t[i] = hn::Sub(hn::Sub(x, hn::Set(df, high)), hn::Set(df, low));
    }
    for (int row = 0; row < 3; ++row) {
      const auto* m = frame.rotation[row];
      corners[corner].r[row] = hn::MulAdd(hn::Set(df, static_cast<float>(m[0])), t[0],
                                          hn::MulAdd(hn::Set(df, static_cast<float>(m[1])), t[1],
                                                     hn::Mul(hn::Set(df, static_cast<float>(m[2])), t[2])));
    }
  }
}

/// ay bz - az by. Not fused, so that exchanging a and b changes nothing but the sign.
HWY_INLINE VD Cross(VD ay, VD bz, VD az, VD by) { return hn::Sub(hn::Mul(ay, bz), hn::Mul(az, by)); }

/// Edge functions and plane of kLanes triangles, in double precision and then rounded once.
///
/// The triangle blocks the sample at r where r lies in the cone of its corners, det(v_i, v_j, r) > 0 for all
/// three edges after turning them so that det(a,b,c) > 0, and behind its plane, n.r > n.a. The computed v_i x
/// v_j is exactly the opposite of v_j x v_i, so that two triangles with a common edge compute the same
/// function of r but for its sign, and no sample falls between them. Because all is exact to double precision
/// before it is rounded, errors are relative to the sample's distance from the light, however far away the
/// corners are. A sample exactly on the edge belongs to the triangle whose edge normal is lexicographically
/// positive. Everything is scaled by a power of two per triangle: sums of corners near the light and far away
/// neither over- nor underflow, and signs do not change.
///
/// Returns the lanes that can block anything: not degenerate as the light sees them.
template <bool kDirectional>
HWY_NOINLINE uint32_t SetUpBlock(const LightFrame& frame, const float* geometry, const Corner corners[3],
                                 int offset, BlockSetup* setup) {
  // 1. A power of two that brings the largest coordinate near one.
  VF size = hn::Zero(df);
  for (int corner = 0; corner < 3; ++corner) {
    for (int i = 0; i < 3; ++i) size = hn::Add(size, hn::Abs(corners[corner].r[i]));
  }
  const auto exponent = hn::And(hn::BitCast(du, size), hn::Set(du, 0x7F800000u));
  const VF scale = hn::BitCast(df, hn::Sub(hn::Set(du, 254u << 23), exponent));
  const VF inverse_scale = hn::BitCast(df, exponent);

  // 2. Edge normals, plane and determinant in double.
  HWY_ALIGN float valid[kLanes];
  HWY_ALIGN float determinant[kLanes];
  for (int half = 0; half < 2; ++half) {
    const auto promote = [half](VF v) {
      return hn::PromoteTo(dd, half == 0 ? hn::LowerHalf(dh, v) : hn::UpperHalf(dh, v));
    };
    const VD s = promote(scale);
    const VD inverse_s = promote(inverse_scale);
    VD v[3][3];
    for (int corner = 0; corner < 3; ++corner) {
      VD t[3];
      for (int i = 0; i < 3; ++i) {
        const VD x = promote(hn::Load(df, geometry + (3 * corner + i) * kBlock + offset));
        t[i] = hn::Mul(hn::Sub(x, hn::Set(dd, frame.ws_origin[i])), s);
      }
      for (int row = 0; row < 3; ++row) {
        const double* m = frame.rotation[row];
        v[corner][row] = hn::MulAdd(hn::Set(dd, m[0]), t[0],
                                    hn::MulAdd(hn::Set(dd, m[1]), t[1], hn::Mul(hn::Set(dd, m[2]), t[2])));
      }
    }
    VD e1[3], e2[3], plane[3];
    VD e1_size = hn::Zero(dd), e2_size = hn::Zero(dd), a_size = hn::Zero(dd);
    for (int i = 0; i < 3; ++i) {
      e1[i] = hn::Sub(v[1][i], v[0][i]);
      e2[i] = hn::Sub(v[2][i], v[0][i]);
      e1_size = hn::Max(e1_size, hn::Abs(e1[i]));
      e2_size = hn::Max(e2_size, hn::Abs(e2[i]));
      a_size = hn::Max(a_size, hn::Abs(v[0][i]));
    }
    for (int i = 0; i < 3; ++i) {
      plane[i] = Cross(e1[(i + 1) % 3], e2[(i + 2) % 3], e1[(i + 2) % 3], e2[(i + 1) % 3]);
    }
    const VD plane_d =
        hn::MulAdd(plane[0], v[0][0], hn::MulAdd(plane[1], v[0][1], hn::Mul(plane[2], v[0][2])));
    // det(a,b,c) = n.a, or the signed area along a directional light's rays; where rounding could have made
    // it, the light sees the triangle edge-on and no ray passes through it.
    const VD det = kDirectional ? plane[2] : plane_d;
    // Coordinates carry errors of a few 2^-53 after rotation, the cross product some more of its own.
    VD uncertainty = hn::MulAdd(hn::Mul(e1_size, e2_size), hn::Set(dd, 0x1p-46),
                                hn::Mul(hn::Max(e1_size, e2_size), hn::Set(dd, 0x1p-48)));
    if constexpr (!kDirectional) uncertainty = hn::Mul(uncertainty, a_size);
    const VD turn = hn::CopySign(hn::Set(dd, 1.0), det);
    const auto ok = hn::Gt(hn::Abs(det), uncertainty);
    const int at = offset + half * kLanes / 2;
    hn::Store(hn::DemoteTo(dh, hn::IfThenElseZero(ok, hn::Set(dd, 1.0))), dh, valid + half * kLanes / 2);
    hn::Store(hn::DemoteTo(dh, hn::Abs(det)), dh, determinant + half * kLanes / 2);
    for (int i = 0; i < 3; ++i) {
      hn::Store(hn::DemoteTo(dh, hn::Mul(plane[i], turn)), dh, &setup->rows[kPlane + i][at]);
    }
    hn::Store(hn::DemoteTo(dh, hn::Mul(hn::Mul(plane_d, turn), inverse_s)), dh, &setup->rows[kPlaneD][at]);
    for (int edge = 0; edge < 3; ++edge) {
      const VD* a = v[edge];
      const VD* b = v[(edge + 1) % 3];
      VD n[3];
      if constexpr (kDirectional) {
        n[0] = hn::Sub(a[1], b[1]);
        n[1] = hn::Sub(b[0], a[0]);
        n[2] = hn::Mul(Cross(a[0], b[1], a[1], b[0]), inverse_s);
      } else {
        for (int i = 0; i < 3; ++i) {
          n[i] = Cross(a[(i + 1) % 3], b[(i + 2) % 3], a[(i + 2) % 3], b[(i + 1) % 3]);
        }
      }
      for (int i = 0; i < 3; ++i) {
        hn::Store(hn::DemoteTo(dh, hn::Mul(n[i], turn)), dh, &setup->rows[kEdge + 3 * edge + i][at]);
      }
    }
  }

  // 3. What single precision suffices for.
  const auto row = [setup, offset](int index) { return hn::Load(df, &setup->rows[index][offset]); };
  const auto store = [setup, offset](VF v, int index) { hn::Store(v, df, &setup->rows[index][offset]); };
  const VF zero = hn::Zero(df);
  VF edge_length2[3];
  for (int edge = 0; edge < 3; ++edge) {
    const VF n[3] = {row(kEdge + 3 * edge), row(kEdge + 3 * edge + 1), row(kEdge + 3 * edge + 2)};
    const MF positive =
        hn::Or(hn::Gt(n[0], zero),
               hn::And(hn::Eq(n[0], zero),
                       hn::Or(hn::Gt(n[1], zero), hn::And(hn::Eq(n[1], zero), hn::Gt(n[2], zero)))));
    store(hn::IfThenElseZero(positive, hn::Set(df, -std::numeric_limits<float>::min())), kThreshold + edge);
    edge_length2[edge] = hn::MulAdd(n[0], n[0], hn::Mul(n[1], n[1]));
    if constexpr (!kDirectional) edge_length2[edge] = hn::MulAdd(n[2], n[2], edge_length2[edge]);
  }
  const VF p[3] = {row(kPlane), row(kPlane + 1), row(kPlane + 2)};
  store(hn::Sqrt(hn::MulAdd(p[0], p[0], hn::MulAdd(p[1], p[1], hn::Mul(p[2], p[2])))), kPlaneLength);

  // Spread: squared longest edge over twice the area, of directions (point) or in the plane (directional).
  // Rounding moves an edge by a few units of 2^-24, and the tip between two edges by that times the spread.
  const VF area = hn::Load(df, determinant);
  VF longest2 = zero;
  VF spread;
  if constexpr (kDirectional) {
    for (int edge = 0; edge < 3; ++edge) longest2 = hn::Max(longest2, edge_length2[edge]);
    spread = hn::Div(longest2, area);
  } else {
    VF length2[3];
    for (int corner = 0; corner < 3; ++corner) {
      length2[corner] = zero;
      for (int i = 0; i < 3; ++i) {
        const VF scaled = hn::Mul(corners[corner].r[i], scale);
        length2[corner] = hn::MulAdd(scaled, scaled, length2[corner]);
      }
    }
    for (int edge = 0; edge < 3; ++edge) {
      const int a = edge, b = (edge + 1) % 3;
      VF cosine = zero;
      for (int i = 0; i < 3; ++i) cosine = hn::MulAdd(corners[a].r[i], corners[b].r[i], cosine);
      const VF sine2 = hn::Div(edge_length2[edge], hn::Mul(length2[a], length2[b]));
      longest2 = hn::Max(longest2, hn::IfThenElse(hn::Gt(cosine, zero), sine2, hn::Set(df, 4.0f)));
    }
    spread = hn::Div(hn::Mul(longest2, hn::Sqrt(hn::Mul(hn::Mul(length2[0], length2[1]), length2[2]))), area);
  }
  store(spread, kSpread);
  for (int corner = 0; corner < 3; ++corner) {
    for (int i = 0; i < 3; ++i) hn::Store(corners[corner].r[i], df, &setup->r[corner][i][offset]);
  }
  return BitsOf(hn::And(hn::Gt(hn::Load(df, valid), zero), hn::Lt(size, hn::Set(df, 1e37f))));
}

/// Planes that close the ends of a sliver's longest edge. Its edge functions are all rounding noise on the
/// line beyond its tips, far from the triangle; the planes keep the answer independent of which samples are
/// tried. With m = v_i x v_j: (m x v_i).r >= 0 beyond v_i, (v_j x m).r >= 0 before v_j.
HWY_NOINLINE void SetUpEnds(bool directional, int lane, BlockSetup* setup) {
  const auto corner = [setup, lane](int i) {
    return glm::dvec3(setup->r[i][0][lane], setup->r[i][1][lane], setup->r[i][2][lane]);
  };
  double longest2 = -1.0;
  int longest = 0;
  for (int edge = 0; edge < 3; ++edge) {
    const glm::dvec3 a = corner(edge), b = corner((edge + 1) % 3);
    if (directional) {
      const glm::dvec2 d = glm::dvec2(b) - glm::dvec2(a);
      if (glm::dot(d, d) > longest2) longest2 = glm::dot(d, d), longest = edge;
    } else {
      const glm::dvec3 ua = glm::normalize(a), ub = glm::normalize(b);
      const glm::dvec3 chord = ub - ua;
      if (glm::dot(chord, chord) > longest2) longest2 = glm::dot(chord, chord), longest = edge;
    }
  }
  const glm::dvec3 a = corner(longest), b = corner((longest + 1) % 3);
  glm::dvec3 ends[2];
  double extent = 0.0;
  if (directional) {
    const glm::dvec2 t = glm::normalize(glm::dvec2(b) - glm::dvec2(a));
    ends[0] = glm::dvec3(t, -glm::dot(t, glm::dvec2(a)));
    ends[1] = glm::dvec3(-t, glm::dot(t, glm::dvec2(b)));
    extent = std::max({std::abs(a.x), std::abs(a.y), std::abs(b.x), std::abs(b.y)});
  } else {
    const glm::dvec3 m = glm::normalize(glm::cross(glm::normalize(a), glm::normalize(b)));
    ends[0] = glm::cross(m, glm::normalize(a));
    ends[1] = glm::cross(glm::normalize(b), m);
    // Corners all around the light are nearly coplanar with it too, but see almost a hemisphere: nothing to
    // close.
    const glm::dvec3 c = glm::normalize(corner((longest + 2) % 3));
    if (!(glm::dot(ends[0], c) >= -1e-6 && glm::dot(ends[1], c) >= -1e-6)) {
      ends[0] = ends[1] = glm::dvec3(0.0);
    }
  }
  for (int end = 0; end < 2; ++end) {
    for (int i = 0; i < 3; ++i) setup->rows[kEnd + 3 * end + i][lane] = static_cast<float>(ends[end][i]);
    setup->rows[kEndMargin + end][lane] = 32.0f * kUnitRoundoff;
  }
  setup->rows[kEndExtent][lane] = static_cast<float>(extent);
}

/// Triangles of a set-up block, as the tests of packets read them.
struct Triangles {
  const float* rows;  ///< Row k of triangle i is rows[k * kBlock + i].
  const float* uv;    ///< Row k of its texture coordinates is uv[k * kBlock + i]; may be null.
  const Caster* caster;
  int axis;  ///< Of w among the ray coordinates, and its sign.
  float sign;
  uint32_t slivers = 0;  ///< Bit per triangle.
};

HWY_INLINE Triangles TrianglesOf(const LightFrame& frame, const Face& face, const BlockSetup& setup,
                                 const Caster* caster, const float* uv) {
  return {&setup.rows[0][0], uv, caster, frame.directional ? 2 : face.axis,
          frame.directional ? 1.0f : face.sign};
}

HWY_INLINE VF Broadcast(const float* triangle, int row) { return hn::Set(df, triangle[row * kBlock]); }

HWY_INLINE const float* PacketFloats(const MaskState& state, uint32_t packet) {
  return state.packets[packet >= state.first_sorted] + static_cast<size_t>(packet) * kPacketFloats;
}

/// Of the lanes in `bits`, those where the cutout's texture is opaque.
template <bool kDirectional>
HWY_NOINLINE uint32_t OpaqueLanes(const Triangles& t, int triangle, const float* packet, uint32_t bits) {
  uint32_t opaque = 0;
  for (uint32_t left = bits; left != 0; left &= left - 1) {
    const int i = std::countr_zero(left);
    const float r[3] = {packet[i], packet[kPacket + i], kDirectional ? 1.0f : packet[2 * kPacket + i]};
    // r is a combination of the corners with the opposite edges' functions as weights, so that these are the
    // barycentric coordinates of the hit in space, without any perspective correction.
    float weight[3];
    float sum = 0.0f;
    for (int corner = 0; corner < 3; ++corner) {
      const int edge = (corner + 1) % 3;
      float e = 0.0f;
      for (int k = 0; k < 3; ++k) e += t.rows[(kEdge + 3 * edge + k) * kBlock + triangle] * r[k];
      weight[corner] = std::max(e, 0.0f);
      sum += weight[corner];
    }
    glm::vec2 uv(0.0f);
    for (int corner = 0; corner < 3; ++corner) {
      const float b = sum > 0.0f ? weight[corner] / sum : 1.0f / 3.0f;
      uv += b * glm::vec2(t.uv[(2 * corner) * kBlock + triangle], t.uv[(2 * corner + 1) * kBlock + triangle]);
    }
    if (t.caster->alpha->AlphaAt(uv) >= t.caster->alpha_cutoff) opaque |= 1u << i;
  }
  return opaque;
}

HWY_INLINE void Absorb(const MaskState& state, const Caster& caster, uint32_t packet, uint32_t bits) {
  std::atomic_ref<uint8_t> lock(state.packet_lock[packet]);
  while (lock.exchange(1, std::memory_order_acquire) != 0) {
  }
  uint32_t* sums = state.absorbance + static_cast<size_t>(packet) * state.channels * kPacket;
  uint8_t bytes[8] = {};
  for (int i = 0; i < kPacket; i += kLanes) {
    const uint32_t lane_bits = bits >> i;
    std::memcpy(bytes, &lane_bits, sizeof(lane_bits));
    const auto mask = hn::LoadMaskBits(du, bytes);
    for (size_t channel = 0; channel < state.channels; ++channel) {
      uint32_t* sum = sums + channel * kPacket + i;
      const auto more = hn::IfThenElseZero(mask, hn::Set(du, caster.absorbance[channel]));
      hn::Store(hn::Min(hn::Add(hn::Load(du, sum), more), hn::Set(du, kAbsorbanceMax)), du, sum);
    }
  }
  lock.store(0, std::memory_order_release);
}

HWY_INLINE uint32_t LoadBits(uint16_t& word) {
  return std::atomic_ref<uint16_t>(word).load(std::memory_order_relaxed);
}

/// Returns what was set before. A thread that has its words for itself needs no locked instruction.
HWY_INLINE uint32_t SetBits(bool shared, uint16_t& word, uint32_t bits) {
  std::atomic_ref<uint16_t> atomic(word);
  if (shared) return atomic.fetch_or(static_cast<uint16_t>(bits), std::memory_order_relaxed);
  const uint32_t old = atomic.load(std::memory_order_relaxed);
  atomic.store(static_cast<uint16_t>(old | bits), std::memory_order_relaxed);
  return old;
}

/// Relaxed atomics suffice: bits are only ever set, and are read after the threads have joined, or earlier
/// only to skip work that could not change them.
template <bool kDirectional>
HWY_INLINE void Record(const MaskState& state, const Triangles& t, int triangle, uint32_t packet,
                       const float* values, uint32_t behind, uint32_t on) {
  if (t.caster->alpha != nullptr) {
    if ((behind | on) == 0) return;
    const uint32_t opaque = OpaqueLanes<kDirectional>(t, triangle, values, behind | on);
    behind &= opaque;
    on &= opaque;
  }
  if (t.caster->transmits) {
    if (behind != 0) Absorb(state, *t.caster, packet, behind);
  } else {
    SetBits(state.shared, state.shadow[packet], behind);
  }
  if (on != 0) {
    const uint32_t again = SetBits(state.shared, state.touched[packet], on) & on;
    if (again != 0) SetBits(state.shared, state.touched_twice[packet], again);
  }
}

HWY_INLINE MF BetweenEnds(const float* triangle, bool directional, VF x, VF y, VF z) {
  const VF reach =
      hn::Add(hn::Add(hn::Abs(x), hn::Abs(y)), directional ? Broadcast(triangle, kEndExtent) : hn::Abs(z));
  MF between = hn::Eq(x, x);
  for (int end = 0; end < 2; ++end) {
    const int n = kEnd + 3 * end;
    const VF third = Broadcast(triangle, n + 2);
    const VF e =
        hn::MulAdd(Broadcast(triangle, n), x,
                   hn::MulAdd(Broadcast(triangle, n + 1), y, directional ? third : hn::Mul(third, z)));
    between =
        hn::And(between, hn::Ge(hn::MulAdd(Broadcast(triangle, kEndMargin + end), reach, e), hn::Zero(df)));
  }
  return between;
}

/// The samples of a packet that lie in the cone of a triangle's corners.
template <bool kDirectional>
HWY_INLINE uint32_t InsideEdges(const float* triangle, const float* values) {
  uint32_t bits = 0;
  for (int i = 0; i < kPacket; i += kLanes) {
    const VF x = hn::Load(df, values + i);
    const VF y = hn::Load(df, values + kPacket + i);
    const VF z = hn::Load(df, values + 2 * kPacket + i);
    const auto inside_edge = [&](int edge) HWY_ATTR {
      const int n = kEdge + 3 * edge;
      const VF third = kDirectional ? Broadcast(triangle, n + 2) : hn::Mul(Broadcast(triangle, n + 2), z);
      const VF e = hn::MulAdd(Broadcast(triangle, n), x, hn::MulAdd(Broadcast(triangle, n + 1), y, third));
      return hn::Gt(e, Broadcast(triangle, kThreshold + edge));
    };
    bits |= BitsOf(hn::And(hn::And(inside_edge(0), inside_edge(1)), inside_edge(2))) << i;
  }
  return bits;
}

/// Of the samples in `inside`, which lie in the cone of the corners: are they behind the triangle?
template <bool kDirectional>
HWY_INLINE void TestPlane(const MaskState& state, const Triangles& t, int triangle, uint32_t packet,
                          const float* values, uint32_t inside) {
  const float* column = t.rows + triangle;
  uint32_t behind = 0, on = 0;
  for (int i = 0; i < kPacket; i += kLanes) {
    const VF x = hn::Load(df, values + i);
    const VF y = hn::Load(df, values + kPacket + i);
    const VF z = hn::Load(df, values + 2 * kPacket + i);
    // The test of an entry's farthest sample, for each: so that the answer does not depend on the packet.
    const VF w = hn::Mul(hn::Load(df, values + t.axis * kPacket + i), hn::Set(df, t.sign));
    MF lanes = hn::Ge(w, Broadcast(column, kNearest));
    if ((t.slivers >> triangle & 1u) != 0) {
      lanes = hn::And(lanes, BetweenEnds(column, kDirectional, x, y, z));
    }
    const VF height = hn::Sub(
        hn::MulAdd(Broadcast(column, kPlane), x,
                   hn::MulAdd(Broadcast(column, kPlane + 1), y, hn::Mul(Broadcast(column, kPlane + 2), z))),
        Broadcast(column, kPlaneD));
    const VF bound = hn::Mul(Broadcast(column, kPlaneLength), hn::Load(df, values + 3 * kPacket + i));
    behind |= BitsOf(hn::And(lanes, hn::Gt(height, bound))) << i;
    on |= BitsOf(hn::And(lanes, hn::Le(hn::Abs(height), bound))) << i;
  }
  Record<kDirectional>(state, t, triangle, packet, values, behind & inside, on & inside);
}

/// A convex polygon in plane coordinates of a face, which encloses what the triangle covers of it.
struct Outline {
  float u[8], v[8];
  int corners;
  float pad_u, pad_v;  ///< By how much rounding may move a sample against it.
  float u_min, u_max, v_min, v_max;
};

/// Padded largest u and v, and negated smallest: what entries must not exceed.
struct Reach {
  float u, v, minus_u, minus_v;
  float nearest;
};

HWY_INLINE Reach ReachOf(const Outline& o, float nearest) {
  return {o.u_max + o.pad_u, o.v_max + o.pad_v, o.pad_u - o.u_min, o.pad_v - o.v_min, nearest};
}

HWY_INLINE void MeasureOutline(Outline* o) {
  o->u_min = o->v_min = kInfinity;
  o->u_max = o->v_max = -kInfinity;
  for (int i = 0; i < o->corners; ++i) {
    o->u_min = std::min(o->u_min, o->u[i]);
    o->u_max = std::max(o->u_max, o->u[i]);
    o->v_min = std::min(o->v_min, o->v[i]);
    o->v_max = std::max(o->v_max, o->v[i]);
  }
}

/// Every packet of a run of sorted samples.
template <bool kDirectional>
HWY_INLINE void TestRun(const MaskState& state, const Triangles& t, int triangle, uint32_t first,
                        uint32_t end) {
  if (first >= end) return;
  for (uint32_t p = first / kPacket; p <= (end - 1) / kPacket; ++p) {
    const uint32_t live = 0xFFFFu & ~LoadBits(state.shadow[p]);
    if (live == 0) continue;
    const float* values = PacketFloats(state, p);
    const uint32_t inside = InsideEdges<kDirectional>(t.rows + triangle, values) & live;
    if (inside != 0) TestPlane<kDirectional>(state, t, triangle, p, values, inside);
  }
}

/// Runs of entries, row by row, that a block of triangles may meet.
struct BlockRuns {
  static constexpr int kMostRows = 8;
  uint32_t first[kMostRows], end[kMostRows];
  int count = 0;
};

/// False where there are so many that looking at each triangle alone is quicker.
HWY_INLINE bool FindBlockRuns(const MaskState& state, const Face& face, MF lanes, uint32_t triangles, VF u,
                              VF v, VF minus_u, VF minus_v, BlockRuns* runs) {
  constexpr uint32_t kEntriesOfTriangle = 8;
  const VF low = hn::Set(df, -kInfinity);
  float most[4];
  ReduceFour(hn::IfThenElse(lanes, u, low), hn::IfThenElse(lanes, v, low),
             hn::IfThenElse(lanes, minus_u, low), hn::IfThenElse(lanes, minus_v, low), Larger(), most);
  const float u_high = most[0], v_high = most[1], u_low = -most[2], v_low = -most[3];
  const int first_row = ScalarSubrow(face, v_low) / kSubrows;
  const int last_row = ScalarSubrow(face, v_high) / kSubrows;
  if (last_row - first_row >= BlockRuns::kMostRows) return false;
  const uint32_t* starts = state.cell_start + face.first_cell;
  uint32_t entries = 0;
  for (int row = first_row; row <= last_row; ++row) {
    const uint32_t first = starts[ScalarColumn(face, row, u_low - face.row_reach[static_cast<size_t>(row)])];
    const uint32_t end = starts[ScalarColumn(face, row, u_high) + 1];
    runs->first[runs->count] = first;
    runs->end[runs->count++] = end;
    entries += end - first;
  }
  return entries <= kEntriesOfTriangle * triangles;
}

/// Collects pairs of triangle and entry whose bounds overlap and tests them later, in steps that have few
/// branches to foretell, and with the loads of the next packets under way.
template <bool kDirectional>
class PairQueue {
 public:
  PairQueue(const MaskState& state, const Triangles& triangles) : state_(state), triangles_(triangles) {}

  /// Entries [first, end) of one row, but for those with a flag in `unwanted`, against a triangle.
  HWY_INLINE void Add(int triangle, const Reach& reach, uint32_t first, uint32_t end, uint32_t unwanted) {
    const EntryArrays entries = state_.entries;
    const auto numbers =
        hn::Or(hn::ShiftLeft<kTriangleBits>(hn::Iota(du, 0)), hn::Set(du, static_cast<uint32_t>(triangle)));
    for (uint32_t e = first; e < end; e += kLanes) {
      MF keep = hn::FirstN(df, std::min<size_t>(end - e, kLanes));
      keep = hn::And(keep, hn::Le(hn::LoadU(df, entries.u_min + e), hn::Set(df, reach.u)));
      keep = hn::And(keep, hn::Le(hn::LoadU(df, entries.v_min + e), hn::Set(df, reach.v)));
      keep = hn::And(keep, hn::Le(hn::LoadU(df, entries.minus_u_max + e), hn::Set(df, reach.minus_u)));
      keep = hn::And(keep, hn::Le(hn::LoadU(df, entries.minus_v_max + e), hn::Set(df, reach.minus_v)));
      keep = hn::And(keep, hn::Ge(hn::LoadU(df, entries.farthest + e), hn::Set(df, reach.nearest)));
      const auto wanted =
          hn::Eq(hn::And(hn::LoadU(du, entries.packet + e), hn::Set(du, unwanted)), hn::Zero(du));
      keep = hn::And(keep, hn::RebindMask(df, wanted));
      Push(hn::Add(numbers, hn::Set(du, e << kTriangleBits)), keep, ~0u);
    }
  }

  /// Entries of runs against the triangles in `lanes`, the first of which is number `offset`; each has the
  /// reach of its lane.
  HWY_INLINE void AddBlock(int offset, const BlockRuns& runs, MF lanes, VF u, VF v, VF minus_u, VF minus_v,
                           VF nearest) {
    const EntryArrays entries = state_.entries;
    u = hn::IfThenElse(lanes, u, hn::Set(df, -kInfinity));
    const auto numbers = hn::Add(hn::Iota(du, 0), hn::Set(du, static_cast<uint32_t>(offset)));
    uint32_t unwanted = 0;
    for (int run = 0; run < runs.count; ++run, unwanted = kRepeated) {
      for (uint32_t e = runs.first[run]; e < runs.end[run]; ++e) {
        MF keep = hn::Ge(u, hn::Set(df, entries.u_min[e]));
        keep = hn::And(keep, hn::Ge(v, hn::Set(df, entries.v_min[e])));
        keep = hn::And(keep, hn::Ge(minus_u, hn::Set(df, entries.minus_u_max[e])));
        keep = hn::And(keep, hn::Ge(minus_v, hn::Set(df, entries.minus_v_max[e])));
        keep = hn::And(keep, hn::Le(nearest, hn::Set(df, entries.farthest[e])));
        const uint32_t packet = entries.packet[e];
        const uint32_t live = entries.lanes[e] & ~LoadBits(state_.shadow[packet & ~kRepeated]);
        Push(hn::Or(numbers, hn::Set(du, e << kTriangleBits)), keep,
             (packet & unwanted) == 0 && live != 0 ? ~0u : 0u);
      }
    }
  }

  HWY_INLINE void Flush() {
    if (count_ > 0) Test();
    count_ = 0;
  }

 private:
  /// A pair is an entry's number times kBlock plus the triangle's in its block. There are at most
  /// kMostEntriesOfTile entries a tile, and 2^24 tiles.
  static constexpr int kTriangleBits = 4;
  static_assert(kBlock == 1 << kTriangleBits);
  static constexpr uint32_t kCapacity = 128;
  static constexpr uint32_t kAhead = 6;

  /// Kept or not is hard to foretell: no branch.
  HWY_INLINE void Push(hn::Vec<DU> pairs, MF keep, uint32_t all) {
    const uint32_t bits = BitsOf(keep) & all;
    hn::StoreU(hn::Compress(pairs, hn::RebindMask(du, keep)), du, pairs_ + count_);
    count_ += static_cast<uint32_t>(std::popcount(bits));
    if (count_ > kCapacity) Flush();
  }

  HWY_INLINE uint32_t PacketOf(uint32_t pair) const {
    return state_.entries.packet[pair >> kTriangleBits] & ~kRepeated;
  }

  HWY_INLINE void Prefetch(uint32_t pair) const {
    const float* values = PacketFloats(state_, PacketOf(pair));
    for (int row = 0; row < 3; ++row) hwy::Prefetch(values + row * kPacket);
  }

  HWY_NOINLINE void Test() {
    // 1. Which pairs have a sample inside the edges.
    struct Hit {
      uint32_t packet;
      uint16_t inside;
      uint16_t triangle;
    };
    Hit hits[kCapacity + kLanes];
    uint32_t hit_count = 0;
    const uint32_t count = count_;
    std::fill_n(pairs_ + count, kAhead, pairs_[count - 1]);
    for (uint32_t i = 0; i < std::min(kAhead, count); ++i) Prefetch(pairs_[i]);
    for (uint32_t i = 0; i < count; ++i) {
      Prefetch(pairs_[i + kAhead]);
      const uint32_t pair = pairs_[i];
      const uint32_t packet = PacketOf(pair);
      const uint32_t triangle = pair % kBlock;
      const uint32_t live = state_.entries.lanes[pair >> kTriangleBits] & ~LoadBits(state_.shadow[packet]);
      const uint32_t inside =
          InsideEdges<kDirectional>(triangles_.rows + triangle, PacketFloats(state_, packet)) & live;
      // Its bounds of error, which only the second step reads.
      const float* values = PacketFloats(state_, packet);
      hwy::Prefetch(inside != 0 ? values + 3 * kPacket : values);
      hits[hit_count] = {packet, static_cast<uint16_t>(inside), static_cast<uint16_t>(triangle)};
      hit_count += static_cast<uint32_t>(inside != 0);
    }
    // 2. Where those samples are.
    for (uint32_t i = 0; i < hit_count; ++i) {
      TestPlane<kDirectional>(state_, triangles_, hits[i].triangle, hits[i].packet,
                              PacketFloats(state_, hits[i].packet), hits[i].inside);
    }
  }

  const MaskState& state_;
  const Triangles& triangles_;
  uint32_t pairs_[kCapacity + 2 * kPacket];
  uint32_t count_ = 0;
};

/// Rows [row_begin, row_end) of a larger outline, whose first row is first_row: the range of u that it covers
/// in each row, kLanes rows at a time. In the slab of a row the extremes are at corners inside it and where
/// edges cross its two borders. A packet in several rows is looked at in the first of them that belongs to
/// the outline, whose slab therefore reaches as far up as packets may.
template <bool kDirectional>
HWY_NOINLINE void TestRows(const MaskState& state, int triangle, float nearest, const Face& face,
                           const Outline& o, int first_row, int row_begin, int row_end,
                           PairQueue<kDirectional>* queue) {
  const Reach box = ReachOf(o, nearest);
  struct Edge {
    float u, v, v_end, slope;
  };
  Edge edges[8];
  int edge_count = 0;
  for (int i = 0; i < o.corners; ++i) {
    const int j = (i + 1) % o.corners;
    const int low = o.v[i] <= o.v[j] ? i : j;
    const int high = low == i ? j : i;
    if (!(o.v[low] < o.v[high])) continue;
    edges[edge_count++] = {o.u[low], o.v[low], o.v[high], (o.u[high] - o.u[low]) / (o.v[high] - o.v[low])};
  }
  HWY_ALIGN int32_t first[kLanes], last[kLanes];
  HWY_ALIGN float span[kLanes];
  for (int row = row_begin; row < row_end; row += kLanes) {
    const VF slab_low =
        hn::Sub(hn::LoadU(df, &face.row_v_low[static_cast<size_t>(row)]), hn::Set(df, o.pad_v));
    const auto top_row = static_cast<size_t>(row + face.most_rows_of_packet - 1);
    const VF slab_high = hn::Add(hn::LoadU(df, &face.row_v_high[top_row]), hn::Set(df, o.pad_v));
    VF low = hn::Set(df, kInfinity);
    VF high = hn::Set(df, -kInfinity);
    for (int i = 0; i < o.corners; ++i) {
      const VF u = hn::Set(df, o.u[i]);
      const VF v = hn::Set(df, o.v[i]);
      const MF inside = hn::And(hn::Ge(v, slab_low), hn::Le(v, slab_high));
      low = hn::IfThenElse(inside, hn::Min(low, u), low);
      high = hn::IfThenElse(inside, hn::Max(high, u), high);
    }
    for (int i = 0; i < edge_count; ++i) {
      const Edge& edge = edges[i];
      for (const VF border : {slab_low, slab_high}) {
        const MF crosses =
            hn::And(hn::Gt(border, hn::Set(df, edge.v)), hn::Lt(border, hn::Set(df, edge.v_end)));
        const VF u =
            hn::MulAdd(hn::Sub(border, hn::Set(df, edge.v)), hn::Set(df, edge.slope), hn::Set(df, edge.u));
        low = hn::IfThenElse(crosses, hn::Min(low, u), low);
        high = hn::IfThenElse(crosses, hn::Max(high, u), high);
      }
    }
    const VF origin = hn::LoadU(df, &face.row_u_origin[static_cast<size_t>(row)]);
    const VF scale = hn::LoadU(df, &face.row_u_scale[static_cast<size_t>(row)]);
    const VF pad = hn::Set(df, o.pad_u);
    const VF reach = hn::LoadU(df, &face.row_reach[static_cast<size_t>(row)]);
    hn::Store(hn::Sub(high, low), df, span);
    hn::Store(
        ClampedInt(hn::Mul(hn::Sub(hn::Sub(hn::Sub(low, pad), reach), origin), scale), face.columns - 1), di,
        first);
    hn::Store(ClampedInt(hn::Mul(hn::Sub(hn::Add(high, pad), origin), scale), face.columns - 1), di, last);
    for (int i = 0; i < std::min(kLanes, row_end - row); ++i) {
      if (!(span[i] >= 0.0f)) continue;
      const auto row_columns = static_cast<uint32_t>(row + i) * static_cast<uint32_t>(face.columns);
      const uint32_t* starts = state.cell_start + face.first_cell;
      queue->Add(triangle, box, starts[row_columns + static_cast<uint32_t>(first[i])],
                 starts[row_columns + static_cast<uint32_t>(last[i]) + 1],
                 row + i > first_row ? kRepeated : 0);
    }
  }
}

template <bool kDirectional>
HWY_NOINLINE void TestBsp(const MaskState& state, const Triangles& t, int triangle,
                          const std::vector<BspNode>& nodes, const Outline& o) {
  const float nearest = t.rows[kNearest * kBlock + triangle];
  if (nodes.empty()) return;
  int32_t stack[64];
  int depth = 0;
  stack[depth++] = 0;
  while (depth > 0) {
    const int32_t at = stack[--depth];
    const BspNode& node = nodes[static_cast<size_t>(at)];
    if (node.u_min > o.u_max + o.pad_u || node.u_max < o.u_min - o.pad_u || node.v_min > o.v_max + o.pad_v ||
        node.v_max < o.v_min - o.pad_v || nearest > node.farthest) {
      continue;
    }
    if (node.right < 0) {
      TestRun<kDirectional>(state, t, triangle, node.first_sample, node.end_sample);
    } else {
      stack[depth++] = node.right;
      stack[depth++] = at + 1;
    }
  }
}

/// Rows of cells that a triangle may cover before it is handed to all threads.
constexpr int kDeferRows = 24;
constexpr uint32_t kDeferPackets = 1024;

/// A larger triangle, or one that was clipped.
template <bool kDirectional>
HWY_NOINLINE void TestOutline(const MaskState& state, const Triangles& t, int triangle, const Face& face,
                              int face_index, const Outline& o, std::vector<DeferredTriangle>* deferred,
                              PairQueue<kDirectional>* queue) {
  const int row_begin = ScalarSubrow(face, o.v_min - o.pad_v) / kSubrows;
  const int row_end = ScalarSubrow(face, o.v_max + o.pad_v) / kSubrows + 1;
  if (deferred != nullptr && row_end - row_begin > kDeferRows && deferred->size() < deferred->capacity()) {
    const auto row_cells = static_cast<uint32_t>(face.columns);
    const uint32_t entries = state.cell_start[face.first_cell + static_cast<uint32_t>(row_end) * row_cells] -
                             state.cell_start[face.first_cell + static_cast<uint32_t>(row_begin) * row_cells];
    const float share = (o.u_max - o.u_min) / std::max(face.u_max - face.u_min, 1e-30f);
    if (static_cast<float>(entries) * std::min(share, 1.0f) > static_cast<float>(kDeferPackets)) {
      DeferredTriangle& d = deferred->emplace_back();
      for (int row = 0; row < kRows; ++row) d.values[row] = t.rows[row * kBlock + triangle];
      std::copy(o.u, o.u + 8, d.u);
      std::copy(o.v, o.v + 8, d.v);
      d.corners = o.corners;
      d.face = face_index;
      d.pad_u = o.pad_u;
      d.pad_v = o.pad_v;
      d.sliver = (t.slivers >> triangle & 1u) != 0;
      d.caster = t.caster;
      d.uv = t.uv == nullptr ? nullptr : t.uv + triangle;
      return;
    }
  }
  TestRows<kDirectional>(state, triangle, t.rows[kNearest * kBlock + triangle], face, o, row_begin, row_begin,
                         row_end, queue);
}

/// Clips a triangle that crosses the light's plane of this face, or spans very much of it, to the samples'
/// rectangle in it: x <= u_max w and so on, which implies w >= 0. False where nothing is left.
HWY_NOINLINE bool ClippedOutline(bool directional, const Face& face, const BlockSetup& setup, int lane,
                                 Outline* outline, float* nearest) {
  const auto pad = [](float low, float high) {
    return 1e-3 * (static_cast<double>(high) - static_cast<double>(low)) +
           64.0 * kUnitRoundoff * (1.0 + std::max(std::abs(low), std::abs(high)));
  };
  const double pad_u = pad(face.u_min, face.u_max), pad_v = pad(face.v_min, face.v_max);
  const double planes[4][3] = {{1, 0, pad_u - face.u_min},
                               {-1, 0, pad_u + face.u_max},
                               {0, 1, pad_v - face.v_min},
                               {0, -1, pad_v + face.v_max}};
  glm::dvec4 polygon[8];  // x, y, w (1 where directional), and the coordinate that `nearest` measures
  int corners = 3;
  for (int i = 0; i < 3; ++i) {
    const auto get = [&](int axis) { return static_cast<double>(setup.r[i][axis][lane]); };
    const double along = directional ? get(2) : static_cast<double>(face.sign) * get(face.axis);
    polygon[i] = {get((face.axis + 1) % 3), get((face.axis + 2) % 3), directional ? 1.0 : along, along};
  }
  for (const auto& plane : planes) {
    glm::dvec4 kept[8];
    int count = 0;
    for (int i = 0; i < corners; ++i) {
      const glm::dvec4& a = polygon[i];
      const glm::dvec4& b = polygon[(i + 1) % corners];
      const double da = plane[0] * a.x + plane[1] * a.y + plane[2] * a.z;
      const double db = plane[0] * b.x + plane[1] * b.y + plane[2] * b.z;
      if (da >= 0.0) kept[count++] = a;
      if ((da >= 0.0) != (db >= 0.0)) kept[count++] = a + (b - a) * (da / (da - db));
    }
    corners = count;
    std::copy(kept, kept + count, polygon);
    if (count == 0) return false;
  }
  double least = std::numeric_limits<double>::infinity();
  outline->corners = 0;
  for (int i = 0; i < corners; ++i) {
    // w = 0 happens only at the light itself, which is every direction at once: keep all of the face.
    if (!(polygon[i].z > 0.0)) {
      *outline = {{face.u_min, face.u_max, face.u_max, face.u_min},
                  {face.v_min, face.v_min, face.v_max, face.v_max},
                  4,
                  0,
                  0,
                  0,
                  0,
                  0,
                  0};
      least = -std::numeric_limits<double>::infinity();
      break;
    }
    outline->u[outline->corners] = static_cast<float>(polygon[i].x / polygon[i].z);
    outline->v[outline->corners] = static_cast<float>(polygon[i].y / polygon[i].z);
    ++outline->corners;
    least = std::min(least, polygon[i].w);
  }
  MeasureOutline(outline);
  *nearest = static_cast<float>(least - 1e-5 * std::abs(least));
  return true;
}

template <bool kDirectional>
void WalkBlock(const MaskState& state, const CasterBlocks& blocks, size_t block,
               std::vector<DeferredTriangle>* deferred) {
  const float* geometry = blocks.geometry + block * kBlockFloats;
  const float* uv = blocks.uvs == nullptr ? nullptr : blocks.uvs + block * 6 * kBlock;
  const bool exhaustive = state.search == Search::kExhaustive;
  BlockSetup setup;
  HWY_ALIGN float u[3][kLanes], v[3][kLanes], pads[kLanes];
  for (int offset = 0; offset < kBlock; offset += kLanes) {
    Corner corners[3];
    TransformBlock(*state.frame, geometry, offset, corners);
    bool is_set_up = false;
    uint32_t valid = 0;
    for (int f = 0; f < state.face_count; ++f) {
      const Face& face = state.faces[f];
      if (!face.HasSamples()) continue;
      // 1. Plane coordinates of the corners, and which triangles can be bounded by them.
      PlaneCoordinates p[3];
      VF u_low = hn::Set(df, kInfinity), u_high = hn::Set(df, -kInfinity);
      VF v_low = u_low, v_high = u_high, nearest = u_low, w_high = u_high;
      VF largest_z = hn::Zero(df);
      for (int corner = 0; corner < 3; ++corner) {
        p[corner] = Project(kDirectional, face, corners[corner].r);
        u_low = hn::Min(u_low, p[corner].u);
        u_high = hn::Max(u_high, p[corner].u);
        v_low = hn::Min(v_low, p[corner].v);
        v_high = hn::Max(v_high, p[corner].v);
        nearest = hn::Min(nearest, p[corner].w);
        w_high = hn::Max(w_high, p[corner].w);
        largest_z = hn::Max(largest_z, hn::Abs(p[corner].w));
      }
      const VF reach_u = hn::Max(hn::Abs(u_low), hn::Abs(u_high));
      const VF reach_v = hn::Max(hn::Abs(v_low), hn::Abs(v_high));
      const VF reach = hn::Max(reach_u, reach_v);
      const float face_reach = std::max(std::max(std::abs(face.u_min), std::abs(face.u_max)),
                                        std::max(std::abs(face.v_min), std::abs(face.v_max)));
      // One unit of angular rounding moves plane coordinates by up to 1 + u^2 + v^2; in the parallel
      // projection of a directional light rounding is relative to the coordinates themselves.
      const VF unit = kDirectional
                          ? hn::Max(reach, hn::Set(df, face_reach))
                          : hn::MulAdd(reach_u, reach_u, hn::MulAdd(reach_v, reach_v, hn::Set(df, 1.0f)));
      const VF roundoff = hn::Mul(unit, hn::Set(df, 8.0f * kUnitRoundoff));
      const VF generous = hn::Mul(roundoff, hn::Set(df, 2.0f + kSliverSpread));
      MF bounded = hn::Le(reach, hn::Set(df, kDirectional ? 64.0f * face_reach : 64.0f));
      if constexpr (!kDirectional) bounded = hn::And(bounded, hn::Gt(nearest, hn::Zero(df)));
      const VF depth_slack = hn::Mul(largest_z, hn::Set(df, 16.0f * kUnitRoundoff));
      nearest = hn::Sub(nearest, depth_slack);
      const MF overlaps =
          hn::And(hn::And(hn::And(hn::Le(hn::Sub(u_low, generous), hn::Set(df, face.u_max)),
                                  hn::Ge(hn::Add(u_high, generous), hn::Set(df, face.u_min))),
                          hn::And(hn::Le(hn::Sub(v_low, generous), hn::Set(df, face.v_max)),
                                  hn::Ge(hn::Add(v_high, generous), hn::Set(df, face.v_min)))),
                  hn::Le(nearest, hn::Set(df, face.farthest)));
      const MF quick = hn::And(bounded, overlaps);
      // Others are clipped: those in front of the light at least in part (NaN corners compare false).
      const MF clipped =
          kDirectional ? hn::AndNot(bounded, overlaps) : hn::AndNot(bounded, hn::Gt(w_high, hn::Zero(df)));
      uint32_t quick_bits = BitsOf(exhaustive ? bounded : quick);
      uint32_t clipped_bits = exhaustive ? ~quick_bits & ((1u << kLanes) - 1) : BitsOf(clipped);
      if ((quick_bits | clipped_bits) == 0) continue;

      // 2. Edges and planes, once for all faces.
      if (!is_set_up) {
        valid = SetUpBlock<kDirectional>(*state.frame, geometry, corners, offset, &setup);
        is_set_up = true;
      }
      quick_bits &= valid;
      clipped_bits &= valid;
      if ((quick_bits | clipped_bits) == 0) continue;
      const VF spread = hn::Load(df, &setup.rows[kSpread][offset]);
      const VF pad =
          hn::Mul(roundoff, hn::Add(hn::Set(df, 2.0f), hn::Min(spread, hn::Set(df, kSliverSpread))));
      hn::Store(pad, df, pads);
      hn::Store(nearest, df, &setup.rows[kNearest][offset]);
      for (int corner = 0; corner < 3; ++corner) {
        hn::Store(p[corner].u, df, u[corner]);
        hn::Store(p[corner].v, df, v[corner]);
      }
      Triangles triangles = TrianglesOf(*state.frame, face, setup, blocks.caster, uv);
      triangles.slivers = BitsOf(hn::Not(hn::Le(spread, hn::Set(df, kSliverSpread)))) << offset;
      for (uint32_t bits = (quick_bits | clipped_bits) & triangles.slivers >> offset; bits != 0;
           bits &= bits - 1) {
        SetUpEnds(kDirectional, offset + std::countr_zero(bits), &setup);
      }
      PairQueue<kDirectional> queue(state, triangles);

      // 3. Small triangles that lie together: the entries of all of them, each against all lanes at once.
      const VF box_u = hn::Add(u_high, pad), box_v = hn::Add(v_high, pad);
      const VF box_minus_u = hn::Sub(pad, u_low), box_minus_v = hn::Sub(pad, v_low);
      BlockRuns runs;
      const bool together =
          state.search == Search::kGrid && quick_bits != 0 &&
          FindBlockRuns(state, face, LanesOf(quick_bits), static_cast<uint32_t>(std::popcount(quick_bits)),
                        box_u, box_v, box_minus_u, box_minus_v, &runs);

      // 4. Else runs of entries of those that cover no more than two rows of cells, all lanes at once.
      HWY_ALIGN uint32_t first[2][kLanes], end[2][kLanes];
      HWY_ALIGN float box[5][kLanes];
      uint32_t small_bits = 0;
      if (state.search == Search::kGrid && !together) {
        const VI row_low = hn::ShiftRight<kSubrowShift>(SubrowOf(face, hn::Sub(v_low, pad)));
        const VI row_high = hn::ShiftRight<kSubrowShift>(SubrowOf(face, hn::Add(v_high, pad)));
        const auto two = hn::Gt(row_high, row_low);
        small_bits =
            quick_bits & BitsOf(hn::RebindMask(df, hn::Lt(hn::Sub(row_high, row_low), hn::Set(di, 2))));
        if (small_bits != 0) {
          hn::Store(box_u, df, box[0]);
          hn::Store(box_v, df, box[1]);
          hn::Store(box_minus_u, df, box[2]);
          hn::Store(box_minus_v, df, box[3]);
          hn::Store(nearest, df, box[4]);
          const int* starts = reinterpret_cast<const int*>(state.cell_start + face.first_cell);
          for (int run = 0; run < 2; ++run) {
            const VI row = run == 0 ? row_low : row_high;
            const VF reach = hn::GatherIndex(df, face.row_reach.data(), row);
            const VI from = ColumnOf(face, row, hn::Sub(hn::Sub(u_low, pad), reach));
            const VI to = hn::Add(ColumnOf(face, row, hn::Add(u_high, pad)), hn::Set(di, 1));
            const VI low = hn::GatherIndex(di, starts, from);
            VI high = hn::GatherIndex(di, starts, to);
            if (run == 1) high = hn::IfThenElse(two, high, low);
            hn::Store(hn::BitCast(du, low), du, first[run]);
            hn::Store(hn::BitCast(du, high), du, end[run]);
          }
        }
      }
      for (uint32_t bits = quick_bits | clipped_bits; bits != 0; bits &= bits - 1) {
        const int i = std::countr_zero(bits);
        const int lane = offset + i;
        const bool is_quick = (quick_bits >> i & 1u) != 0;
        if (together && is_quick) continue;
        if ((small_bits >> i & 1u) != 0) {
          const Reach reach = {box[0][i], box[1][i], box[2][i], box[3][i], box[4][i]};
          queue.Add(lane, reach, first[0][i], end[0][i], 0);
          queue.Add(lane, reach, first[1][i], end[1][i], kRepeated);
          continue;
        }
        if (state.search != Search::kGrid && state.Cancelled()) return;
        Outline outline;
        if (is_quick) {
          outline.corners = 3;
          for (int corner = 0; corner < 3; ++corner) {
            outline.u[corner] = u[corner][i];
            outline.v[corner] = v[corner][i];
          }
          outline.pad_u = outline.pad_v = pads[i];
          MeasureOutline(&outline);
        } else if (ClippedOutline(kDirectional, face, setup, lane, &outline, &setup.rows[kNearest][lane])) {
          outline.pad_u = outline.pad_v =
              8.0f * kUnitRoundoff * (2.0f + std::min(setup.rows[kSpread][lane], kSliverSpread)) *
              (kDirectional ? 64.0f * face_reach : 1.0f + 2.0f * face_reach * face_reach);
        } else if (!exhaustive) {
          continue;
        } else {
          setup.rows[kNearest][lane] = -kInfinity;
        }
        if (exhaustive) {
          TestRun<kDirectional>(state, triangles, lane, face.first_packet * kPacket,
                                face.end_packet * kPacket);
        } else if (state.search == Search::kBsp) {
          TestBsp<kDirectional>(state, triangles, lane, state.bsp[f], outline);
        } else {
          TestOutline<kDirectional>(state, triangles, lane, face, f, outline, deferred, &queue);
        }
      }
      if (together) {
        queue.AddBlock(offset, runs, LanesOf(quick_bits), box_u, box_v, box_minus_u, box_minus_v, nearest);
      }
      queue.Flush();
    }
  }
}

void WalkTrianglesImpl(const MaskState& state, const CasterBlocks& blocks,
                       std::vector<DeferredTriangle>* deferred) {
  constexpr size_t kBlocksOfPoll = 4;
  for (size_t block = 0; block < blocks.count; ++block) {
    if (block % kBlocksOfPoll == 0 && state.Cancelled()) return;
    if (state.frame->directional) {
      WalkBlock<true>(state, blocks, block, deferred);
    } else {
      WalkBlock<false>(state, blocks, block, deferred);
    }
  }
}

void WalkDeferredImpl(const MaskState& state, const DeferredTriangle& triangle, int row_begin, int row_end) {
  Outline outline;
  std::copy(triangle.u, triangle.u + 8, outline.u);
  std::copy(triangle.v, triangle.v + 8, outline.v);
  outline.corners = triangle.corners;
  outline.pad_u = triangle.pad_u;
  outline.pad_v = triangle.pad_v;
  MeasureOutline(&outline);
  const Face& face = state.faces[triangle.face];
  BlockSetup setup;
  for (int row = 0; row < kRows; ++row) setup.rows[row][0] = triangle.values[row];
  Triangles t = TrianglesOf(*state.frame, face, setup, triangle.caster, triangle.uv);
  t.slivers = triangle.sliver ? 1 : 0;
  const float nearest = triangle.values[kNearest];
  const int first_row = ScalarSubrow(face, outline.v_min - outline.pad_v) / kSubrows;
  const int first = std::max(row_begin, first_row);
  const int end = std::min(row_end, ScalarSubrow(face, outline.v_max + outline.pad_v) / kSubrows + 1);
  if (state.frame->directional) {
    PairQueue<true> queue(state, t);
    TestRows<true>(state, 0, nearest, face, outline, first_row, first, end, &queue);
    queue.Flush();
  } else {
    PairQueue<false> queue(state, t);
    TestRows<false>(state, 0, nearest, face, outline, first_row, first, end, &queue);
    queue.Flush();
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace shadowfit::irregular
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit::irregular {

HWY_EXPORT(SampleRaysImpl);
HWY_EXPORT(SetUpTilesImpl);
HWY_EXPORT(BinSamplesImpl);
HWY_EXPORT(PlaceSamplesImpl);
HWY_EXPORT(TransposePacketsImpl);
HWY_EXPORT(EnterPacketsImpl);
HWY_EXPORT(WalkTrianglesImpl);
HWY_EXPORT(WalkDeferredImpl);

TileCounts::TileCounts() {
  for (int f = 0; f < 6; ++f) {
    u_min[f] = v_min[f] = std::numeric_limits<float>::infinity();
    u_max[f] = v_max[f] = farthest[f] = -std::numeric_limits<float>::infinity();
  }
}

void SampleRays(const TileTask& task, int stride, std::vector<glm::vec3>* rays) {
  HWY_DYNAMIC_DISPATCH(SampleRaysImpl)(task, stride, rays);
}

void SetUpTiles(const TileTask& task, TileCounts* counts) {
  HWY_DYNAMIC_DISPATCH(SetUpTilesImpl)(task, counts);
}

void BinSamples(const TileTask& task, std::span<const uint32_t> tiles, uint32_t none, uint32_t* cell,
                uint32_t* rank, uint32_t* histogram, TileCounts* counts) {
  HWY_DYNAMIC_DISPATCH(BinSamplesImpl)(task, tiles, none, cell, rank, histogram, counts);
}

void PlaceSamples(const TileTask& task, std::span<const uint32_t> tiles, uint32_t none, const uint32_t* start,
                  const uint32_t* rank, uint32_t scrap_place, uint32_t* cell_to_place,
                  float* sorted_packets) {
  HWY_DYNAMIC_DISPATCH(PlaceSamplesImpl)
  (task, tiles, none, start, rank, scrap_place, cell_to_place, sorted_packets);
}

void TransposePackets(float* packets, size_t count) {
  HWY_DYNAMIC_DISPATCH(TransposePacketsImpl)(packets, count);
}

size_t EnterPackets(const LightFrame& frame, const Face& face, int row, uint32_t begin, uint32_t end,
                    uint32_t first_sorted, const float* sorted_packets, const uint16_t* shadow,
                    PacketEntry* entries, uint32_t* histogram, float* row_reach) {
  return HWY_DYNAMIC_DISPATCH(EnterPacketsImpl)(frame, face, row, begin, end, first_sorted, sorted_packets,
                                                shadow, entries, histogram, row_reach);
}

void WalkTriangles(const MaskState& state, const CasterBlocks& blocks,
                   std::vector<DeferredTriangle>* deferred) {
  HWY_DYNAMIC_DISPATCH(WalkTrianglesImpl)(state, blocks, deferred);
}

void WalkDeferred(const MaskState& state, const DeferredTriangle& triangle, int row_begin, int row_end) {
  HWY_DYNAMIC_DISPATCH(WalkDeferredImpl)(state, triangle, row_begin, row_end);
}

}  // namespace shadowfit::irregular
#endif  // HWY_ONCE
