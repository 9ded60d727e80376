#include "core/irregular/sample_kernels.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/irregular/sample_kernels.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/irregular/simd.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::irregular {
namespace HWY_NAMESPACE {

/// kLanes pixels in homogeneous ray coordinates, in double precision: the quotient cancels digits in
/// proportion to the ratio of far and near plane, which single precision does not have to spare.
struct Homogeneous {
  VD h[4][2];  ///< r W and W, lower and upper half.
};

/// One strip's pixels of a picture, and `outside` for those beyond it.
template <typename T>
HWY_INLINE const T* LoadStrip(const ImageView<T>& image, int x, int y, T outside, T* copy) {
  const T* from = image.Row(y) + x;
  if (x + kStrip <= image.width) return from;
  for (int i = 0; i < kStrip; ++i) copy[i] = x + i < image.width ? from[i] : outside;
  return copy;
}

HWY_INLINE Homogeneous FromDepth(const RayFromPixel& m, const double row_base[4], VF z, int x) {
  Homogeneous out;
  for (int half = 0; half < 2; ++half) {
    const VD depth = hn::PromoteTo(dd, half == 0 ? hn::LowerHalf(dh, z) : hn::UpperHalf(dh, z));
    const int first = x + half * kLanes / 2;
    const VD column = hn::Add(hn::Iota(dd, 0), hn::Set(dd, static_cast<double>(first)));
    for (int i = 0; i < 4; ++i) {
      out.h[i][half] = hn::MulAdd(depth, hn::Set(dd, m.col_z[i]),
                                  hn::MulAdd(column, hn::Set(dd, m.col_x[i]), hn::Set(dd, row_base[i])));
    }
  }
  return out;
}

HWY_INLINE Homogeneous FromPositions(const LightFrame& frame, const glm::vec3* positions) {
  Homogeneous out;
  VF p[3];
  hn::LoadInterleaved3(df, &positions->x, p[0], p[1], p[2]);
  for (int half = 0; half < 2; ++half) {
    VD d[3];
    for (int i = 0; i < 3; ++i) {
      const VD x = hn::PromoteTo(dd, half == 0 ? hn::LowerHalf(dh, p[i]) : hn::UpperHalf(dh, p[i]));
      d[i] = hn::Sub(x, hn::Set(dd, frame.ws_origin[i]));
    }
    for (int row = 0; row < 3; ++row) {
      const double* m = frame.rotation[row];
      out.h[row][half] = hn::MulAdd(hn::Set(dd, m[0]), d[0],
                                    hn::MulAdd(hn::Set(dd, m[1]), d[1], hn::Mul(hn::Set(dd, m[2]), d[2])));
    }
    out.h[3][half] = hn::Set(dd, 1.0);
  }
  return out;
}

HWY_INLINE MF FinitePositions(const glm::vec3* positions) {
  VF p[3];
  hn::LoadInterleaved3(df, &positions->x, p[0], p[1], p[2]);
  return hn::Lt(hn::Add(hn::Add(hn::Abs(p[0]), hn::Abs(p[1])), hn::Abs(p[2])), hn::Set(df, 1e17f));
}

HWY_INLINE MF MaskOfHalves(const hn::Mask<DD> halves[2]) {
  VH ones[2];
  for (int half = 0; half < 2; ++half) {
    ones[half] = hn::DemoteTo(dh, hn::IfThenElseZero(halves[half], hn::Set(dd, 1.0)));
  }
  return hn::Gt(CombineHalves(ones), hn::Zero(df));
}

/// kLanes samples on their faces: x, y, w of the face times W, lower and upper half.
struct OnFace {
  VD x[2], y[2], w[2];
  VF side;         ///< The side of the cube that a ray leaves through, as LightPlan numbers them, or -1.
  VF z_slopes[3];  ///< Changes of x, y, w with window depth.
};

/// On the single face.
HWY_INLINE OnFace OnTheFace(const Homogeneous& p, const double col_z[4]) {
  OnFace out;
  for (int half = 0; half < 2; ++half) {
    out.x[half] = p.h[0][half];
    out.y[half] = p.h[1][half];
    out.w[half] = p.h[2][half];
  }
  out.side = hn::Zero(df);
  for (int i = 0; i < 3; ++i) out.z_slopes[i] = hn::Set(df, static_cast<float>(col_z[i]));
  return out;
}

/// On the sides of the cube, each lane on its own. Rays between two sides go to the last of them.
HWY_INLINE OnFace OnSides(const Homogeneous& p, const double col_z[4]) {
  OnFace out;
  VH sides[2];
  const VD zero = hn::Zero(dd), one = hn::Set(dd, 1.0);
  for (int half = 0; half < 2; ++half) {
    const VD h[3] = {p.h[0][half], p.h[1][half], p.h[2][half]};
    const VD a[3] = {hn::Abs(h[0]), hn::Abs(h[1]), hn::Abs(h[2])};
    const VD largest = hn::Max(a[0], hn::Max(a[1], a[2]));
    const auto is_z = hn::Ge(a[2], largest);
    const auto is_y = hn::AndNot(is_z, hn::Ge(a[1], largest));
    const auto choose = [&](VD x, VD y, VD z)
                            HWY_ATTR { return hn::IfThenElse(is_z, z, hn::IfThenElse(is_y, y, x)); };
    out.x[half] = choose(h[1], h[2], h[0]);
    out.y[half] = choose(h[2], h[0], h[1]);
    const VD along = choose(h[0], h[1], h[2]);
    // The ray is h / W.
    const auto negative = hn::Lt(hn::Mul(along, hn::CopySign(one, p.h[3][half])), zero);
    out.w[half] = hn::IfThenElse(negative, hn::Neg(along), along);
    const VD side =
        hn::Add(choose(zero, hn::Set(dd, 2.0), hn::Set(dd, 4.0)), hn::IfThenElseZero(negative, one));
    sides[half] = hn::DemoteTo(dh, hn::IfThenElse(hn::Gt(largest, zero), side, hn::Neg(one)));
  }
  out.side = CombineHalves(sides);
  const MF is_z = hn::Ge(out.side, hn::Set(df, 4.0f)), is_y = hn::Ge(out.side, hn::Set(df, 2.0f));
  const VF odd =
      hn::Sub(out.side, hn::IfThenElse(is_z, hn::Set(df, 4.0f), hn::IfThenElseZero(is_y, hn::Set(df, 2.0f))));
  const float slopes[3] = {static_cast<float>(col_z[0]), static_cast<float>(col_z[1]),
                           static_cast<float>(col_z[2])};
  for (size_t i = 0; i < 3; ++i) {
    const VF of[3] = {hn::Set(df, slopes[(i + 1) % 3]), hn::Set(df, slopes[(i + 2) % 3]),
                      hn::Set(df, slopes[i])};
    out.z_slopes[i] = hn::IfThenElse(is_z, of[2], hn::IfThenElse(is_y, of[1], of[0]));
  }
  out.z_slopes[2] = hn::IfThenElse(hn::Eq(odd, hn::Set(df, 1.0f)), hn::Neg(out.z_slopes[2]), out.z_slopes[2]);
  return out;
}

HWY_INLINE MF OutsideCone(const LightFrame& frame, const Homogeneous& p) {
  hn::Mask<DD> halves[2] = {};
  for (int half = 0; half < 2; ++half) {
    const VD z = hn::Mul(p.h[2][half], hn::CopySign(hn::Set(dd, 1.0), p.h[3][half]));
    VD length2 = hn::Zero(dd);
    for (int i = 0; i < 3; ++i) length2 = hn::MulAdd(p.h[i][half], p.h[i][half], length2);
    halves[half] = hn::Lt(z, hn::Mul(hn::Set(dd, frame.cos_outer), hn::Sqrt(length2)));
  }
  return MaskOfHalves(halves);
}

struct Projected {
  VF u, v, depth;
  VF inverse_w;  ///< One for a directional light.
};

HWY_INLINE Projected Project(bool directional, const OnFace& p, const VD big_w[2]) {
  VH u[2], v[2], depth[2];
  for (int half = 0; half < 2; ++half) {
    const VD inverse = hn::Div(hn::Set(dd, 1.0), directional ? big_w[half] : p.w[half]);
    u[half] = hn::DemoteTo(dh, hn::Mul(p.x[half], inverse));
    v[half] = hn::DemoteTo(dh, hn::Mul(p.y[half], inverse));
    depth[half] =
        hn::DemoteTo(dh, directional ? hn::Mul(p.w[half], inverse) : hn::Mul(hn::Neg(big_w[half]), inverse));
  }
  Projected out;
  out.u = CombineHalves(u);
  out.v = CombineHalves(v);
  out.depth = CombineHalves(depth);
  out.inverse_w = directional ? hn::Set(df, 1.0f) : hn::Neg(out.depth);
  return out;
}

/// Of kLanes pixels: every fourth of their samples from the k-th on lie side by side. See SlotOf.
HWY_INLINE float* SlotsOf(Sample* samples, size_t pixel, size_t k) { return &samples[SlotOf(pixel + k)].u; }

/// Within kWidestFace; directional lights' samples all fit. Also false where a coordinate is not finite, or
/// so large that squares and cross products would overflow.
HWY_INLINE MF Fits(bool directional, const Projected& p) {
  const VF most = hn::Set(df, directional ? 1e17f : kWidestFace);
  const MF plane = hn::And(hn::Le(hn::Abs(p.u), most), hn::Le(hn::Abs(p.v), most));
  return hn::And(plane, directional ? hn::Le(hn::Abs(p.depth), most)
                                    : hn::And(hn::Ge(p.inverse_w, hn::Set(df, 1e-17f)),
                                              hn::Lt(p.inverse_w, hn::Set(df, kInfinity))));
}

/// How far a sample may be from the true surface point, as a share of w (directional: itself). Its depth's
/// error moves it along its view ray, by d(h/W)/dz = (dh/dz - r dW/dz) / W; to that comes the rounding of the
/// sample itself, of the triangle's vertices and of the plane's distance: see SetUpBlock.
HWY_INLINE VF ErrorOf(bool directional, const LayerSource& layer, const VF z_slopes[3], const VD big_w[2],
                      const Projected& at, VF z) {
  const VF one = hn::Set(df, 1.0f);
  const VF r2 = hn::MulAdd(at.u, at.u, hn::Mul(at.v, at.v));
  const VF third = directional ? at.depth : one;
  VF error = hn::Mul(hn::Sqrt(hn::MulAdd(third, third, r2)), hn::Set(df, 16.0f * kUnitRoundoff));
  error = hn::MulAdd(at.inverse_w, hn::Set(df, layer.origin_error), error);
  if (layer.ws_positions.bottom_row != nullptr) return error;
  const VF r[3] = {at.u, at.v, third};
  const VF w_slope = hn::Set(df, static_cast<float>(layer.ray_from_pixel.col_z[3]));
  VF slope2 = hn::Zero(df);
  for (int i = 0; i < 3; ++i) {
    const VF s = hn::NegMulAdd(r[i], w_slope, hn::Mul(z_slopes[i], at.inverse_w));
    slope2 = hn::MulAdd(s, s, slope2);
  }
  const VH w[2] = {hn::DemoteTo(dh, big_w[0]), hn::DemoteTo(dh, big_w[1])};
  const VF depth_error =
      hn::MulAdd(z, hn::Set(df, layer.depth_relative_error), hn::Set(df, layer.depth_absolute_error));
  return hn::MulAdd(hn::Sqrt(slope2), hn::Div(depth_error, hn::Abs(CombineHalves(w))), error);
}

/// n.(L - X) < 0, with L - X = -rotation^T r; a directional light's rays all run along its third row.
HWY_INLINE MF FacingAway(const LightFrame& frame, const glm::vec3* normals, const Homogeneous& p) {
  VF n[3];
  hn::LoadInterleaved3(df, &normals->x, n[0], n[1], n[2]);
  VF along = hn::Zero(df);
  for (int row = frame.directional ? 2 : 0; row < 3; ++row) {
    VF component = hn::Zero(df);
    for (int i = 0; i < 3; ++i) {
      component = hn::MulAdd(n[i], hn::Set(df, static_cast<float>(frame.rotation[row][i])), component);
    }
    if (frame.directional) {
      along = component;
    } else {
      VH r[2];
      for (int half = 0; half < 2; ++half) {
        r[half] = hn::DemoteTo(dh, hn::Mul(p.h[row][half], hn::CopySign(hn::Set(dd, 1.0), p.h[3][half])));
      }
      along = hn::MulAdd(component, CombineHalves(r), along);
    }
  }
  return hn::Gt(along, hn::Zero(df));
}

HWY_INLINE VI CellOf(const Face& face, VF u, VF v) { return RowLanes(face, BinOf(face, v)).CellAt(u); }

/// A strip's pixels that may have samples.
struct Pixels {
  const LayerSource* layer;
  int x, y;
  const float* depth;  ///< kStrip values, or null
  const glm::vec3* positions;
  const glm::vec3* normals;
  uint32_t known, known_shadow;
  // What they may have been copied to.
  alignas(64) float depth_copy[kStrip];
  alignas(64) glm::vec3 position_copy[kStrip];
  alignas(64) glm::vec3 normal_copy[kStrip];

