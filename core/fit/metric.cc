#include "core/fit/metric.h"

#include <algorithm>
#include <cmath>
#include <limits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/fit/metric.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/fit/boundary_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

/// Some samples' w = h3.r and K = w^2 J, J being the Jacobian du_i/dx_j (see TexelJacobian):
/// K_ij = w h_i.dr_j - h_i.r h_3.dr_j.
struct ScaledJacobians {
  Doubles w;
  Doubles k11, k21;  ///< Along screen x.
  Doubles k12, k22;  ///< Along screen y.
  Doubles det;       ///< Of K.
  hn::Mask<DoubleLanes> usable;
};

template <class Load>
ScaledJacobians JacobiansOf(const Load& load, const BoundarySamples& samples, const glm::dmat3& h) {
  const Doubles3 p = Times(h, load(samples.r));
  const Doubles3 d1 = Times(h, load(samples.dr1));
  const Doubles3 d2 = Times(h, load(samples.dr2));
  ScaledJacobians k;
  k.w = p.z;
  k.k11 = hn::Sub(hn::Mul(d1.x, p.z), hn::Mul(p.x, d1.z));
  k.k21 = hn::Sub(hn::Mul(d1.y, p.z), hn::Mul(p.y, d1.z));
  k.k12 = hn::Sub(hn::Mul(d2.x, p.z), hn::Mul(p.x, d2.z));
  k.k22 = hn::Sub(hn::Mul(d2.y, p.z), hn::Mul(p.y, d2.z));
  k.det = hn::Sub(hn::Mul(k.k11, k.k22), hn::Mul(k.k12, k.k21));
  const auto zero = hn::Zero(DoubleLanes());
  k.usable = hn::And(hn::Gt(k.w, zero), hn::Gt(hn::Abs(k.det), zero));
  return k;
}

double FrobeniusSum(const BoundarySamples& samples, const glm::dmat3& texel_from_ray) {
  const DoubleLanes d;
  auto sum = hn::Zero(d);
  ForBoundaryLanes(samples.size(), [&](const auto& load) {
    const ScaledJacobians k = JacobiansOf(load, samples, texel_from_ray);
    const auto squares = hn::Add(hn::Add(hn::Mul(k.k11, k.k11), hn::Mul(k.k21, k.k21)),
                                 hn::Add(hn::Mul(k.k12, k.k12), hn::Mul(k.k22, k.k22)));
    // (sum J^2) / det(J)^2 with J = K / w^2.
    const auto scale = hn::Div(hn::Mul(k.w, k.w), k.det);
    sum = hn::Add(sum, hn::IfThenElseZero(k.usable, hn::Mul(squares, hn::Mul(scale, scale))));
  });
  return hn::GetLane(hn::SumOfLanes(d, sum));
}

/// |n . dx/du_k| of some samples, less a common factor, and the displacement that they make; see the header.
struct Displacements {
  Doubles along1, along2;
  Doubles scale;  ///< The factor.
  Doubles pixels;
  hn::Mask<DoubleLanes> usable;
};

template <class Load>
Displacements DisplacementsOf(const Load& load, const BoundarySamples& samples, const ScaledJacobians& k) {
  const DoubleLanes d;
  Displacements of;
  const auto n1 = load(samples.n1);
  const auto n2 = load(samples.n2);
  // n^T J^-1 = n^T adj(K) w^2 / det(K).
  of.along1 = hn::Abs(hn::Sub(hn::Mul(n1, k.k22), hn::Mul(n2, k.k21)));
  of.along2 = hn::Abs(hn::Sub(hn::Mul(n2, k.k11), hn::Mul(n1, k.k12)));
  const auto s = hn::Max(of.along1, of.along2);
  const auto t = hn::Min(of.along1, of.along2);
  const auto width =
      hn::Add(hn::Mul(hn::Set(d, 0.25), s), hn::Div(hn::Mul(t, t), hn::Mul(hn::Set(d, 12.0), s)));
  of.scale = hn::Div(hn::Mul(k.w, k.w), hn::Abs(k.det));
  of.pixels = hn::Mul(width, of.scale);
  of.usable = hn::And(k.usable, hn::Gt(s, hn::Zero(d)));
  return of;
}

