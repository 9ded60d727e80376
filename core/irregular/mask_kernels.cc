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
HWY_INLINE float SmallestLane(VF v) { return hn::GetLane(hn::MinOfLanes(df, v)); }

// ---------------------------------------------------------------------------------------------------------
// Samples

/// kLanes neighbouring pixels of one row.
struct Strip {
  VF r[3];
  VF error;  ///< Bound on the distance between r and the true surface point.
  MF sample, facing_away, outside_cone;
};

template <typename T>
HWY_INLINE const T* RowOrPadded(const ImageView<T>& image, int x, int y, int components, T* padded) {
  const T* row = image.Row(y) + x;
  const int left = image.width - x;
  if (left >= kLanes) return row;
  for (int i = 0; i < left; ++i) padded[i] = row[i];
  const float nan = std::numeric_limits<float>::quiet_NaN();
  auto* floats = reinterpret_cast<float*>(padded + left);
  for (int i = 0; i < (kLanes - left) * components; ++i) floats[i] = nan;
  return padded;
}

HWY_INLINE VF CombineHalves(VH low, VH high) { return hn::Combine(df, high, low); }

/// Unprojection in double precision, straight into ray coordinates: the homogeneous quotient cancels digits
/// in proportion to the ratio of far and near plane, which single precision does not have to spare.
HWY_INLINE Strip StripFromDepth(const LightFrame& frame, const LayerSource& layer, int x, int y) {
  float padded[kLanes];
  const VF z = hn::LoadU(df, RowOrPadded(layer.depth, x, y, 1, padded));
  Strip strip;
  strip.sample = hn::And(hn::And(hn::Ge(z, hn::Zero(df)), hn::Le(z, hn::Set(df, 1.0f))),
                         hn::Ne(z, hn::Set(df, layer.background)));

  const RayFromPixel& m = layer.ray_from_pixel;
  VH half_r[3][2], half_slope[3][2];
  hn::Mask<DH> half_in_cone[2] = {hn::MaskFromVec(hn::Zero(dh)), hn::MaskFromVec(hn::Zero(dh))};
  for (int half = 0; half < 2; ++half) {
    const VD depth = hn::PromoteTo(dd, half == 0 ? hn::LowerHalf(dh, z) : hn::UpperHalf(dh, z));
    const VD pixel = hn::Iota(dd, x + half * kLanes / 2);
    VD h[4];
    for (int i = 0; i < 4; ++i) {
      const double base = m.base[i] + static_cast<double>(y) * m.col_y[i];
      h[i] = hn::MulAdd(depth, hn::Set(dd, m.col_z[i]),
                        hn::MulAdd(pixel, hn::Set(dd, m.col_x[i]), hn::Set(dd, base)));
    }
    const VD inverse_w = hn::Div(hn::Set(dd, 1.0), h[3]);
    VD r[3];
    for (int i = 0; i < 3; ++i) {
      r[i] = hn::Mul(h[i], inverse_w);
      half_r[i][half] = hn::DemoteTo(dh, r[i]);
      // d(h/W)/dz = (dh/dz - r dW/dz) / W: how far the sample moves along its view ray with its depth.
      half_slope[i][half] = hn::DemoteTo(
          dh, hn::Mul(hn::NegMulAdd(r[i], hn::Set(dd, m.col_z[3]), hn::Set(dd, m.col_z[i])), inverse_w));
    }
    if (frame.has_cone) {
      const VD length = hn::Sqrt(hn::MulAdd(r[0], r[0], hn::MulAdd(r[1], r[1], hn::Mul(r[2], r[2]))));
      const auto in_cone = hn::Ge(r[2], hn::Mul(hn::Set(dd, frame.cos_outer), length));
      half_in_cone[half] =
          hn::Gt(hn::DemoteTo(dh, hn::IfThenElseZero(in_cone, hn::Set(dd, 1.0))), hn::Zero(dh));
    }
  }
  for (int i = 0; i < 3; ++i) strip.r[i] = CombineHalves(half_r[i][0], half_r[i][1]);
  VF slope2 = hn::Zero(df);
  for (int i = 0; i < 3; ++i) {
    const VF s = CombineHalves(half_slope[i][0], half_slope[i][1]);
    slope2 = hn::MulAdd(s, s, slope2);
  }
  const VF depth_error =
      hn::MulAdd(z, hn::Set(df, layer.depth_relative_error), hn::Set(df, layer.depth_absolute_error));
  strip.error = hn::Mul(hn::Sqrt(slope2), depth_error);
  strip.outside_cone = hn::MaskFromVec(hn::Zero(df));
  if (frame.has_cone) {
    strip.outside_cone = hn::Not(hn::MaskFromVec(
        CombineHalves(hn::VecFromMask(dh, half_in_cone[0]), hn::VecFromMask(dh, half_in_cone[1]))));
  }
  return strip;
}

