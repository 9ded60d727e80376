#include "core/fit/frobenius_moments.h"

#include <cmath>

namespace shadowfit {
namespace {

using Products = std::array<double, 6>;

Products ProductsOf(const glm::dvec3& v) {
  return {v.x * v.x, v.y * v.y, v.z * v.z, v.x * v.y, v.x * v.z, v.y * v.z};
}

/// v^T M v as a product with M's six different entries.
Products Quadratic(const glm::dvec3& v) {
  return {v.x * v.x, v.y * v.y, v.z * v.z, 2.0 * v.x * v.y, 2.0 * v.x * v.z, 2.0 * v.y * v.z};
}

glm::dmat3 Symmetric(const Products& m) {
  return {glm::dvec3(m[0], m[3], m[4]), glm::dvec3(m[3], m[1], m[5]), glm::dvec3(m[4], m[5], m[2])};
}

}  // namespace

void FrobeniusMoments::Add(const glm::dvec3& ray, const glm::dvec3& ray_dx1, const glm::dvec3& ray_dx2) {
  const glm::dvec3 e1 = glm::cross(ray, ray_dx2);
  const glm::dvec3 e2 = glm::cross(ray_dx1, ray);
  const double det = glm::dot(ray_dx1, -e1);
  const double scale = 1.0 / (det * det);
  if (!std::isfinite(scale)) return;
  const Products of_ray = ProductsOf(ray);
  const Products of_e1 = ProductsOf(e1);
  const Products of_e2 = ProductsOf(e2);
  Products covectors;
  for (size_t l = 0; l < 6; ++l) covectors[l] = (of_e1[l] + of_e2[l]) * scale;
  for (size_t k = 0; k < 6; ++k) {
    for (size_t l = 0; l < 6; ++l) moments_[k][l] += of_ray[k] * covectors[l];
  }
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