/// The two parts of what pixels of displacement count for each, see the header: their shares are 1 - tail and
/// tail.
struct Counts {
  Doubles plain;
  Doubles wide;
  Doubles tail;

  Doubles Share() const { return Mixed(plain, wide); }
  /// d/dy of what y counts. That of y / (1 + y / k) is 1 / (1 + y / k)^2.
  Doubles Slope() const { return Mixed(hn::Mul(plain, plain), hn::Mul(wide, wide)); }

 private:
  Doubles Mixed(Doubles a, Doubles b) const { return hn::MulAdd(tail, hn::Sub(b, a), a); }
};

template <class Load>
Counts CountsOf(const Load& load, const BoundarySamples& samples, Doubles pixels) {
  const DoubleLanes d;
  const auto one = hn::Set(d, 1.0);
  const auto count = [&](double k) { return hn::Div(one, hn::MulAdd(pixels, hn::Set(d, 1.0 / k), one)); };
  return {count(samples.limit), count(kUnseenEdgeLimit), load(samples.tail)};
}

/// EdgePixels of some samples' edges; see the header.
template <class Load>
Doubles EdgePixelsOf(const Load& load, const BoundarySamples& samples, const ScaledJacobians& k) {
  const Displacements of = DisplacementsOf(load, samples, k);
  const Doubles displaced = hn::Mul(load(samples.length), of.pixels);
  return hn::IfThenElseZero(of.usable, hn::Mul(displaced, CountsOf(load, samples, of.pixels).Share()));
}

double EdgeSum(const BoundarySamples& samples, const glm::dmat3& texel_from_ray) {
  const DoubleLanes d;
  auto sum = hn::Zero(d);
  ForBoundaryLanes(samples.size(), [&](const auto& load) {
    sum = hn::Add(sum, EdgePixelsOf(load, samples, JacobiansOf(load, samples, texel_from_ray)));
  });
  return hn::GetLane(hn::SumOfLanes(d, sum));
}

double EdgeSumOfHeld(const BoundarySamples& samples, std::span<const ShadowProjection> maps) {
  const DoubleLanes d;
  auto sum = hn::Zero(d);
  ForBoundaryLanes(samples.size(), [&](const auto& load) {
    auto held = hn::MaskFromVec(hn::Zero(d));
    for (const ShadowProjection& map : maps) {
      const Doubles3 p = Times(map.texel_from_ray, load(samples.r));
      const auto within = [&](Doubles v, int size) {
        return hn::And(hn::Ge(v, hn::Zero(d)), hn::Le(v, hn::Mul(hn::Set(d, size), p.z)));
      };
      const auto holds = hn::And(within(p.x, map.size.width), within(p.y, map.size.height));
      const auto first = hn::AndNot(held, hn::And(hn::Gt(p.z, hn::Zero(d)), holds));
      if (hn::AllFalse(d, first)) continue;
      const Doubles counted = EdgePixelsOf(load, samples, JacobiansOf(load, samples, map.texel_from_ray));
      sum = hn::Add(sum, hn::IfThenElseZero(first, counted));
      held = hn::Or(held, first);
    }
  });
  return hn::GetLane(hn::SumOfLanes(d, sum));
}

