#include "core/irregular/walk_kernels.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

// AVX-512, AVX2, and SSE4 for what is older.
#define HWY_DISABLED_TARGETS (HWY_SSSE3 | HWY_AVX3_DL)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/irregular/walk_kernels.cc"
#include <hwy/cache_control.h>
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/irregular/simd.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::irregular {
namespace HWY_NAMESPACE {

/// Rows of a set-up block, each with one value a triangle.
enum Row {
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

/// Slivers of a larger spread get planes that close their ends.
constexpr float kSliverSpread = 1024.0f;

/// In ray coordinates of a face.
struct Corner {
  VF r[3];
};

/// Corners in single precision, for bounds. The difference to the origin is taken to nearly twice single
/// precision before it is rounded, so that the error is relative to the distance from the light.
HWY_INLINE void TransformBlock(const LightFrame& frame, const Face& face, const float* geometry, int offset,
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
      const double* m = face.rotation[row];
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
/// Returns the lanes that can block anything: not degenerate as the light sees them. The others have no
/// inside.
template <bool kDirectional>
HWY_NOINLINE uint32_t SetUpBlock(const LightFrame& frame, const Face& face, const float* geometry,
                                 const Corner corners[3], int offset, BlockSetup* setup) {
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

/// Triangles of a set-up block, as the tests of samples read them.
struct Triangles {
  const float* rows;  ///< Row k of triangle i is rows[k * kBlock + i].
  const float* uv;    ///< Row k of its texture coordinates is uv[k * kBlock + i]; may be null.
  const Caster* caster;
  uint32_t slivers = 0;  ///< Bit per triangle.
};

HWY_INLINE VF Broadcast(const float* triangle, int row) { return hn::Set(df, triangle[row * kBlock]); }

/// Of the lanes in `bits`, those where the cutout's texture is opaque.
HWY_NOINLINE uint32_t OpaqueLanes(const Triangles& t, int triangle, const float* u, const float* v,
                                  uint32_t bits) {
  uint32_t opaque = 0;
  for (uint32_t left = bits; left != 0; left &= left - 1) {
    const int i = std::countr_zero(left);
    const float r[3] = {u[i], v[i], 1.0f};
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

/// Bits of the kLanes samples from `first` on, and of some more.
HWY_INLINE uint32_t BitsAt(const uint32_t* words, uint32_t first) {
  words += first / 32;
  return static_cast<uint32_t>((uint64_t{words[1]} << 32 | words[0]) >> (first % 32));
}

/// Returns what was set before.
HWY_INLINE uint32_t SetBits(uint32_t* words, uint32_t first, uint32_t bits) {
  words += first / 32;
  const uint64_t old = uint64_t{words[1]} << 32 | words[0];
  const uint64_t all = old | uint64_t{bits} << (first % 32);
  words[0] = static_cast<uint32_t>(all);
  words[1] = static_cast<uint32_t>(all >> 32);
  return static_cast<uint32_t>(old >> (first % 32));
}

HWY_INLINE void Absorb(const WalkTask& state, const Caster& caster, uint32_t first, uint32_t bits) {
  const auto lanes = hn::RebindMask(du, LanesOf(bits));
  for (int channel = 0; channel < state.channels; ++channel) {
    uint32_t* sums = state.absorbance[channel] + first;
    const auto more = hn::IfThenElseZero(lanes, hn::Set(du, caster.absorbance[channel]));
    hn::StoreU(hn::Min(hn::Add(hn::LoadU(du, sums), more), hn::Set(du, kAbsorbanceMax)), du, sums);
  }
}

HWY_INLINE void Record(const WalkTask& state, const Triangles& t, int triangle, uint32_t first,
                       uint32_t behind, uint32_t on) {
  if (t.caster->alpha != nullptr) {
    if ((behind | on) == 0) return;
    const uint32_t opaque =
        OpaqueLanes(t, triangle, state.samples.u + first, state.samples.v + first, behind | on);
    behind &= opaque;
    on &= opaque;
  }
  if (t.caster->transmits) {
    if (behind != 0) Absorb(state, *t.caster, first, behind);
  } else if (behind != 0) {
    SetBits(state.shadow, first, behind);
  }
  if (on != 0) {
    const uint32_t again = SetBits(state.touched, first, on) & on;
    if (again != 0) SetBits(state.touched_twice, first, again);
  }
}

HWY_INLINE MF BetweenEnds(const float* triangle, VF u, VF v) {
  const VF reach = hn::Add(hn::Add(hn::Abs(u), hn::Abs(v)), Broadcast(triangle, kEndExtent));
  MF between = hn::Eq(u, u);
  for (int end = 0; end < 2; ++end) {
    const int n = kEnd + 3 * end;
    const VF e = hn::MulAdd(Broadcast(triangle, n), u,
                            hn::MulAdd(Broadcast(triangle, n + 1), v, Broadcast(triangle, n + 2)));
    between =
        hn::And(between, hn::Ge(hn::MulAdd(Broadcast(triangle, kEndMargin + end), reach, e), hn::Zero(df)));
  }
  return between;
}

/// Which samples lie in the cone of a triangle's corners.
struct EdgeTest {
  VF normal[3][3], threshold[3];

  HWY_INLINE explicit EdgeTest(const float* triangle) {
    for (int edge = 0; edge < 3; ++edge) {
      for (int i = 0; i < 3; ++i) normal[edge][i] = Broadcast(triangle, kEdge + 3 * edge + i);
      threshold[edge] = Broadcast(triangle, kThreshold + edge);
    }
  }

  /// Of kLanes samples from `first` on.
  HWY_INLINE uint32_t Inside(const SampleArrays& samples, uint32_t first) const {
    const VF u = hn::LoadU(df, samples.u + first);
    const VF v = hn::LoadU(df, samples.v + first);
    MF inside[3];
    for (int edge = 0; edge < 3; ++edge) {
      const VF* n = normal[edge];
      inside[edge] = hn::Gt(hn::MulAdd(n[0], u, hn::MulAdd(n[1], v, n[2])), threshold[edge]);
    }
    return BitsOf(hn::And(hn::And(inside[0], inside[1]), inside[2]));
  }
};

/// Of the samples in `inside`, which lie in the cone of the corners: are they behind the triangle?
HWY_INLINE void TestPlane(const WalkTask& state, const Triangles& t, int triangle, uint32_t first,
                          uint32_t inside) {
  const float* column = t.rows + triangle;
  const VF u = hn::LoadU(df, state.samples.u + first);
  const VF v = hn::LoadU(df, state.samples.v + first);
  const VF depth = hn::LoadU(df, state.samples.depth + first);
  MF lanes = hn::Ge(depth, Broadcast(column, kNearest));
  if ((t.slivers >> triangle & 1u) != 0) lanes = hn::And(lanes, BetweenEnds(column, u, v));
  const VF height =
      hn::MulAdd(Broadcast(column, kPlane), u,
                 hn::MulAdd(Broadcast(column, kPlane + 1), v,
                            hn::MulAdd(Broadcast(column, kPlane + 2), depth, Broadcast(column, kPlane + 3))));
  const VF bound = hn::Mul(Broadcast(column, kPlaneLength), hn::LoadU(df, state.samples.error + first));
  const uint32_t behind = BitsOf(hn::And(lanes, hn::Gt(height, bound)));
  const uint32_t on = BitsOf(hn::And(lanes, hn::Le(hn::Abs(height), bound)));
  Record(state, t, triangle, first, behind & inside, on & inside);
}

/// The first of them, up to kLanes.
HWY_INLINE uint32_t FirstBits(uint32_t count) {
  constexpr uint32_t kAll = static_cast<uint32_t>((uint64_t{1} << kLanes) - 1);
  return count >= kLanes ? kAll : (1u << count) - 1;
}

/// A run of sorted samples.
HWY_INLINE void TestRun(const WalkTask& state, const Triangles& t, int triangle, uint32_t first,
                        uint32_t end) {
  const EdgeTest test(t.rows + triangle);
  for (uint32_t s = first; s < end; s += kLanes) {
    const uint32_t live = FirstBits(end - s) & ~BitsAt(state.shadow, s);
    if (live == 0) continue;
    const uint32_t inside = test.Inside(state.samples, s) & live;
    if (inside != 0) TestPlane(state, t, triangle, s, inside);
  }
}

/// A convex polygon in plane coordinates of a face, which encloses what the triangle covers of it.
struct Outline {
  float u[8], v[8];
  int corners;
  float pad;  ///< By how much rounding may move a sample against it.
  float u_min, u_max, v_min, v_max;
};

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

/// Collects runs of samples and tests them later, in steps that have few branches to foretell, and with the
/// loads of the next runs under way.
class RunQueue {
 public:
  RunQueue(const WalkTask& state, const Triangles& triangles) : state_(state), triangles_(triangles) {}

  /// In each lane the samples of cells [first, last], against that lane's triangle.
  HWY_INLINE void Add(VU triangle, VI first_cell, VI last_cell, MF lanes) {
    const int* starts = reinterpret_cast<const int*>(state_.cell_start);
    const VI first = hn::GatherIndex(di, starts, first_cell);
    // The last cell's run would go on over the gap after it, whose answers reach into another thread's.
    const VI end = hn::Min(hn::GatherIndex(di, starts, hn::Add(last_cell, hn::Set(di, 1))),
                           hn::Set(di, static_cast<int32_t>(state_.end_sample)));
    const MF keep = hn::And(lanes, hn::RebindMask(df, hn::Lt(first, end)));
    hn::StoreU(hn::Compress(first, hn::RebindMask(di, keep)), di, first_ + count_);
    hn::StoreU(hn::Compress(end, hn::RebindMask(di, keep)), di, end_ + count_);
    hn::StoreU(hn::Compress(triangle, hn::RebindMask(du, keep)), du, triangle_ + count_);
    count_ += static_cast<uint32_t>(std::popcount(BitsOf(keep)));
    if (count_ > kCapacity) Flush();
  }

  bool empty() const { return count_ == 0; }

  HWY_NOINLINE void Flush() {
    const uint32_t count = count_;
    count_ = 0;
    // 1. Which samples are inside the edges.
    const SampleArrays samples = state_.samples;
    uint32_t* const shadow = state_.shadow;
    for (uint32_t i = 0; i < std::min(kAhead, count); ++i) Prefetch(samples, i);
    for (uint32_t i = 0; i < count; ++i) {
      Prefetch(samples, std::min(i + kAhead, count - 1));
      const uint32_t triangle = triangle_[i];
      const auto end = static_cast<uint32_t>(end_[i]);
      const EdgeTest test(triangles_.rows + triangle);
      uint32_t hit_count = hit_count_;
      for (auto s = static_cast<uint32_t>(first_[i]); s < end; s += kLanes) {
        const uint32_t live = FirstBits(end - s) & ~BitsAt(shadow, s);
        const uint32_t inside = test.Inside(samples, s) & live;
        hits_[hit_count] = {s, static_cast<uint16_t>(inside), static_cast<uint16_t>(triangle)};
        hit_count += static_cast<uint32_t>(inside != 0);
        if (hit_count == kCapacity) {
          hit_count_ = hit_count;
          TestHits();
          hit_count = 0;
        }
      }
      hit_count_ = hit_count;
    }
    // 2. Where those samples are.
    TestHits();
  }

 private:
  static constexpr uint32_t kCapacity = 128;
  static constexpr uint32_t kAhead = 6;

  struct Hit {
    uint32_t first;
    uint16_t inside;
    uint16_t triangle;
  };

  HWY_INLINE void Prefetch(const SampleArrays& samples, uint32_t i) const {
    hwy::Prefetch(samples.u + first_[i]);
    hwy::Prefetch(samples.v + first_[i]);
  }

  HWY_INLINE void TestHits() {
    for (uint32_t i = 0; i < hit_count_; ++i) {
      TestPlane(state_, triangles_, hits_[i].triangle, hits_[i].first, hits_[i].inside);
    }
    hit_count_ = 0;
  }

  const WalkTask& state_;
  const Triangles& triangles_;
  int32_t first_[kCapacity + 2 * kBlock], end_[kCapacity + 2 * kBlock];
  uint32_t triangle_[kCapacity + 2 * kBlock];
  uint32_t count_ = 0;
  Hit hits_[kCapacity + 1];
  uint32_t hit_count_ = 0;
};

/// A larger outline: the range of u that it covers in each row, kLanes rows at a time. In the slab of a row
/// the extremes are at corners inside it and where edges cross its two borders.
HWY_NOINLINE void TestRows(const WalkTask& task, int triangle, const Outline& o, RunQueue* queue) {
  const Face& face = *task.face;
  const int row_begin = std::max(ScalarRow(face, o.v_min - o.pad), task.row_begin);
  const int row_end = std::min(ScalarRow(face, o.v_max + o.pad) + 1, task.row_end);
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
  const VF pad = hn::Set(df, o.pad);
  for (int row = row_begin; row < row_end; row += kLanes) {
    const auto at = static_cast<size_t>(row);
    const VF slab_low = hn::Sub(hn::LoadU(df, &face.row_v_low[at]), pad);
    const VF slab_high = hn::Add(hn::LoadU(df, &face.row_v_high[at]), pad);
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
    const VI rows = hn::Iota(di, row);
    const VI listed = hn::Min(rows, hn::Set(di, face.rows - 1));
    const RowLanes cells(face, hn::GatherIndex(di, face.first_bin_of_row.data(), listed));
    const MF lanes = hn::And(hn::Le(low, high), hn::RebindMask(df, hn::Lt(rows, hn::Set(di, row_end))));
    queue->Add(hn::Set(du, static_cast<uint32_t>(triangle)), cells.CellAt(hn::Sub(low, pad)),
               cells.CellAt(hn::Add(high, pad)), lanes);
  }
}

HWY_NOINLINE void TestBsp(const WalkTask& state, const Triangles& t, int triangle,
                          const std::vector<BspNode>& nodes, const Outline& o) {
  const float nearest = t.rows[kNearest * kBlock + triangle];
  if (nodes.empty()) return;
  int32_t stack[64];
  int depth = 0;
  stack[depth++] = 0;
  while (depth > 0) {
    const int32_t at = stack[--depth];
    const BspNode& node = nodes[static_cast<size_t>(at)];
    if (node.u_min > o.u_max + o.pad || node.u_max < o.u_min - o.pad || node.v_min > o.v_max + o.pad ||
        node.v_max < o.v_min - o.pad || nearest > node.farthest) {
      continue;
    }
    if (node.right < 0) {
      TestRun(state, t, triangle, node.first_sample, node.end_sample);
    } else {
      stack[depth++] = node.right;
      stack[depth++] = at + 1;
    }
  }
}

/// Clips a triangle that crosses the light's plane of this face, or spans very much of it, to the samples'
/// rectangle in it: x <= u_max w and so on, which implies w >= 0. False where nothing is left. From corners
/// in double precision: that of a plane which passes the light closely is lost in single precision.
HWY_NOINLINE bool ClippedOutline(const LightFrame& frame, const Face& face, const float* geometry, int lane,
                                 Outline* outline) {
  const auto pad = [](float low, float high) {
    return 1e-3 * (static_cast<double>(high) - static_cast<double>(low)) +
           64.0 * kUnitRoundoff * (1.0 + std::max(std::abs(low), std::abs(high)));
  };
  const double pad_u = pad(face.u_min, face.u_max), pad_v = pad(face.v_min, face.v_max);
  const double planes[4][3] = {{1, 0, pad_u - face.u_min},
                               {-1, 0, pad_u + face.u_max},
                               {0, 1, pad_v - face.v_min},
                               {0, -1, pad_v + face.v_max}};
  // A triangle becomes one of seven corners at most; but rounding lets the edges of one that is hardly more
  // than a line cross a plane again and again.
  constexpr int kMost = 7;
  glm::dvec3 polygon[2 * kMost];  // x, y, w (1 where directional)
  int corners = 3;
  for (int i = 0; i < 3; ++i) {
    glm::dvec3 t, r;
    for (int axis = 0; axis < 3; ++axis) {
      t[axis] = static_cast<double>(geometry[(3 * i + axis) * kBlock + lane]) - frame.ws_origin[axis];
    }
    for (int row = 0; row < 3; ++row) {
      const double* m = face.rotation[row];
      r[row] = m[0] * t.x + m[1] * t.y + m[2] * t.z;
    }
    polygon[i] = {r.x, r.y, frame.directional ? 1.0 : r.z};
  }
  for (const auto& plane : planes) {
    glm::dvec3 kept[2 * kMost];
    int count = 0;
    for (int i = 0; i < corners; ++i) {
      const glm::dvec3& a = polygon[i];
      const glm::dvec3& b = polygon[(i + 1) % corners];
      const double da = plane[0] * a.x + plane[1] * a.y + plane[2] * a.z;
      const double db = plane[0] * b.x + plane[1] * b.y + plane[2] * b.z;
      if (da >= 0.0) kept[count++] = a;
      if ((da >= 0.0) != (db >= 0.0)) kept[count++] = a + (b - a) * (da / (da - db));
    }
    corners = count;
    std::copy(kept, kept + count, polygon);
    if (count == 0) return false;
    if (count > kMost) break;
  }
  // w = 0 happens only at the light itself, which is every direction at once: then, too, all of the face.
  const bool everywhere = corners > kMost || std::any_of(polygon, polygon + corners,
                                                         [](const glm::dvec3& p) { return !(p.z > 0.0); });
  if (everywhere) {
    *outline = {{face.u_min, face.u_max, face.u_max, face.u_min},
                {face.v_min, face.v_min, face.v_max, face.v_max},
                4,
                0,
                0,
                0,
                0,
                0};
  } else {
    outline->corners = corners;
    for (int i = 0; i < corners; ++i) {
      outline->u[i] = static_cast<float>(polygon[i].x / polygon[i].z);
      outline->v[i] = static_cast<float>(polygon[i].y / polygon[i].z);
    }
  }
  MeasureOutline(outline);
  return true;
}

/// What is known of kLanes triangles before they are set up.
struct Projection {
  VF u[3], v[3], w[3];
  VF u_low, u_high, v_low, v_high, w_low, w_high;
};

template <bool kDirectional>
HWY_INLINE Projection Project(const Corner corners[3]) {
  Projection p;
  for (int i = 0; i < 3; ++i) {
    p.w[i] = corners[i].r[2];
    p.u[i] = corners[i].r[0];
    p.v[i] = corners[i].r[1];
    if constexpr (!kDirectional) {
      const VF inverse_w = hn::Div(hn::Set(df, 1.0f), p.w[i]);
      p.u[i] = hn::Mul(p.u[i], inverse_w);
      p.v[i] = hn::Mul(p.v[i], inverse_w);
    }
  }
  const auto least = [](const VF x[3]) { return hn::Min(x[0], hn::Min(x[1], x[2])); };
  const auto most = [](const VF x[3]) { return hn::Max(x[0], hn::Max(x[1], x[2])); };
  p.u_low = least(p.u), p.u_high = most(p.u);
  p.v_low = least(p.v), p.v_high = most(p.v);
  p.w_low = least(p.w), p.w_high = most(p.w);
  return p;
}

/// No less than the spread of SetUpBlock, but no more than kSliverSpread: `unit` bounds how much larger plane
/// coordinates are than directions, `roundoff` their error.
HWY_INLINE VF SpreadBound(const Projection& p, VF unit, VF roundoff) {
  const VF width = hn::Add(hn::Sub(p.u_high, p.u_low), roundoff);
  const VF height = hn::Add(hn::Sub(p.v_high, p.v_low), roundoff);
  const VF longest2 = hn::MulAdd(width, width, hn::Mul(height, height));
  const VF e1[2] = {hn::Sub(p.u[1], p.u[0]), hn::Sub(p.v[1], p.v[0])};
  const VF e2[2] = {hn::Sub(p.u[2], p.u[0]), hn::Sub(p.v[2], p.v[0])};
  const VF area = hn::Abs(hn::Sub(hn::Mul(e1[0], e2[1]), hn::Mul(e1[1], e2[0])));
  const VF error = hn::Mul(hn::Add(width, height), hn::Add(roundoff, roundoff));
  const VF most = hn::Set(df, kSliverSpread);
  const VF spread = hn::Div(hn::Mul(hn::Mul(unit, unit), longest2), hn::Sub(area, error));
  return hn::IfThenElse(hn::And(hn::Gt(area, error), hn::Lt(spread, most)), spread, most);
}

template <bool kDirectional>
void WalkLanes(const WalkTask& state, const CasterBlocks& blocks, size_t block, int offset) {
  const float* geometry = blocks.geometry + block * kBlockFloats;
  const float* uv = blocks.uvs == nullptr ? nullptr : blocks.uvs + block * 6 * kBlock;
  const bool exhaustive = state.search == Search::kExhaustive;
  const Face& face = *state.face;

  // 1. Plane coordinates of the corners, and which triangles can be bounded by them.
  Corner corners[3];
  TransformBlock(*state.frame, face, geometry, offset, corners);
  const Projection p = Project<kDirectional>(corners);
  const VF reach_u = hn::Max(hn::Abs(p.u_low), hn::Abs(p.u_high));
  const VF reach_v = hn::Max(hn::Abs(p.v_low), hn::Abs(p.v_high));
  const VF reach = hn::Max(reach_u, reach_v);
  const float face_reach = std::max(std::max(std::abs(face.u_min), std::abs(face.u_max)),
                                    std::max(std::abs(face.v_min), std::abs(face.v_max)));
  // One unit of angular rounding moves plane coordinates by up to 1 + u^2 + v^2; in the parallel
  // projection of a directional light rounding is relative to the coordinates themselves.
  const VF unit = kDirectional
                      ? hn::Max(reach, hn::Set(df, face_reach))
                      : hn::MulAdd(reach_u, reach_u, hn::MulAdd(reach_v, reach_v, hn::Set(df, 1.0f)));
  const VF roundoff = hn::Mul(unit, hn::Set(df, 8.0f * kUnitRoundoff));
  const VF pad = hn::Mul(roundoff, hn::Add(hn::Set(df, 2.0f), SpreadBound(p, unit, roundoff)));
  MF bounded = hn::Le(reach, hn::Set(df, kDirectional ? 64.0f * face_reach : 64.0f));
  if constexpr (!kDirectional) bounded = hn::And(bounded, hn::Gt(p.w_low, hn::Zero(df)));
  const VF largest_w = hn::Max(hn::Abs(p.w_low), hn::Abs(p.w_high));
  VF nearest = hn::NegMulAdd(largest_w, hn::Set(df, 16.0f * kUnitRoundoff), p.w_low);
  if constexpr (!kDirectional) {
    nearest = hn::IfThenElse(hn::Gt(nearest, hn::Zero(df)), hn::Div(hn::Set(df, -1.0f), nearest),
                             hn::Set(df, -kInfinity));
  }
  const MF overlaps = hn::And(hn::And(hn::And(hn::Le(hn::Sub(p.u_low, pad), hn::Set(df, face.u_max)),
                                              hn::Ge(hn::Add(p.u_high, pad), hn::Set(df, face.u_min))),
                                      hn::And(hn::Le(hn::Sub(p.v_low, pad), hn::Set(df, state.v_max)),
                                              hn::Ge(hn::Add(p.v_high, pad), hn::Set(df, state.v_min)))),
                              hn::Le(nearest, hn::Set(df, face.farthest)));
  const MF quick = hn::And(bounded, overlaps);
  // Others are clipped: those in front of the light at least in part, or so close to its plane that rounding
  // could hide it (NaN corners compare false).
  MF clipped = hn::AndNot(bounded, overlaps);
  if constexpr (!kDirectional) {
    VF size = hn::Zero(df);
    for (const Corner& corner : corners) {
      for (const VF& r : corner.r) size = hn::Max(size, hn::Abs(r));
    }
    const VF behind = hn::Mul(size, hn::Set(df, -16.0f * kUnitRoundoff));
    clipped = hn::AndNot(bounded, hn::Ge(p.w_high, behind));
  }
  uint32_t quick_bits = BitsOf(exhaustive ? bounded : quick);
  uint32_t clipped_bits = exhaustive ? ~quick_bits & FirstBits(kLanes) : BitsOf(clipped);
  if ((quick_bits | clipped_bits) == 0) return;

  // 2. Samples of those that cover no more than two rows of cells, all lanes at once.
  BlockSetup setup;
  Triangles triangles = {&setup.rows[0][0], uv, blocks.caster};
  RunQueue queue(state, triangles);
  uint32_t large_bits = quick_bits;
  if (state.search == Search::kGrid && quick_bits != 0) {
    const VI bin_begin = hn::Set(di, face.first_bin_of_row[static_cast<size_t>(state.row_begin)]);
    const VI bin_last = hn::Set(di, face.first_bin_of_row[static_cast<size_t>(state.row_end)] - 1);
    const RowLanes low(face, hn::Max(BinOf(face, hn::Sub(p.v_low, pad)), bin_begin));
    const RowLanes high(face, hn::Min(BinOf(face, hn::Add(p.v_high, pad)), bin_last));
    const VI further = hn::Sub(high.number, low.number);
    const MF small = hn::And(LanesOf(quick_bits), hn::RebindMask(df, hn::Lt(further, hn::Set(di, 2))));
    large_bits &= ~BitsOf(small);
    const VU numbers = hn::Iota(du, static_cast<uint32_t>(offset));
    const VF from = hn::Sub(p.u_low, pad), to = hn::Add(p.u_high, pad);
    queue.Add(numbers, low.CellAt(from), low.CellAt(to),
              hn::And(small, hn::RebindMask(df, hn::Gt(further, hn::Set(di, -1)))));
    const MF both = hn::And(small, hn::RebindMask(df, hn::Gt(further, hn::Zero(di))));
    if (!hn::AllFalse(df, both)) queue.Add(numbers, high.CellAt(from), high.CellAt(to), both);
    if (queue.empty() && (large_bits | clipped_bits) == 0) return;
  }

  // 3. Edges and planes.
  const uint32_t valid = SetUpBlock<kDirectional>(*state.frame, face, geometry, corners, offset, &setup);
  large_bits &= valid;
  clipped_bits &= valid;
  // What is left of those that are clipped depends on the samples, the answer must not.
  hn::Store(hn::IfThenElse(bounded, nearest, hn::Set(df, -kInfinity)), df, &setup.rows[kNearest][offset]);
  const VF spread = hn::Load(df, &setup.rows[kSpread][offset]);
  triangles.slivers = BitsOf(hn::Not(hn::Le(spread, hn::Set(df, kSliverSpread)))) << offset;
  for (uint32_t bits = (quick_bits | clipped_bits) & valid & triangles.slivers >> offset; bits != 0;
       bits &= bits - 1) {
    SetUpEnds(kDirectional, offset + std::countr_zero(bits), &setup);
  }

  // 4. The others one by one.
  HWY_ALIGN float u[3][kLanes], v[3][kLanes], pads[kLanes];
  if ((large_bits | clipped_bits) != 0) {
    hn::Store(pad, df, pads);
    for (int corner = 0; corner < 3; ++corner) {
      hn::Store(p.u[corner], df, u[corner]);
      hn::Store(p.v[corner], df, v[corner]);
    }
  }
  for (uint32_t bits = large_bits | clipped_bits; bits != 0; bits &= bits - 1) {
    const int i = std::countr_zero(bits);
    const int lane = offset + i;
    if (state.search != Search::kGrid && state.Cancelled()) return;
    Outline outline;
    if ((large_bits >> i & 1u) != 0) {
      outline.corners = 3;
      for (int corner = 0; corner < 3; ++corner) {
        outline.u[corner] = u[corner][i];
        outline.v[corner] = v[corner][i];
      }
      outline.pad = pads[i];
      MeasureOutline(&outline);
    } else if (ClippedOutline(*state.frame, face, geometry, lane, &outline)) {
      outline.pad = 8.0f * kUnitRoundoff * (2.0f + std::min(setup.rows[kSpread][lane], kSliverSpread)) *
                    (kDirectional ? 64.0f * face_reach : 1.0f + 2.0f * face_reach * face_reach);
    } else if (!exhaustive) {
      continue;
    }
    if (exhaustive) {
      TestRun(state, triangles, lane, face.first_sample, face.end_sample);
    } else if (state.search == Search::kBsp) {
      TestBsp(state, triangles, lane, *state.bsp, outline);
    } else {
      TestRows(state, lane, outline, &queue);
    }
  }
  queue.Flush();
}

size_t SelectBoxesImpl(const BoxArrays& boxes, const WalkTask& task, size_t begin, size_t end,
                       uint32_t* out) {
  size_t count = 0;
  for (size_t i = begin; i < end; i += kLanes) {
    MF keep = LanesOf(FirstBits(static_cast<uint32_t>(std::min<size_t>(end - i, kLanes))));
    keep = hn::And(keep, hn::Le(hn::LoadU(df, boxes.u_min + i), hn::Set(df, task.face->u_max)));
    keep = hn::And(keep, hn::Le(hn::LoadU(df, boxes.v_min + i), hn::Set(df, task.v_max)));
    keep = hn::And(keep, hn::Ge(hn::LoadU(df, boxes.u_max + i), hn::Set(df, task.face->u_min)));
    keep = hn::And(keep, hn::Ge(hn::LoadU(df, boxes.v_max + i), hn::Set(df, task.v_min)));
    keep = hn::And(keep, hn::Le(hn::LoadU(df, boxes.nearest + i), hn::Set(df, task.face->farthest)));
    const VU numbers = hn::Iota(du, static_cast<uint32_t>(i));
    hn::StoreU(hn::Compress(numbers, hn::RebindMask(du, keep)), du, out + count);
    count += static_cast<size_t>(std::popcount(BitsOf(keep)));
  }
  return count;
}

void WalkTrianglesImpl(const WalkTask& task, const CasterBlocks& blocks) {
  for (size_t block = 0; block < blocks.count; ++block) {
    for (int offset = 0; offset < kBlock; offset += kLanes) {
      if (task.frame->directional) {
        WalkLanes<true>(task, blocks, block, offset);
      } else {
        WalkLanes<false>(task, blocks, block, offset);
      }
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace shadowfit::irregular
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit::irregular {

HWY_EXPORT(SelectBoxesImpl);
HWY_EXPORT(WalkTrianglesImpl);

size_t SelectBoxes(const BoxArrays& boxes, const WalkTask& task, size_t begin, size_t end, uint32_t* out) {
  return HWY_DYNAMIC_DISPATCH(SelectBoxesImpl)(boxes, task, begin, end, out);
}

void WalkTriangles(const WalkTask& task, const CasterBlocks& blocks) {
  HWY_DYNAMIC_DISPATCH(WalkTrianglesImpl)(task, blocks);
}

}  // namespace shadowfit::irregular
#endif  // HWY_ONCE
