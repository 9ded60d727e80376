#include "core/fit/swim.h"

#include <algorithm>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/fit/swim.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/fit/boundary_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

struct Doubles2 {
  Doubles x, y;
};

HWY_INLINE Doubles Dot(const Doubles2& a, const Doubles2& b) {
  return hn::Add(hn::Mul(a.x, b.x), hn::Mul(a.y, b.y));
}
/// a u + b v
HWY_INLINE Doubles2 Combined(const Doubles2& a, Doubles u, const Doubles2& b, Doubles v) {
  return {hn::Add(hn::Mul(a.x, u), hn::Mul(b.x, v)), hn::Add(hn::Mul(a.y, u), hn::Mul(b.y, v))};
}

/// DistanceToLattice of the lattice of columns a and b.
HWY_INLINE Doubles LatticeDistance(Doubles2 a, Doubles2 b, const Doubles2& e) {
  const DoubleLanes d;
  const auto zero = hn::Zero(d);
  const auto one = hn::Set(d, 1.0);
  // Gauss and Lagrange's reduction: of a reduced basis, the nearest lattice point is a corner of the cell
  // that holds the point.
  const Doubles2 point = Combined(a, hn::Sub(e.x, hn::Round(e.x)), b, hn::Sub(e.y, hn::Round(e.y)));
  constexpr int kMostSteps = 64;
  for (int step = 0; step < kMostSteps; ++step) {
    const auto swap = hn::Gt(Dot(a, a), Dot(b, b));
    const Doubles2 shorter{hn::IfThenElse(swap, b.x, a.x), hn::IfThenElse(swap, b.y, a.y)};
    b = {hn::IfThenElse(swap, a.x, b.x), hn::IfThenElse(swap, a.y, b.y)};
    a = shorter;
    auto steps = hn::Round(hn::Div(Dot(a, b), Dot(a, a)));
    steps = hn::IfThenElseZero(hn::IsFinite(steps), steps);
    if (hn::AllTrue(d, hn::Eq(steps, zero))) break;
    b = Combined(b, one, a, hn::Neg(steps));
  }
  const auto inverse_det = hn::Div(one, hn::Sub(hn::Mul(a.x, b.y), hn::Mul(a.y, b.x)));
  const auto along_a = hn::Mul(hn::Sub(hn::Mul(b.y, point.x), hn::Mul(b.x, point.y)), inverse_det);
  const auto along_b = hn::Mul(hn::Sub(hn::Mul(a.x, point.y), hn::Mul(a.y, point.x)), inverse_det);
  const auto in_a = hn::Sub(along_a, hn::Floor(along_a));
  const auto in_b = hn::Sub(along_b, hn::Floor(along_b));
  const auto squared = [&](Doubles u, Doubles v) {
    const Doubles2 apart = Combined(a, u, b, v);
    return Dot(apart, apart);
  };
  const auto out_a = hn::Sub(in_a, one);
  const auto out_b = hn::Sub(in_b, one);
  return hn::Sqrt(hn::Min(hn::Min(squared(in_a, in_b), squared(out_a, in_b)),
                          hn::Min(squared(in_a, out_b), squared(out_a, out_b))));
}

double DistanceOfOne(const glm::dmat2& basis, const glm::dvec2& e) {
  const auto set = [](const glm::dvec2& v) {
    return Doubles2{hn::Set(DoubleLanes(), v.x), hn::Set(DoubleLanes(), v.y)};
  };
  return hn::GetLane(LatticeDistance(set(basis[0]), set(basis[1]), set(e)));
}

/// Texel coordinates and w = h3.r, as ShadowProjection::TexelFromRay.
HWY_INLINE Doubles3 Texel(const glm::dmat3& texel_from_ray, const Doubles3& r) {
  const Doubles3 h = Times(texel_from_ray, r);
  const Doubles per_w = hn::Div(hn::Set(DoubleLanes(), 1.0), h.z);
  return {hn::Mul(h.x, per_w), hn::Mul(h.y, per_w), h.z};
}