/// Writes to element `first` of the arrays and those behind it, where they have room for all samples and a
/// vector more.
void WriteEdges(const BoundarySamples& samples, const ShadowProjection& map, size_t first,
                EdgesOnMap* edges) {
  const DoubleLanes d;
  const hn::Rebind<float, DoubleLanes> df;
  size_t next = first;
  ForBoundaryLanes(samples.size(), [&](const auto& load) {
    const Doubles3 p = Times(map.texel_from_ray, load(samples.r));
    const auto in_front = hn::Gt(p.z, hn::Zero(d));
    const auto share = [&](Doubles v, int size) {
      const Doubles of_size = hn::Div(v, hn::Mul(p.z, hn::Set(d, static_cast<double>(size))));
      return hn::IfThenElse(in_front, of_size, hn::Set(d, std::numeric_limits<double>::quiet_NaN()));
    };
    const auto store = [&](Doubles v, std::vector<float>* to) {
      hn::StoreU(hn::DemoteTo(df, v), df, to->data() + next);
    };
    store(share(p.x, map.size.width), &edges->x);
    store(share(p.y, map.size.height), &edges->y);
    const Displacements of = DisplacementsOf(load, samples, JacobiansOf(load, samples, map.texel_from_ray));
    const Counts counts = CountsOf(load, samples, of.pixels);
    const Doubles length = hn::IfThenElseZero(of.usable, load(samples.length));
    store(hn::Mul(hn::Mul(length, of.pixels), counts.Share()), &edges->pixels);
    // d/dln along_k of s/4 + t^2 / (12 s): s/4 - t^2/(12 s) for the greater, t^2 / (6 s) for the lesser one,
    // which add up to the whole.
    const Doubles per_pixel = hn::Mul(length, counts.Slope());
    const Doubles t = hn::Min(of.along1, of.along2);
    const Doubles of_lesser =
        hn::Mul(of.scale, hn::Div(hn::Mul(t, t), hn::Mul(hn::Set(d, 6.0), hn::Max(of.along1, of.along2))));
    const Doubles of_greater = hn::Sub(of.pixels, of_lesser);
    const auto slope = [&](hn::Mask<DoubleLanes> is_greater) {
      const Doubles slope_of = hn::Mul(per_pixel, hn::IfThenElse(is_greater, of_greater, of_lesser));
      return hn::IfThenElseZero(of.usable, slope_of);
    };
    store(slope(hn::Ge(of.along1, of.along2)), &edges->per_width);
    store(slope(hn::Lt(of.along1, of.along2)), &edges->per_height);
    next += hn::Lanes(d);
  });
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {
namespace {

HWY_EXPORT(FrobeniusSum);
HWY_EXPORT(EdgeSum);
HWY_EXPORT(EdgeSumOfHeld);
HWY_EXPORT(WriteEdges);

/// ||J^-1||_F^2, or a negative number where the Jacobian is singular or the sample is behind the light's axis
/// plane.
double InverseNormSquared(const BoundarySamples& samples, size_t i, const glm::dmat3& texel_from_ray) {
  const glm::dvec3 r = samples.Ray(i);
  const double w = texel_from_ray[0][2] * r.x + texel_from_ray[1][2] * r.y + texel_from_ray[2][2] * r.z;
  if (!(w > 0.0)) return -1.0;
  const glm::dmat2 jacobian = TexelJacobian(texel_from_ray, r, samples.RayDx1(i), samples.RayDx2(i));
  const double det = glm::determinant(jacobian);
  if (det == 0.0) return -1.0;
  const double squares = glm::dot(jacobian[0], jacobian[0]) + glm::dot(jacobian[1], jacobian[1]);
  return squares / (det * det);
}

}  // namespace

glm::dmat2 TexelJacobian(const glm::dmat3& texel_from_ray, const glm::dvec3& r, const glm::dvec3& dr1,
                         const glm::dvec3& dr2) {
  const glm::dvec3 h_r = texel_from_ray * r;
  const glm::dvec2 u = glm::dvec2(h_r) / h_r.z;
  const glm::dvec3 h_dr1 = texel_from_ray * dr1;
  const glm::dvec3 h_dr2 = texel_from_ray * dr2;
  return {(glm::dvec2(h_dr1) - u * h_dr1.z) / h_r.z, (glm::dvec2(h_dr2) - u * h_dr2.z) / h_r.z};
}

double FrobeniusMetric(const BoundarySamples& samples, const glm::dmat3& texel_from_ray) {
  return HWY_DYNAMIC_DISPATCH(FrobeniusSum)(samples, texel_from_ray);
}

double FrobeniusMedian(const BoundarySamples& samples, const glm::dmat3& texel_from_ray,
                       std::vector<double>* scratch) {
  scratch->clear();
  for (size_t i = 0; i < samples.size(); ++i) {
    const double badness = InverseNormSquared(samples, i, texel_from_ray);
    if (badness >= 0.0) scratch->push_back(badness);
  }
  if (scratch->empty()) return 0.0;
  const auto middle = scratch->begin() + static_cast<std::ptrdiff_t>(scratch->size() / 2);
  std::nth_element(scratch->begin(), middle, scratch->end());
  return *middle;
}

double EdgeDisplacement(const BoundarySamples& samples, size_t i, const glm::dmat3& texel_from_ray) {
  const glm::dvec3 r = samples.Ray(i);
  const glm::dvec3 h_r = texel_from_ray * r;
  if (!(h_r.z > 0.0)) return 0.0;
  // J = w^-2 (h_dr w - h_r.xy h_dr.z), see TexelJacobian; the common factor is left to the end.
  const glm::dvec3 h_dr1 = texel_from_ray * samples.RayDx1(i);
  const glm::dvec3 h_dr2 = texel_from_ray * samples.RayDx2(i);
  const glm::dvec2 j1 = glm::dvec2(h_dr1) * h_r.z - glm::dvec2(h_r) * h_dr1.z;
  const glm::dvec2 j2 = glm::dvec2(h_dr2) * h_r.z - glm::dvec2(h_r) * h_dr2.z;
  const double det = j1.x * j2.y - j1.y * j2.x;
  if (det == 0.0) return 0.0;
  // n^T J^-1, with J^-1 = adj(J) / det.
  const double along1 = std::abs(samples.n1[i] * j2.y - samples.n2[i] * j1.y);
  const double along2 = std::abs(samples.n2[i] * j1.x - samples.n1[i] * j2.x);
  const double s = std::max(along1, along2);
  const double t = std::min(along1, along2);
  if (!(s > 0.0)) return 0.0;
  return (0.25 * s + t * t / (12.0 * s)) * (h_r.z * h_r.z / std::abs(det));
}

double EdgeMetricOfSample(const BoundarySamples& samples, size_t i, const glm::dmat3& texel_from_ray) {
  return EdgePixels(samples.length[i], EdgeDisplacement(samples, i, texel_from_ray), samples.limit,
                    samples.tail[i]);
}

double EdgeMetric(const BoundarySamples& samples, const glm::dmat3& texel_from_ray) {
  return HWY_DYNAMIC_DISPATCH(EdgeSum)(samples, texel_from_ray);
}

double EdgeMetricOfHeld(const BoundarySamples& samples, std::span<const ShadowProjection> maps) {
  return HWY_DYNAMIC_DISPATCH(EdgeSumOfHeld)(samples, maps);
}

void AppendEdges(const BoundarySamples& samples, const ShadowProjection& map, EdgesOnMap* edges) {
  constexpr size_t kMostDoubles = 8;  // Lanes of a vector.
  const size_t first = edges->x.size();
  const auto resize = [&](size_t size) {
    for (std::vector<float>* lane :
         {&edges->x, &edges->y, &edges->pixels, &edges->per_width, &edges->per_height})
      lane->resize(size);
  };
  resize(first + samples.size() + kMostDoubles);
  HWY_DYNAMIC_DISPATCH(WriteEdges)(samples, map, first, edges);
  resize(first + samples.size());
}

}  // namespace shadowfit
#endif
