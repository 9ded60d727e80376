#include "core/fit/metric.h"

#include <algorithm>
#include <cmath>

namespace shadowfit {
namespace {

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
  double sum = 0.0;
  for (size_t i = 0; i < samples.size(); ++i) {
    const double badness = InverseNormSquared(samples, i, texel_from_ray);
    if (badness >= 0.0) sum += badness;
  }
  return sum;
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

double EdgeMetricOfSample(const BoundarySamples& samples, size_t i, const glm::dmat3& texel_from_ray) {
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
  return samples.length[i] * (0.25 * s + t * t / (12.0 * s)) * (h_r.z * h_r.z / std::abs(det));
}

double EdgeMetric(const BoundarySamples& samples, const glm::dmat3& texel_from_ray) {
  double sum = 0.0;
  for (size_t i = 0; i < samples.size(); ++i) sum += EdgeMetricOfSample(samples, i, texel_from_ray);
  return sum;
}

}  // namespace shadowfit
