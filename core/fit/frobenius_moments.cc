#include "core/fit/frobenius_moments.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/fit/frobenius_moments.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/fit/boundary_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

/// Adds the samples' products to `moments`.
void AddMoments(const BoundarySamples& samples, const glm::dmat3& normalized_from_ray, double moments[6][6]) {
  const DoubleLanes d;
  std::array<std::array<Doubles, 6>, 6> sums;
  for (auto& row : sums) row.fill(hn::Zero(d));
  ForBoundaryLanes(samples.size(), [&](const auto& load) {
    const Doubles3 p = Times(normalized_from_ray, load(samples.r));
    const Doubles3 dp1 = Times(normalized_from_ray, load(samples.dr1));
    const Doubles3 e1 = Cross(p, Times(normalized_from_ray, load(samples.dr2)));
    const Doubles3 e2 = Cross(dp1, p);
    const Doubles det = Dot(dp1, e1);  // -D.
    const Doubles scale = hn::Div(hn::Set(d, 1.0), hn::Mul(det, det));
    const auto usable = hn::IsFinite(scale);
    const Doubles rays[6] = {hn::Mul(p.x, p.x), hn::Mul(p.y, p.y), hn::Mul(p.z, p.z),
                             hn::Mul(p.x, p.y), hn::Mul(p.x, p.z), hn::Mul(p.y, p.z)};
    const auto covector = [&](Doubles a1, Doubles b1, Doubles a2, Doubles b2) {
      return hn::IfThenElseZero(usable, hn::Mul(hn::Add(hn::Mul(a1, b1), hn::Mul(a2, b2)), scale));
    };
    const Doubles covectors[6] = {covector(e1.x, e1.x, e2.x, e2.x), covector(e1.y, e1.y, e2.y, e2.y),
                                  covector(e1.z, e1.z, e2.z, e2.z), covector(e1.x, e1.y, e2.x, e2.y),
                                  covector(e1.x, e1.z, e2.x, e2.z), covector(e1.y, e1.z, e2.y, e2.z)};
    for (size_t k = 0; k < 6; ++k) {
      const Doubles ray = hn::IfThenElseZero(usable, rays[k]);
      for (size_t l = 0; l < 6; ++l) sums[k][l] = hn::Add(sums[k][l], hn::Mul(ray, covectors[l]));
    }
  });
  for (size_t k = 0; k < 6; ++k) {
    for (size_t l = 0; l < 6; ++l) moments[k][l] += hn::GetLane(hn::SumOfLanes(d, sums[k][l]));
  }
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {
namespace {

HWY_EXPORT(AddMoments);

using Products = std::array<double, 6>;

/// v^T M v as a product with M's six different entries.
Products Quadratic(const glm::dvec3& v) {
  return {v.x * v.x, v.y * v.y, v.z * v.z, 2.0 * v.x * v.y, 2.0 * v.x * v.z, 2.0 * v.y * v.z};
}

glm::dmat3 Symmetric(const Products& m) {
  return {glm::dvec3(m[0], m[3], m[4]), glm::dvec3(m[3], m[1], m[5]), glm::dvec3(m[4], m[5], m[2])};
}

}  // namespace

FrobeniusMoments::FrobeniusMoments(const BoundarySamples& samples, const glm::dmat3& normalized_from_ray) {
  HWY_DYNAMIC_DISPATCH(AddMoments)(samples, normalized_from_ray, moments_);
}

glm::dmat3 FrobeniusMoments::WeightedCovectors(const glm::dvec3& a) const {
  const Products weights = Quadratic(a);
  Products sum{};
  for (size_t k = 0; k < 6; ++k) {
    for (size_t l = 0; l < 6; ++l) sum[l] += weights[k] * moments_[k][l];
  }
  return Symmetric(sum);
}

glm::dmat3 FrobeniusMoments::WeightedRays(const glm::dvec3& c) const {
  const Products weights = Quadratic(c);
  Products sum{};
  for (size_t k = 0; k < 6; ++k) {
    for (size_t l = 0; l < 6; ++l) sum[k] += weights[l] * moments_[k][l];
  }
  return Symmetric(sum);
}

double FrobeniusMoments::Value(const glm::dmat3& texel_from_ray) const {
  const glm::dmat3 rows = glm::transpose(texel_from_ray);
  const glm::dmat3 q = WeightedCovectors(rows[2]);
  const glm::dvec3 c1 = glm::cross(rows[1], rows[2]);
  const glm::dvec3 c2 = glm::cross(rows[2], rows[0]);
  const double det = glm::dot(rows[0], c1);
  return (glm::dot(c1, q * c1) + glm::dot(c2, q * c2)) / (det * det);
}

glm::dvec3 FrobeniusMoments::AxisGradient(const glm::dmat3& texel_from_ray) const {
  const glm::dmat3 rows = glm::transpose(texel_from_ray);
  const glm::dmat3 q = WeightedCovectors(rows[2]);
  const glm::dvec3 c1 = glm::cross(rows[1], rows[2]);
  const glm::dvec3 c2 = glm::cross(rows[2], rows[0]);
  const glm::dvec3 q_c1 = q * c1;
  const glm::dvec3 q_c2 = q * c2;
  const glm::dvec3 det_gradient = glm::cross(rows[0], rows[1]);
  const double det = glm::dot(rows[2], det_gradient);
  const double numerator = glm::dot(c1, q_c1) + glm::dot(c2, q_c2);
  // h3 moves Q's weights, c1 = h2 x h3, c2 = h3 x h1 and the determinant.
  const glm::dvec3 numerator_gradient = 2.0 * ((WeightedRays(c1) + WeightedRays(c2)) * rows[2] +
                                               glm::cross(q_c1, rows[1]) + glm::cross(rows[0], q_c2));
  return numerator_gradient / (det * det) - (2.0 * numerator / (det * det * det)) * det_gradient;
}

}  // namespace shadowfit
#endif