HWY_INLINE Strip StripFromPositions(const LightFrame& frame, const LayerSource& layer, int x, int y) {
  glm::vec3 padded[kLanes];
  const glm::vec3* positions = RowOrPadded(layer.ws_positions, x, y, 3, padded);
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
  strip.sample = hn::MaskFromVec(hn::Zero(df));
  strip.sample = hn::Not(strip.sample);
  strip.outside_cone = hn::Gt(hn::Load(df, outside), hn::Zero(df));
  return strip;
}

HWY_INLINE Strip LoadStrip(const LightFrame& frame, const LayerSource& layer, int x, int y) {
  Strip strip = layer.ws_positions.bottom_row != nullptr ? StripFromPositions(frame, layer, x, y)
                                                         : StripFromDepth(frame, layer, x, y);
  const VF length2 =
      hn::MulAdd(strip.r[0], strip.r[0], hn::MulAdd(strip.r[1], strip.r[1], hn::Mul(strip.r[2], strip.r[2])));
  // Not finite: no sample. The bound keeps squares and cross products in range.
  strip.sample = hn::And(strip.sample, hn::Lt(length2, hn::Set(df, 1e34f)));
  // Rounding of r itself, of the triangle's vertices and of the plane's distance: see SetUpBlock.
  strip.error = hn::Add(strip.error, hn::MulAdd(hn::Sqrt(length2), hn::Set(df, 16.0f * kUnitRoundoff),
                                                hn::Set(df, layer.origin_error)));
  strip.facing_away = hn::MaskFromVec(hn::Zero(df));
  if (layer.ws_normals.bottom_row != nullptr) {
    glm::vec3 padded[kLanes];
    const glm::vec3* normals = RowOrPadded(layer.ws_normals, x, y, 3, padded);
    VF n[3];
    hn::LoadInterleaved3(df, &normals->x, n[0], n[1], n[2]);
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

/// Row * kSubrows + subrow.
HWY_INLINE VI SubrowOf(const Face& face, VF v) {
  const VF bin = hn::Mul(hn::Sub(v, hn::Set(df, face.v_origin)), hn::Set(df, face.v_scale));
  return hn::GatherIndex(di, face.row_of_bin.data(), ClampedInt(bin, kRowBins - 1));
}

/// Row * columns + column of plane coordinate u in a row.
HWY_INLINE VI ColumnOf(const Face& face, VI row, VF u) {
  const VF origin = hn::GatherIndex(df, face.row_u_origin.data(), row);
  const VF scale = hn::GatherIndex(df, face.row_u_scale.data(), row);
  const VI column = ClampedInt(hn::Mul(hn::Sub(u, origin), scale), face.columns - 1);
  return hn::Add(hn::Mul(row, hn::Set(di, face.columns)), column);
}

constexpr int kSubrowShift = 2;
static_assert(kSubrows == 1 << kSubrowShift);

HWY_INLINE VI CellOf(const Face& face, const PlaneCoordinates& p) {
  const VI subrow = SubrowOf(face, p.v);
  const VI column = ColumnOf(face, hn::ShiftRight<kSubrowShift>(subrow), p.u);
  const VI within = hn::And(subrow, hn::Set(di, kSubrows - 1));
  return hn::Add(hn::Add(hn::ShiftLeft<kSubrowShift>(column), within),
                 hn::Set(di, static_cast<int32_t>(face.first_cell)));
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

/// Calls strip(x, y) for all strips of a task's rows, tile by tile: neighbours in both directions go to the
/// same cells, while these are in the cache.
template <typename StripFunction>
HWY_INLINE void ForEachStrip(const SampleTask& task, const StripFunction& strip) {
  constexpr int kTileWidth = 64, kTileHeight = 32;
  const int width = static_cast<int>(task.padded_width);
  for (int tile_y = task.row_begin; tile_y < task.row_end; tile_y += kTileHeight) {
    if (task.cancellation != nullptr && task.cancellation->Requested()) return;
    for (int tile_x = 0; tile_x < width; tile_x += kTileWidth) {
      for (int y = tile_y; y < std::min(tile_y + kTileHeight, task.row_end); ++y) {
        for (int x = tile_x; x < std::min(tile_x + kTileWidth, width); x += kLanes) strip(x, y);
      }
    }
  }
}

void SampleRaysImpl(const SampleTask& task, int stride, std::vector<glm::vec3>* rays) {
  HWY_ALIGN float r[3][kLanes];
  const int width = static_cast<int>(task.padded_width);
  for (int y = task.row_begin + stride / 2; y < task.row_end; y += stride) {
    for (int x = (y / stride % 2) * kLanes; x < width; x += stride * kLanes / 2) {
      const Strip strip = LoadStrip(*task.frame, *task.layer, x, y);
      for (int i = 0; i < 3; ++i) hn::Store(strip.r[i], df, r[i]);
      uint32_t bits = BitsOf(hn::AndNot(hn::Or(strip.outside_cone, strip.facing_away), strip.sample));
      for (; bits != 0; bits &= bits - 1) {
        const int i = std::countr_zero(bits);
        rays->emplace_back(r[0][i], r[1][i], r[2][i]);
      }
    }
  }
}

void BinSamplesImpl(const SampleTask& task, uint32_t* cell, uint32_t* rank, uint32_t* histogram,
                    BinCounts* counts) {
  const int face_count = task.single_face ? 1 : 6;
  VF u_min[6], u_max[6], v_min[6], v_max[6], farthest[6];
  for (int f = 0; f < face_count; ++f) {
    u_min[f] = v_min[f] = hn::Set(df, kInfinity);
    u_max[f] = v_max[f] = farthest[f] = hn::Set(df, -kInfinity);
  }
  HWY_ALIGN uint32_t cells[kLanes];
  ForEachStrip(task, [&](int x, int y) HWY_ATTR {
    const size_t row = task.layer->first_pixel + static_cast<size_t>(y) * task.padded_width;
    const Strip strip = LoadStrip(*task.frame, *task.layer, x, y);
    VI result = hn::IfThenElse(hn::RebindMask(di, strip.facing_away),
                               hn::Set(di, static_cast<int32_t>(task.marks.shadowed)),
                               hn::Set(di, static_cast<int32_t>(task.marks.lit)));
    MF wanted = hn::AndNot(hn::Or(strip.facing_away, strip.outside_cone), strip.sample);
    counts->samples += hn::CountTrue(df, strip.sample);
    counts->facing_away += hn::CountTrue(df, strip.facing_away);
    counts->outside_cone += hn::CountTrue(df, strip.outside_cone);
    if (task.single_face) {
      const MF fits = FitsSingleFace(task.frame->directional, task.faces[0], strip.r);
      counts->off_face += hn::CountTrue(df, hn::AndNot(fits, wanted));
      wanted = hn::And(wanted, fits);
    }
    for (int f = 0; f < face_count; ++f) {
      const Face& face = task.faces[f];
      const MF on = task.single_face ? wanted : hn::And(wanted, OnFace(face, strip.r));
      if (hn::AllFalse(df, on)) continue;
      const PlaneCoordinates p = Project(task.frame->directional, face, strip.r);
      u_min[f] = hn::IfThenElse(on, hn::Min(u_min[f], p.u), u_min[f]);
      u_max[f] = hn::IfThenElse(on, hn::Max(u_max[f], p.u), u_max[f]);
      v_min[f] = hn::IfThenElse(on, hn::Min(v_min[f], p.v), v_min[f]);
      v_max[f] = hn::IfThenElse(on, hn::Max(v_max[f], p.v), v_max[f]);
      farthest[f] = hn::IfThenElse(on, hn::Max(farthest[f], p.w), farthest[f]);
      result = hn::IfThenElse(hn::RebindMask(di, on), CellOf(face, p), result);
    }
    const auto unsigned_result = hn::BitCast(du, result);
    hn::Store(unsigned_result, du, cells);
    hn::StoreU(unsigned_result, du, cell + row + x);
    uint32_t* ranks = rank + row + x;
    for (int i = 0; i < kLanes; ++i) ranks[i] = histogram[cells[i]]++;
  });
  for (int f = 0; f < 6; ++f) {
    const bool used = f < face_count;
    counts->u_min[f] = used ? SmallestLane(u_min[f]) : kInfinity;
    counts->u_max[f] = used ? LargestLane(u_max[f]) : -kInfinity;
    counts->v_min[f] = used ? SmallestLane(v_min[f]) : kInfinity;
    counts->v_max[f] = used ? LargestLane(v_max[f]) : -kInfinity;
    counts->farthest[f] = used ? LargestLane(farthest[f]) : -kInfinity;
  }
}

void PlaceSamplesImpl(const SampleTask& task, const uint32_t* start, const uint32_t* rank,
                      const CellMarks& mark_places, uint32_t scrap_place, uint32_t* cell_to_place,
                      float* packets) {
  const auto lit_mark = hn::Set(du, task.marks.lit);
  const auto shadowed_mark = hn::Set(du, task.marks.shadowed);
  ForEachStrip(task, [&](int x, int y) HWY_ATTR {
    const size_t row = task.layer->first_pixel + static_cast<size_t>(y) * task.padded_width;
    const auto cells = hn::LoadU(du, cell_to_place + row + x);
    const auto lit = hn::Eq(cells, lit_mark);
    const auto shadowed = hn::Eq(cells, shadowed_mark);
    const auto marked = hn::Or(lit, shadowed);
    auto* place_out = cell_to_place + row + x;
    if (hn::AllTrue(du, marked)) {
      hn::StoreU(hn::IfThenElse(lit, hn::Set(du, mark_places.lit), hn::Set(du, mark_places.shadowed)), du,
                 place_out);
      return;
    }
    const auto first = hn::GatherIndex(du, start, hn::BitCast(di, cells));
    auto place = hn::Add(first, hn::LoadU(du, rank + row + x));
    place = hn::IfThenElse(lit, hn::Set(du, mark_places.lit), place);
    place = hn::IfThenElse(shadowed, hn::Set(du, mark_places.shadowed), place);
    hn::StoreU(place, du, place_out);

    const Strip strip = LoadStrip(*task.frame, *task.layer, x, y);
    const auto target = hn::IfThenElse(marked, hn::Set(du, scrap_place), place);
    // Place p is float (p / kPacket) * kPacketFloats + p % kPacket of the packets.
    const auto lane = hn::And(target, hn::Set(du, static_cast<uint32_t>(kPacket - 1)));
    const auto offset = hn::BitCast(di, hn::Add(hn::ShiftLeft<2>(hn::Sub(target, lane)), lane));
    hn::ScatterIndex(strip.r[0], df, packets, offset);
    hn::ScatterIndex(strip.r[1], df, packets + kPacket, offset);
    hn::ScatterIndex(strip.r[2], df, packets + 2 * kPacket, offset);
    hn::ScatterIndex(strip.error, df, packets + 3 * kPacket, offset);
  });
}

void BoundPacketsImpl(const Face& face, bool directional, uint32_t begin, uint32_t end, const float* packets,
                      PacketBounds* bounds) {
  for (uint32_t p = begin; p < end; ++p) {
    const float* values = packets + static_cast<size_t>(p) * kPacketFloats;
    VF u_min = hn::Set(df, kInfinity), v_min = u_min;
    VF u_max = hn::Set(df, -kInfinity), v_max = u_max, farthest = u_max;
    for (int i = 0; i < kPacket; i += kLanes) {
      const VF r[3] = {hn::Load(df, values + i), hn::Load(df, values + kPacket + i),
                       hn::Load(df, values + 2 * kPacket + i)};
      const PlaneCoordinates c = Project(directional, face, r);
      const MF sample = hn::Eq(r[0], r[0]);  // Not the padding, which is NaN.
      u_min = hn::IfThenElse(sample, hn::Min(u_min, c.u), u_min);
      v_min = hn::IfThenElse(sample, hn::Min(v_min, c.v), v_min);
      u_max = hn::IfThenElse(sample, hn::Max(u_max, c.u), u_max);
      v_max = hn::IfThenElse(sample, hn::Max(v_max, c.v), v_max);
      farthest = hn::IfThenElse(sample, hn::Max(farthest, c.w), farthest);
    }
    bounds[p] = {SmallestLane(u_min), SmallestLane(v_min), -LargestLane(u_max), -LargestLane(v_max),
                 LargestLane(farthest)};
  }
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

/// One triangle, as the test of a packet reads it.
struct Prepared {
  /// Padded largest u and v, and negated smallest, in the order of PacketBounds.
  alignas(16) float reach[4];
  const float* column;  ///< Row k is column[k * stride].
  int stride;
  float nearest;
  int axis;  ///< Of w among the ray coordinates, and its sign.
  float sign;
  bool sliver;
  const Caster* caster;
  const float* uv;  ///< Row k of the block's texture coordinates is uv[k * kBlock + lane].
  int lane;

  HWY_INLINE VF Get(int row) const { return hn::Set(df, column[row * stride]); }
};

HWY_INLINE Prepared Prepare(const LightFrame& frame, const Face& face, const float* column, int stride,
                            bool sliver, const Caster* caster, const float* uv, int lane) {
  return {{kInfinity, kInfinity, kInfinity, kInfinity},
          column,
          stride,
          column[kNearest * stride],
          frame.directional ? 2 : face.axis,
          frame.directional ? 1.0f : face.sign,
          sliver,
          caster,
          uv,
          lane};
}

/// Of the lanes in `bits`, those where the cutout's texture is opaque.
template <bool kDirectional>
HWY_NOINLINE uint32_t OpaqueLanes(const Prepared& t, const float* packet, uint32_t bits) {
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
      for (int k = 0; k < 3; ++k) e += t.column[(kEdge + 3 * edge + k) * t.stride] * r[k];
      weight[corner] = std::max(e, 0.0f);
      sum += weight[corner];
    }
    glm::vec2 uv(0.0f);
    for (int corner = 0; corner < 3; ++corner) {
      const float b = sum > 0.0f ? weight[corner] / sum : 1.0f / 3.0f;
      uv += b * glm::vec2(t.uv[(2 * corner) * kBlock + t.lane], t.uv[(2 * corner + 1) * kBlock + t.lane]);
    }
    if (t.caster->alpha->AlphaAt(uv) >= t.caster->alpha_cutoff) opaque |= 1u << i;
  }
  return opaque;
}

HWY_NOINLINE void Absorb(const MaskState& state, const Caster& caster, uint32_t packet, uint32_t bits) {
  std::atomic_ref<uint8_t> lock(state.packet_lock[packet]);
  while (lock.exchange(1, std::memory_order_acquire) != 0) {
  }
  uint32_t* sums = state.absorbance + static_cast<size_t>(packet) * 3 * kPacket;
  uint8_t bytes[8] = {};
  for (int i = 0; i < kPacket; i += kLanes) {
    const uint32_t lane_bits = bits >> i;
    std::memcpy(bytes, &lane_bits, sizeof(lane_bits));
    const auto mask = hn::LoadMaskBits(du, bytes);
    for (int channel = 0; channel < 3; ++channel) {
      uint32_t* sum = sums + channel * kPacket + i;
      const auto more = hn::IfThenElseZero(mask, hn::Set(du, caster.absorbance[channel]));
      hn::Store(hn::Min(hn::Add(hn::Load(du, sum), more), hn::Set(du, kAbsorbanceMax)), du, sum);
    }
  }
  lock.store(0, std::memory_order_release);
}

/// Relaxed atomics suffice: bits are only ever set, and are read after the threads have joined, or earlier
/// only to skip work that could not change them.
template <bool kDirectional>
HWY_NOINLINE void Record(const MaskState& state, const Prepared& t, uint32_t packet, uint32_t behind,
                         uint32_t on) {
  std::atomic_ref<uint16_t> shadow(state.shadow[packet]);
  uint32_t known = shadow.load(std::memory_order_relaxed);
  behind &= ~known;
  on &= ~known;
  if ((behind | on) == 0) return;
  if (t.caster->alpha != nullptr) {
    const float* values = state.packets + static_cast<size_t>(packet) * kPacketFloats;
    const uint32_t opaque = OpaqueLanes<kDirectional>(t, values, behind | on);
    behind &= opaque;
    on &= opaque;
  }
  if (behind != 0) {
    if (t.caster->transmits) {
      Absorb(state, *t.caster, packet, behind);
    } else {
      known |= shadow.fetch_or(static_cast<uint16_t>(behind), std::memory_order_relaxed) | behind;
      if (known == 0xFFFF) {
        std::atomic_ref<float>(state.bounds[packet].farthest).store(-kInfinity, std::memory_order_relaxed);
      }
    }
  }
  if (on != 0) {
    std::atomic_ref<uint16_t> touched(state.touched[packet]);
    const uint32_t again = touched.fetch_or(static_cast<uint16_t>(on), std::memory_order_relaxed) & on;
    if (again != 0) {
      std::atomic_ref<uint16_t> twice(state.touched_twice[packet]);
      twice.fetch_or(static_cast<uint16_t>(again), std::memory_order_relaxed);
    }
  }
}

HWY_INLINE MF BetweenEnds(const Prepared& t, bool directional, VF x, VF y, VF z) {
  const VF reach = hn::Add(hn::Add(hn::Abs(x), hn::Abs(y)), directional ? t.Get(kEndExtent) : hn::Abs(z));
  MF between = hn::Eq(x, x);
  for (int end = 0; end < 2; ++end) {
    const VF third = t.Get(kEnd + 3 * end + 2);
    const VF e =
        hn::MulAdd(t.Get(kEnd + 3 * end), x,
                   hn::MulAdd(t.Get(kEnd + 3 * end + 1), y, directional ? third : hn::Mul(third, z)));
    between = hn::And(between, hn::Ge(hn::MulAdd(t.Get(kEndMargin + end), reach, e), hn::Zero(df)));
  }
  return between;
}

template <bool kDirectional>
HWY_INLINE void TestPacket(const MaskState& state, const Prepared& t, uint32_t packet) {
  const float* values = state.packets + static_cast<size_t>(packet) * kPacketFloats;
  uint32_t behind = 0, on = 0;
  for (int i = 0; i < kPacket; i += kLanes) {
    const VF x = hn::Load(df, values + i);
    const VF y = hn::Load(df, values + kPacket + i);
    const VF z = hn::Load(df, values + 2 * kPacket + i);
    const auto inside_edge = [&](int edge) {
      const int n = kEdge + 3 * edge;
      const VF third = kDirectional ? t.Get(n + 2) : hn::Mul(t.Get(n + 2), z);
      const VF e = hn::MulAdd(t.Get(n), x, hn::MulAdd(t.Get(n + 1), y, third));
      return hn::Gt(e, t.Get(kThreshold + edge));
    };
    MF inside = hn::And(hn::And(inside_edge(0), inside_edge(1)), inside_edge(2));
    if (hn::AllFalse(df, inside)) continue;
    // The packet's test above, for each sample: so that the answer does not depend on the packet.
    const VF w = hn::Mul(hn::Load(df, values + t.axis * kPacket + i), hn::Set(df, t.sign));
    inside = hn::And(inside, hn::Ge(w, hn::Set(df, t.nearest)));
    if (t.sliver) inside = hn::And(inside, BetweenEnds(t, kDirectional, x, y, z));
    const VF height =
        hn::Sub(hn::MulAdd(t.Get(kPlane), x, hn::MulAdd(t.Get(kPlane + 1), y, hn::Mul(t.Get(kPlane + 2), z))),
                t.Get(kPlaneD));
    const VF bound = hn::Mul(t.Get(kPlaneLength), hn::Load(df, values + 3 * kPacket + i));
    const MF is_behind = hn::And(inside, hn::Gt(height, bound));
    const MF is_on = hn::And(inside, hn::Le(hn::Abs(height), bound));
    behind |= BitsOf(is_behind) << i;
    on |= BitsOf(is_on) << i;
  }
  if ((behind | on) != 0) Record<kDirectional>(state, t, packet, behind, on);
}

/// A convex polygon in plane coordinates of a face, which encloses what the triangle covers of it.
struct Outline {
  float u[8], v[8];
  int corners;
  float pad_u, pad_v;  ///< By how much rounding may move a sample against it.
  float u_min, u_max, v_min, v_max;
};

HWY_INLINE void SetReach(const Outline& o, Prepared* t) {
  t->reach[0] = o.u_max + o.pad_u;
  t->reach[1] = o.v_max + o.pad_v;
  t->reach[2] = o.pad_u - o.u_min;
  t->reach[3] = o.pad_v - o.v_min;
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

HWY_INLINE int ScalarSubrow(const Face& face, float v) {
  const float bin = (v - face.v_origin) * face.v_scale;
  return face
      .row_of_bin[static_cast<size_t>(std::min(std::max(bin, 0.0f), static_cast<float>(kRowBins - 1)))];
}

HWY_INLINE bool MayReach(const MaskState& state, float nearest, uint32_t packet) {
  return nearest <= std::atomic_ref<float>(state.bounds[packet].farthest).load(std::memory_order_relaxed);
}

/// Every packet of a run.
template <bool kDirectional>
HWY_INLINE void TestRun(const MaskState& state, const Prepared& t, uint32_t first, uint32_t end) {
  if (first >= end) return;
  for (uint32_t p = first / kPacket; p <= (end - 1) / kPacket; ++p) {
    if (MayReach(state, t.nearest, p)) TestPacket<kDirectional>(state, t, p);
  }
}

/// Collects pairs of triangle and packet whose bounds overlap and tests them later: the loads of the next
/// ones are then under way while one is tested.
template <bool kDirectional>
class PacketQueue {
 public:
  explicit PacketQueue(const MaskState& state) : state_(state) {}

  /// The packets of samples [first, end), against triangle `t`, which must outlive Flush.
  HWY_INLINE void Add(const Prepared* t, uint32_t first, uint32_t end) {
    if (first >= end) return;
    const auto reach = hn::Load(d4_, t->reach);
    for (uint32_t p = first / kPacket; p <= (end - 1) / kPacket; ++p) {
      const auto bounds = hn::Load(d4_, &state_.bounds[p].u_min);
      // Kept or not is hard to foretell: no branch.
      entries_[count_] = {t, p};
      count_ += static_cast<int>(hn::AllTrue(d4_, hn::Le(bounds, reach))) &
                static_cast<int>(MayReach(state_, t->nearest, p));
      hwy::Prefetch(state_.packets + static_cast<size_t>(p) * kPacketFloats);
      if (count_ == kCapacity) Flush();
    }
  }

  HWY_INLINE void Flush() {
    for (int i = 0; i < count_; ++i)
      TestPacket<kDirectional>(state_, *entries_[i].triangle, entries_[i].packet);
    count_ = 0;
  }

 private:
  static constexpr int kCapacity = 64;
  struct Entry {
    const Prepared* triangle;
    uint32_t packet;
  };
  const hn::FixedTag<float, 4> d4_;
  const MaskState& state_;
  Entry entries_[kCapacity];
  int count_ = 0;
};

/// Rows [row_begin, row_end) of a larger outline: the range of u that it covers in each row, kLanes rows at a
/// time. In the slab of a row the extremes are at corners inside it and where edges cross its two borders.
template <bool kDirectional>
HWY_NOINLINE void TestRows(const MaskState& state, const Prepared& t, const Face& face, const Outline& o,
                           int row_begin, int row_end, PacketQueue<kDirectional>* queue) {
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
    const VF slab_high =
        hn::Add(hn::LoadU(df, &face.row_v_high[static_cast<size_t>(row)]), hn::Set(df, o.pad_v));
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
    hn::Store(hn::Sub(high, low), df, span);
    hn::Store(ClampedInt(hn::Mul(hn::Sub(hn::Sub(low, pad), origin), scale), face.columns - 1), di, first);
    hn::Store(ClampedInt(hn::Mul(hn::Sub(hn::Add(high, pad), origin), scale), face.columns - 1), di, last);
    for (int i = 0; i < std::min(kLanes, row_end - row); ++i) {
      if (!(span[i] >= 0.0f)) continue;
      const auto row_columns = static_cast<uint32_t>(row + i) * static_cast<uint32_t>(face.columns);
      const uint32_t* starts = state.cell_start + face.first_cell;
      queue->Add(&t, starts[(row_columns + static_cast<uint32_t>(first[i])) * kSubrows],
                 starts[(row_columns + static_cast<uint32_t>(last[i]) + 1) * kSubrows]);
    }
  }
}

template <bool kDirectional>
HWY_NOINLINE void TestBsp(const MaskState& state, const Prepared& t, const std::vector<BspNode>& nodes,
                          const Outline& o) {
  if (nodes.empty()) return;
  int32_t stack[64];
  int depth = 0;
  stack[depth++] = 0;
  while (depth > 0) {
    const int32_t at = stack[--depth];
    const BspNode& node = nodes[static_cast<size_t>(at)];
    if (node.u_min > o.u_max + o.pad_u || node.u_max < o.u_min - o.pad_u || node.v_min > o.v_max + o.pad_v ||
        node.v_max < o.v_min - o.pad_v || t.nearest > node.farthest) {
      continue;
    }
    if (node.right < 0) {
      TestRun<kDirectional>(state, t, node.first_sample, node.end_sample);
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
HWY_NOINLINE void TestOutline(const MaskState& state, const Prepared& t, const Face& face, int face_index,
                              const Outline& o, std::vector<DeferredTriangle>* deferred,
                              PacketQueue<kDirectional>* queue) {
  const int row_begin = ScalarSubrow(face, o.v_min - o.pad_v) / kSubrows;
  const int row_end = ScalarSubrow(face, o.v_max + o.pad_v) / kSubrows + 1;
  if (deferred != nullptr && row_end - row_begin > kDeferRows && deferred->size() < deferred->capacity()) {
    const auto row_cells = static_cast<uint32_t>(face.columns * kSubrows);
    const uint32_t samples = state.cell_start[face.first_cell + static_cast<uint32_t>(row_end) * row_cells] -
                             state.cell_start[face.first_cell + static_cast<uint32_t>(row_begin) * row_cells];
    const float share = (o.u_max - o.u_min) / std::max(face.u_max - face.u_min, 1e-30f);
    if (static_cast<float>(samples) * std::min(share, 1.0f) > static_cast<float>(kDeferPackets * kPacket)) {
      DeferredTriangle& d = deferred->emplace_back();
      for (int row = 0; row < kRows; ++row) d.values[row] = t.column[row * t.stride];
      std::copy(o.u, o.u + 8, d.u);
      std::copy(o.v, o.v + 8, d.v);
      d.corners = o.corners;
      d.face = face_index;
      d.pad_u = o.pad_u;
      d.pad_v = o.pad_v;
      d.sliver = t.sliver;
      d.caster = t.caster;
      d.uv = t.uv;
      d.lane = t.lane;
      return;
    }
  }
  TestRows<kDirectional>(state, t, face, o, row_begin, row_end, queue);
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
  Prepared prepared[kLanes];
  PacketQueue<kDirectional> queue(state);
  for (int offset = 0; offset < kBlock; offset += kLanes) {
    Corner corners[3];
    TransformBlock(*state.frame, geometry, offset, corners);
    bool is_set_up = false;
    uint32_t valid = 0;
    for (int f = 0; f < state.face_count; ++f) {
      const Face& face = state.faces[f];
      if (face.first_packet == face.end_packet) continue;
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
      const uint32_t slivers = BitsOf(hn::Not(hn::Le(spread, hn::Set(df, kSliverSpread))));

      // 3. Runs of packets of those that cover no more than two rows of cells, all lanes at once.
      HWY_ALIGN uint32_t first[2][kLanes], end[2][kLanes];
      HWY_ALIGN float box[4][kLanes];
      uint32_t small_bits = 0;
      if (state.search == Search::kGrid) {
        const VI row_low = hn::ShiftRight<kSubrowShift>(SubrowOf(face, hn::Sub(v_low, pad)));
        const VI row_high = hn::ShiftRight<kSubrowShift>(SubrowOf(face, hn::Add(v_high, pad)));
        const auto two = hn::Gt(row_high, row_low);
        small_bits =
            quick_bits & BitsOf(hn::RebindMask(df, hn::Lt(hn::Sub(row_high, row_low), hn::Set(di, 2))));
        if (small_bits != 0) {
          hn::Store(hn::Add(u_high, pad), df, box[0]);
          hn::Store(hn::Add(v_high, pad), df, box[1]);
          hn::Store(hn::Sub(pad, u_low), df, box[2]);
          hn::Store(hn::Sub(pad, v_low), df, box[3]);
          const int* starts = reinterpret_cast<const int*>(state.cell_start + face.first_cell);
          for (int run = 0; run < 2; ++run) {
            const VI row = run == 0 ? row_low : row_high;
            const VI from = ColumnOf(face, row, hn::Sub(u_low, pad));
            const VI to = hn::Add(ColumnOf(face, row, hn::Add(u_high, pad)), hn::Set(di, 1));
            const VI low = hn::GatherIndex(di, starts, hn::ShiftLeft<kSubrowShift>(from));
            VI high = hn::GatherIndex(di, starts, hn::ShiftLeft<kSubrowShift>(to));
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
        const bool sliver = (slivers >> i & 1u) != 0;
        if (sliver) SetUpEnds(kDirectional, lane, &setup);
        Prepared& t = prepared[i];
        if ((small_bits >> i & 1u) != 0) {
          t = Prepare(*state.frame, face, &setup.rows[0][lane], kBlock, sliver, blocks.caster, uv, lane);
          for (int k = 0; k < 4; ++k) t.reach[k] = box[k][i];
          for (int run = 0; run < 2; ++run) queue.Add(&t, first[run][i], end[run][i]);
          continue;
        }
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
        t = Prepare(*state.frame, face, &setup.rows[0][lane], kBlock, sliver, blocks.caster, uv, lane);
        if (exhaustive) {
          TestRun<kDirectional>(state, t, face.first_packet * kPacket, face.end_packet * kPacket);
        } else if (state.search == Search::kBsp) {
          TestBsp<kDirectional>(state, t, state.bsp[f], outline);
        } else {
          SetReach(outline, &t);
          TestOutline<kDirectional>(state, t, face, f, outline, deferred, &queue);
        }
      }
      queue.Flush();
    }
  }
}

void WalkTrianglesImpl(const MaskState& state, const CasterBlocks& blocks,
                       std::vector<DeferredTriangle>* deferred) {
  for (size_t block = 0; block < blocks.count; ++block) {
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
  Prepared t = Prepare(*state.frame, face, triangle.values, 1, triangle.sliver, triangle.caster, triangle.uv,
                       triangle.lane);
  SetReach(outline, &t);
  const int first = std::max(row_begin, ScalarSubrow(face, outline.v_min - outline.pad_v) / kSubrows);
  const int end = std::min(row_end, ScalarSubrow(face, outline.v_max + outline.pad_v) / kSubrows + 1);
  if (state.frame->directional) {
    PacketQueue<true> queue(state);
    TestRows<true>(state, t, face, outline, first, end, &queue);
    queue.Flush();
  } else {
    PacketQueue<false> queue(state);
    TestRows<false>(state, t, face, outline, first, end, &queue);
    queue.Flush();
  }
}

size_t PackBitsImpl(const uint32_t* place, size_t padded_width, const uint16_t* bits, uint8_t* row) {
  size_t count = 0;
  for (size_t x = 0; x < padded_width; x += kPacket) {
    uint32_t packed = 0;
    for (int i = 0; i < kPacket; i += kLanes) {
      // Two packets' bits make one aligned 32-bit word; x86 is little-endian.
      const auto p = hn::LoadU(du, place + x + static_cast<size_t>(i));
      const auto words =
          hn::GatherIndex(du, reinterpret_cast<const uint32_t*>(bits), hn::BitCast(di, hn::ShiftRight<5>(p)));
      const auto bit = hn::And(hn::Shr(words, hn::And(p, hn::Set(du, 31u))), hn::Set(du, 1u));
      packed |= BitsOf(hn::RebindMask(df, hn::Ne(bit, hn::Zero(du)))) << i;
    }
    const auto half_word = static_cast<uint16_t>(packed);
    std::memcpy(row + x / 8, &half_word, sizeof(half_word));
    count += static_cast<size_t>(std::popcount(packed));
  }
  return count;
}

}  // namespace HWY_NAMESPACE
}  // namespace shadowfit::irregular
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit::irregular {

HWY_EXPORT(SampleRaysImpl);
HWY_EXPORT(BinSamplesImpl);
HWY_EXPORT(PlaceSamplesImpl);
HWY_EXPORT(BoundPacketsImpl);
HWY_EXPORT(WalkTrianglesImpl);
HWY_EXPORT(WalkDeferredImpl);
HWY_EXPORT(PackBitsImpl);

void SampleRays(const SampleTask& task, int stride, std::vector<glm::vec3>* rays) {
  HWY_DYNAMIC_DISPATCH(SampleRaysImpl)(task, stride, rays);
}

void BinSamples(const SampleTask& task, uint32_t* cell, uint32_t* rank, uint32_t* histogram,
                BinCounts* counts) {
  HWY_DYNAMIC_DISPATCH(BinSamplesImpl)(task, cell, rank, histogram, counts);
}

void PlaceSamples(const SampleTask& task, const uint32_t* start, const uint32_t* rank,
                  const CellMarks& mark_places, uint32_t scrap_place, uint32_t* cell_to_place,
                  float* packets) {
  HWY_DYNAMIC_DISPATCH(PlaceSamplesImpl)
  (task, start, rank, mark_places, scrap_place, cell_to_place, packets);
}

void BoundPackets(const Face& face, bool directional, uint32_t begin, uint32_t end, const float* packets,
                  PacketBounds* bounds) {
  HWY_DYNAMIC_DISPATCH(BoundPacketsImpl)(face, directional, begin, end, packets, bounds);
}

void WalkTriangles(const MaskState& state, const CasterBlocks& blocks,
                   std::vector<DeferredTriangle>* deferred) {
  HWY_DYNAMIC_DISPATCH(WalkTrianglesImpl)(state, blocks, deferred);
}

void WalkDeferred(const MaskState& state, const DeferredTriangle& triangle, int row_begin, int row_end) {
  HWY_DYNAMIC_DISPATCH(WalkDeferredImpl)(state, triangle, row_begin, row_end);
}

size_t PackBits(const uint32_t* place, size_t padded_width, const uint16_t* bits, uint8_t* row) {
  return HWY_DYNAMIC_DISPATCH(PackBitsImpl)(place, padded_width, bits, row);
}

}  // namespace shadowfit::irregular
#endif  // HWY_ONCE