  HWY_INLINE Homogeneous At(const LightFrame& frame, const double row_base[4], int i, VF* z) const {
    if (positions != nullptr) {
      *z = hn::Zero(df);
      return FromPositions(frame, positions + i);
    }
    *z = hn::LoadU(df, depth + i);
    return FromDepth(layer->ray_from_pixel, row_base, *z, x + i);
  }
};

/// False where the strip shows background or what is known only.
HWY_INLINE bool ReadStrip(const LayerSource& layer, int strip, int y, Pixels* out) {
  out->layer = &layer;
  out->x = strip * kStrip;
  out->y = y;
  out->known = out->known_shadow = 0;
  if (layer.known.bottom_row != nullptr) {
    const uint8_t* known = layer.known.Row(y) + out->x;
    for (int i = 0; i < std::min(kStrip, layer.known.width - out->x); ++i) {
      out->known |= static_cast<uint32_t>(known[i] != 0) << i;
      out->known_shadow |= static_cast<uint32_t>(known[i] == 2) << i;
    }
    if (out->known == 0xFFFFu) return false;
  }
  const glm::vec3 none(std::numeric_limits<float>::quiet_NaN());
  out->normals = layer.ws_normals.bottom_row == nullptr
                     ? nullptr
                     : LoadStrip(layer.ws_normals, out->x, y, none, out->normal_copy);
  out->depth = nullptr;
  out->positions = nullptr;
  if (layer.ws_positions.bottom_row != nullptr) {
    out->positions = LoadStrip(layer.ws_positions, out->x, y, none, out->position_copy);
    return true;
  }
  out->depth = LoadStrip(layer.depth, out->x, y, none.x, out->depth_copy);
  MF any = NoLanes();
  for (int i = 0; i < kStrip; i += kLanes) {
    const VF z = hn::LoadU(df, out->depth + i);
    any = hn::Or(any, hn::And(hn::Le(z, hn::Set(df, 1.0f)), hn::Ne(z, hn::Set(df, layer.background))));
  }
  return !hn::AllFalse(df, any);
}

struct Extent {
  VF u_min, v_min, u_max, v_max, farthest;

