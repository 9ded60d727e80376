// Edge functions and planes of triangles, for Highway's per-target code: included once for each target.

#if defined(SHADOWFIT_IRREGULAR_TRIANGLE_SETUP_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SHADOWFIT_IRREGULAR_TRIANGLE_SETUP_INL_H_
#undef SHADOWFIT_IRREGULAR_TRIANGLE_SETUP_INL_H_
#else
#define SHADOWFIT_IRREGULAR_TRIANGLE_SETUP_INL_H_
#endif

#include <hwy/highway.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/irregular/simd.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::irregular {
namespace HWY_NAMESPACE {

/// Rows of a set-up block, each with one value a triangle.
enum SetupRow {
  kEdge = 0,       ///< Three edge normals, turned so that the inside is positive.
  kThreshold = 9,  ///< Inside means edge function > threshold.
  kPlane = 12,     ///< Factors of u, v, depth, and a constant: the sum is positive behind the plane.
  kPlaneLength = 16,
  kNearest = 17,    ///< Least depth of the corners.
  kEnd = 18,        ///< Two planes through the light that close a sliver's ends.
  kEndMargin = 24,  ///< They may be passed by kEndMargin * (|u| + |v| + kEndExtent).
  kEndExtent = 26,
  kSpread = 27,  ///< Squared longest edge over area, as the light sees them.
  kRows = 28,
};

struct alignas(64) BlockSetup {
  float rows[kRows][kBlock];
  float r[3][3][kBlock];  ///< Corners in ray coordinates of the face.
};
constexpr uint32_t kSetupFloats = sizeof(BlockSetup) / sizeof(float);

/// Slivers of a larger spread get planes that close their ends.
constexpr float kSliverSpread = 1024.0f;

/// In ray coordinates of a face.
struct Corner {
  VF r[3];
};

/// Corners in single precision. The difference to the origin is rounded only after it has been taken, so that
/// the error is relative to the distance from the light.
HWY_INLINE void TransformBlock(const FaceFrame& frame, const float* geometry, int offset, Corner corners[3]) {
  for (int corner = 0; corner < 3; ++corner) {
    VF t[3];
    for (int i = 0; i < 3; ++i) {
      const VF x = hn::Load(df, geometry + (3 * corner + i) * kBlock + offset);
      t[i] = hn::Sub(hn::Sub(x, hn::Set(df, frame.origin[i])), hn::Set(df, frame.origin_rest[i]));
    }
    for (int row = 0; row < 3; ++row) {
      const float* m = frame.rotation[row];
      corners[corner].r[row] = hn::MulAdd(
          hn::Set(df, m[0]), t[0], hn::MulAdd(hn::Set(df, m[1]), t[1], hn::Mul(hn::Set(df, m[2]), t[2])));
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
/// Returns the lanes that can block anything: not degenerate as the light sees them. The others have no
/// inside. Where `compact` says that none is a sliver their spreads, and what SetUpEnds() reads, are left
/// out.
template <bool kDirectional>
HWY_NOINLINE uint32_t SetUpBlock(const LightFrame& frame, const Face& face, const float* geometry,
                                 const Corner corners[3], int offset, bool compact, BlockSetup* setup) {
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
        const double* m = face.rotation[row];
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
    // Behind the plane is where plane.r > plane_d, here divided by w for a point light.
    const VD distance = hn::Mul(hn::Mul(plane_d, turn), inverse_s);
    const VD third = hn::Mul(plane[2], turn);
    const VH p[4] = {hn::DemoteTo(dh, hn::Mul(plane[0], turn)), hn::DemoteTo(dh, hn::Mul(plane[1], turn)),
                     hn::DemoteTo(dh, kDirectional ? third : distance),
                     hn::DemoteTo(dh, kDirectional ? hn::Neg(distance) : third)};
    for (int i = 0; i < 4; ++i) hn::Store(p[i], dh, &setup->rows[kPlane + i][at]);
    VD length2 = hn::Zero(dd);
    for (int i = 0; i < 3; ++i) length2 = hn::MulAdd(plane[i], plane[i], length2);
    hn::Store(hn::Sqrt(hn::DemoteTo(dh, length2)), dh, &setup->rows[kPlaneLength][at]);
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

  if (!compact) {
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
      spread =
          hn::Div(hn::Mul(longest2, hn::Sqrt(hn::Mul(hn::Mul(length2[0], length2[1]), length2[2]))), area);
    }
    store(spread, kSpread);
    for (int corner = 0; corner < 3; ++corner) {
      for (int i = 0; i < 3; ++i) hn::Store(corners[corner].r[i], df, &setup->r[corner][i][offset]);
    }
  }
  const MF all_valid = hn::And(hn::Gt(hn::Load(df, valid), zero), hn::Lt(size, hn::Set(df, 1e37f)));
  for (int edge = 0; edge < 3; ++edge) {
    store(hn::IfThenElse(all_valid, row(kThreshold + edge), hn::Set(df, kInfinity)), kThreshold + edge);
  }
  return BitsOf(all_valid);
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
  double extent = 1.0;
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

}  // namespace HWY_NAMESPACE
}  // namespace shadowfit::irregular
HWY_AFTER_NAMESPACE();

#endif