HWY_INLINE hn::Mask<DoubleLanes> IsWithin(const Doubles3& texel, MapSize size) {
  const DoubleLanes d;
  const auto zero = hn::Zero(d);
  const auto between = [&](Doubles u, int most) {
    return hn::And(hn::Ge(u, zero), hn::Le(u, hn::Set(d, static_cast<double>(most))));
  };
  return hn::And(hn::Gt(texel.z, zero), hn::And(between(texel.x, size.width), between(texel.y, size.height)));
}

/// The mean over every stride-th sample.
std::optional<double> MeanMotion(const BoundarySamples& samples, size_t stride,
                                 const ShadowProjection& previous, const ShadowProjection& current) {
  const DoubleLanes d;
  const auto half = hn::Set(d, 0.5);
  const glm::dmat3 current_from_previous = current.texel_from_ray * glm::inverse(previous.texel_from_ray);
  auto sum = hn::Zero(d);
  auto weights = hn::Zero(d);
  ForSomeBoundaryLanes(stride / 2, stride, samples.size(), [&](const auto& load) {
    const Doubles3 ray = load(samples.r);
    const Doubles3 before = Texel(previous.texel_from_ray, ray);
    const Doubles3 now = Texel(current.texel_from_ray, ray);
    const Doubles3 center{hn::Add(hn::Floor(before.x), half), hn::Add(hn::Floor(before.y), half),
                          hn::Set(d, 1.0)};
    const Doubles3 moved = Texel(current_from_previous, center);
    // The columns of J (see TexelJacobian), and those of its inverse.
    const auto one = hn::Set(d, 1.0);
    const auto per_w = hn::Div(one, now.z);
    const auto column = [&](const Doubles3& along) {
      const Doubles3 h = Times(current.texel_from_ray, along);
      return Doubles2{hn::Mul(hn::Sub(h.x, hn::Mul(now.x, h.z)), per_w),
                      hn::Mul(hn::Sub(h.y, hn::Mul(now.y, h.z)), per_w)};
    };
    const Doubles2 j1 = column(load(samples.dr1));
    const Doubles2 j2 = column(load(samples.dr2));
    const auto per_det = hn::Div(one, hn::Sub(hn::Mul(j1.x, j2.y), hn::Mul(j1.y, j2.x)));
    const Doubles2 step1{hn::Mul(j2.y, per_det), hn::Neg(hn::Mul(j1.y, per_det))};
    const Doubles2 step2{hn::Neg(hn::Mul(j2.x, per_det)), hn::Mul(j1.x, per_det)};
    const auto distance = LatticeDistance(step1, step2, {hn::Sub(moved.x, half), hn::Sub(moved.y, half)});
    const auto counts = hn::And(hn::And(IsWithin(before, previous.size), IsWithin(now, current.size)),
                                hn::And(hn::Gt(moved.z, hn::Zero(d)), hn::IsFinite(distance)));
    const auto weight = hn::IfThenElseZero(counts, load(samples.length));
    sum = hn::Add(sum, hn::IfThenElseZero(counts, hn::Mul(weight, distance)));
    weights = hn::Add(weights, weight);
  });
  const double weight = hn::GetLane(hn::SumOfLanes(d, weights));
  if (!(weight > 0.0)) return std::nullopt;
  return hn::GetLane(hn::SumOfLanes(d, sum)) / weight;
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {

HWY_EXPORT(DistanceOfOne);
HWY_EXPORT(MeanMotion);

double DistanceToLattice(const glm::dmat2& basis, const glm::dvec2& e) {
  return HWY_DYNAMIC_DISPATCH(DistanceOfOne)(basis, e);
}

std::optional<double> MeanSwim(const LightSamples& samples, const ShadowProjection& previous,
                               const ShadowProjection& current) {
  // A mean needs no more; the samples are taken evenly.
  constexpr size_t kMostSamples = 384;
  const BoundarySamples& boundary = samples.boundary.size() > 0 ? samples.boundary : samples.rough_boundary;
  const size_t stride = std::max<size_t>(1, (boundary.size() + kMostSamples - 1) / kMostSamples);
  return HWY_DYNAMIC_DISPATCH(MeanMotion)(boundary, stride, previous, current);
}

}  // namespace shadowfit
#endif