  Extent() {
    u_min = v_min = hn::Set(df, kInfinity);
    u_max = v_max = farthest = hn::Set(df, -kInfinity);
  }

  HWY_INLINE void Add(const Projected& p, MF lanes) {
    const VF high = hn::Set(df, kInfinity), low = hn::Set(df, -kInfinity);
    u_min = hn::Min(u_min, hn::IfThenElse(lanes, p.u, high));
    v_min = hn::Min(v_min, hn::IfThenElse(lanes, p.v, high));
    u_max = hn::Max(u_max, hn::IfThenElse(lanes, p.u, low));
    v_max = hn::Max(v_max, hn::IfThenElse(lanes, p.v, low));
    farthest = hn::Max(farthest, hn::IfThenElse(lanes, p.depth, low));
  }
};

/// Of samples that no face holds: those that are there at all.
HWY_NOINLINE uint32_t FiniteLanes(const Homogeneous& p, uint32_t bits) {
  HWY_ALIGN double h[4][kLanes];
  for (int i = 0; i < 4; ++i) {
    hn::Store(p.h[i][0], dd, h[i]);
    hn::Store(p.h[i][1], dd, h[i] + kLanes / 2);
  }
  uint32_t finite = 0;
  for (; bits != 0; bits &= bits - 1) {
    const int i = std::countr_zero(bits);
    const double x = h[0][i] / h[3][i], y = h[1][i] / h[3][i], z = h[2][i] / h[3][i];
    if (x * x + y * y + z * z < 1e34) finite |= 1u << i;
  }
  return finite;
}

template <bool kSingle>
HWY_INLINE void ProjectLines(const PieceTask& task, const Lines& lines, size_t step, SampleCounts* counts) {
  const LightFrame& frame = *task.frame;
  const Piece& piece = task.piece;
  Extent extents[6];
  Pixels pixels;
  size_t index = 0;
  const auto project_strip = [&](const LayerSource& layer, const double* row_base, int strip,
                                 int y) HWY_ATTR {
    const bool any = ReadStrip(layer, strip, y, &pixels);
    counts->known += static_cast<size_t>(std::popcount(pixels.known));
    counts->samples += static_cast<size_t>(std::popcount(pixels.known));
    task.facing[index] = static_cast<uint16_t>(pixels.known_shadow);
    task.present[index] = 0;
    if (!any) return;
    uint32_t samples = 0, facing = 0, outside = 0, placed = 0;
    for (int i = 0; i < kStrip; i += kLanes) {
      const size_t pixel = index * kStrip + static_cast<size_t>(i);
      VF z;
      const Homogeneous p = pixels.At(frame, row_base, i, &z);
      MF sample;
      if (pixels.depth != nullptr) {
        sample = hn::And(hn::And(hn::Ge(z, hn::Zero(df)), hn::Le(z, hn::Set(df, 1.0f))),
                         hn::Ne(z, hn::Set(df, layer.background)));
      } else {
        sample = FinitePositions(pixels.positions + i);
      }
      sample = hn::AndNot(LanesOf(pixels.known >> i), sample);
      MF left = sample;
      if (frame.has_cone) {
        const MF out = hn::And(sample, OutsideCone(frame, p));
        outside |= BitsOf(out) << i;
        left = hn::AndNot(out, left);
      }
      if (pixels.normals != nullptr) {
        const MF away = hn::And(left, FacingAway(frame, pixels.normals + i, p));
        facing |= BitsOf(away) << i;
        left = hn::AndNot(away, left);
      }
      const double* const col_z = layer.ray_from_pixel.col_z;
      const OnFace on_face = kSingle ? OnTheFace(p, col_z) : OnSides(p, col_z);
      const Projected at = Project(frame.directional, on_face, p.h[3]);
      MF on = hn::And(left, Fits(frame.directional, at));
      if constexpr (kSingle) {
        extents[0].Add(at, on);
      } else {
        on = hn::And(on, hn::Ge(on_face.side, hn::Zero(df)));
        for (int f = 0; f < 6; ++f) {
          const MF here = hn::And(on, hn::Eq(on_face.side, hn::Set(df, static_cast<float>(f))));
          if (!hn::AllFalse(df, here)) extents[f].Add(at, here);
        }
        const VI side = hn::ConvertTo(di, hn::IfThenElseZero(on, on_face.side));
        hn::Store(hn::BitCast(du, side), du, task.face_of + pixel);
      }
      placed |= BitsOf(on) << i;
      left = hn::AndNot(on, left);
      VF out[4] = {at.u, at.v, at.depth, ErrorOf(frame.directional, layer, on_face.z_slopes, p.h[3], at, z)};
      TransposeBlocks(out);
      for (size_t k = 0; k < 4; ++k) hn::Store(out[k], df, SlotsOf(task.samples, pixel, k));
      uint32_t here = BitsOf(sample);
      if (const uint32_t lost = BitsOf(left); lost != 0) {
        const uint32_t finite = FiniteLanes(p, lost);
        counts->off_face += static_cast<size_t>(std::popcount(finite));
        here &= ~lost | finite;
      }
      samples |= here << i;
    }
    counts->samples += static_cast<size_t>(std::popcount(samples));
    counts->facing_away += static_cast<size_t>(std::popcount(facing));
    counts->outside_cone += static_cast<size_t>(std::popcount(outside & samples));
    task.present[index] = static_cast<uint16_t>(placed);
    task.facing[index] = static_cast<uint16_t>(pixels.known_shadow | facing);
  };
  for (size_t line = lines.begin; line < lines.end; ++line) {
    const LayerSource& layer = task.layers[line / static_cast<size_t>(piece.rows())];
    const int y = piece.row_begin + static_cast<int>(line % static_cast<size_t>(piece.rows()));
    double row_base[4];
    for (int i = 0; i < 4; ++i)
      row_base[i] = layer.ray_from_pixel.base[i] + y * layer.ray_from_pixel.col_y[i];
    const auto strips = static_cast<size_t>(piece.strips());
    for (size_t strip = FirstStrip(line, step); strip < strips; strip += step) {
      index = line * strips + strip;
      project_strip(layer, row_base, piece.strip_begin + static_cast<int>(strip), y);
    }
  }
  for (int f = 0; f < task.face_count; ++f) {
    counts->u_min[f] = hn::GetLane(hn::MinOfLanes(df, extents[f].u_min));
    counts->v_min[f] = hn::GetLane(hn::MinOfLanes(df, extents[f].v_min));
    counts->u_max[f] = hn::GetLane(hn::MaxOfLanes(df, extents[f].u_max));
    counts->v_max[f] = hn::GetLane(hn::MaxOfLanes(df, extents[f].v_max));
    counts->farthest[f] = hn::GetLane(hn::MaxOfLanes(df, extents[f].farthest));
  }
}

void ProjectSamplesImpl(const PieceTask& task, const Lines& lines, size_t step, SampleCounts* counts) {
  if (task.face_count == 1) {
    ProjectLines<true>(task, lines, step, counts);
  } else {
    ProjectLines<false>(task, lines, step, counts);
  }
}

/// function(i) for the pixels of a strip that are present; most strips are full.
template <typename Function>
HWY_INLINE void ForEachPresent(uint32_t present, const Function& function) {
  if (present == 0xFFFFu) {
#pragma GCC unroll 16
    for (size_t i = 0; i < kStrip; ++i) function(i);
  } else {
    for (; present != 0; present &= present - 1) function(static_cast<size_t>(std::countr_zero(present)));
  }
}

/// function(strip) for all strips of some lines, in an order in which pixels that are close together follow
/// each other soon, as their cells do: what is written to stays in the nearest cache.
template <typename Function>
HWY_INLINE void ForEachStrip(const PieceTask& task, const Lines& lines, const Function& function) {
  constexpr size_t kLines = 8, kStrips = 4;
  const auto strips = static_cast<size_t>(task.piece.strips());
  for (size_t first = lines.begin; first < lines.end; first += kLines) {
    const size_t end = std::min(lines.end, first + kLines);
    for (size_t group = 0; group < strips; group += kStrips) {
      for (size_t line = first; line < end; ++line) {
        for (size_t i = group; i < std::min(strips, group + kStrips); ++i) function(line * strips + i);
      }
    }
  }
}

void BinSamplesImpl(const PieceTask& task, const Lines& lines, uint32_t* histogram) {
  ForEachStrip(task, lines, [&](size_t strip) HWY_ATTR {
    const uint32_t present = task.present[strip];
    if (present == 0) return;
    uint32_t* const place = task.place + strip * kStrip;
    for (size_t i = 0; i < kStrip; i += kLanes) {
      VF values[4];
      for (size_t k = 0; k < 4; ++k) {
        values[k] = hn::Load(df, SlotsOf(task.samples, strip * kStrip + i, k));
      }
      TransposeBlocks(values);
      const VF u = values[0], v = values[1];
      VI cell;
      if (task.face_count == 1) {
        cell = CellOf(task.faces[0], u, v);
      } else {
        const VU face = hn::Load(du, task.face_of + strip * kStrip + i);
        cell = hn::Zero(di);
        for (int f = 0; f < task.face_count; ++f) {
          const auto on = hn::Eq(face, hn::Set(du, static_cast<uint32_t>(f)));
          if (hn::AllFalse(du, on)) continue;
          cell = hn::IfThenElse(hn::RebindMask(di, on), CellOf(task.faces[f], u, v), cell);
        }
      }
      hn::Store(hn::BitCast(du, cell), du, place + i);
    }
    ForEachPresent(present, [&](size_t i) HWY_ATTR { ++histogram[place[i]]; });
  });
}

void PlaceSamplesImpl(const PieceTask& task, const Lines& lines, uint32_t* next, uint32_t* order) {
  ForEachStrip(task, lines, [&](size_t strip) HWY_ATTR {
    uint32_t* const place = task.place + strip * kStrip;
    ForEachPresent(task.present[strip], [&](size_t i) HWY_ATTR {
      const uint32_t at = next[place[i]]++;
      place[i] = at;
      order[at] = static_cast<uint32_t>(strip * kStrip + SlotOf(i));
    });
  });
}

void GatherSamplesImpl(const Sample* from, const uint32_t* order, size_t count, size_t end,
                       const SampleArrays& to) {
  size_t i = 0;
  for (; i + kLanes <= count; i += kLanes) {
    VF rows[4];
    for (size_t k = 0; k < 4; ++k) rows[k] = EveryFourth(df, &from->u, order + i + k);
    TransposeBlocks(rows);
    float* const arrays[4] = {to.u, to.v, to.depth, to.error};
    for (size_t k = 0; k < 4; ++k) hn::Store(rows[k], df, arrays[k] + i);
  }
  for (; i < count; ++i) {
    const Sample& sample = from[order[i]];
    to.u[i] = sample.u;
    to.v[i] = sample.v;
    to.depth[i] = sample.depth;
    to.error[i] = sample.error;
  }
  for (; i < end; ++i) {
    to.u[i] = to.v[i] = to.depth[i] = std::numeric_limits<float>::quiet_NaN();
    to.error[i] = 0.0f;
  }
}

size_t GatherAnswersImpl(const PieceTask& task, const Lines& lines, const uint32_t* shadow, uint16_t* out) {
  size_t count = 0;
  const auto strips = static_cast<size_t>(task.piece.strips());
  for (size_t strip = lines.begin * strips; strip < lines.end * strips; ++strip) {
    uint32_t bits = task.facing[strip];
    const uint32_t present = task.present[strip];
    if (present != 0) {
      for (int i = 0; i < kStrip; i += kLanes) {
        const VU place =
            hn::IfThenElseZero(hn::RebindMask(du, LanesOf(present >> i)),
                               hn::Load(du, task.place + strip * kStrip + static_cast<size_t>(i)));
        const VU words = hn::GatherIndex(du, shadow, hn::BitCast(di, hn::ShiftRight<5>(place)));
        const VU bit = hn::And(hn::Shr(words, hn::And(place, hn::Set(du, 31))), hn::Set(du, 1));
        bits |= (BitsOf(hn::RebindMask(df, hn::Ne(bit, hn::Zero(du)))) & (present >> i)) << i;
      }
    }
    out[strip] = static_cast<uint16_t>(bits);
    count += static_cast<size_t>(std::popcount(bits));
  }
  return count;
}

}  // namespace HWY_NAMESPACE
}  // namespace shadowfit::irregular
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit::irregular {

HWY_EXPORT(ProjectSamplesImpl);
HWY_EXPORT(BinSamplesImpl);
HWY_EXPORT(PlaceSamplesImpl);
HWY_EXPORT(GatherSamplesImpl);
HWY_EXPORT(GatherAnswersImpl);

SampleCounts::SampleCounts() {
  for (int f = 0; f < 6; ++f) {
    u_min[f] = v_min[f] = std::numeric_limits<float>::infinity();
    u_max[f] = v_max[f] = farthest[f] = -std::numeric_limits<float>::infinity();
  }
}

void SampleCounts::Add(const SampleCounts& other) {
  samples += other.samples;
  facing_away += other.facing_away;
  outside_cone += other.outside_cone;
  known += other.known;
  off_face += other.off_face;
  for (int f = 0; f < 6; ++f) {
    u_min[f] = std::min(u_min[f], other.u_min[f]);
    v_min[f] = std::min(v_min[f], other.v_min[f]);
    u_max[f] = std::max(u_max[f], other.u_max[f]);
    v_max[f] = std::max(v_max[f], other.v_max[f]);
    farthest[f] = std::max(farthest[f], other.farthest[f]);
  }
}

void ProjectSamples(const PieceTask& task, const Lines& lines, size_t step, SampleCounts* counts) {
  HWY_DYNAMIC_DISPATCH(ProjectSamplesImpl)(task, lines, step, counts);
}

void BinSamples(const PieceTask& task, const Lines& lines, uint32_t* histogram) {
  HWY_DYNAMIC_DISPATCH(BinSamplesImpl)(task, lines, histogram);
}

void PlaceSamples(const PieceTask& task, const Lines& lines, uint32_t* next, uint32_t* order) {
  HWY_DYNAMIC_DISPATCH(PlaceSamplesImpl)(task, lines, next, order);
}

void GatherSamples(const Sample* from, const uint32_t* order, size_t count, size_t end,
                   const SampleArrays& to) {
  HWY_DYNAMIC_DISPATCH(GatherSamplesImpl)(from, order, count, end, to);
}

size_t GatherAnswers(const PieceTask& task, const Lines& lines, const uint32_t* shadow, uint16_t* out) {
  return HWY_DYNAMIC_DISPATCH(GatherAnswersImpl)(task, lines, shadow, out);
}

}  // namespace shadowfit::irregular
#endif  // HWY_ONCE
