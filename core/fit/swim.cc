#include "core/fit/swim.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "core/fit/metric.h"

namespace shadowfit {
namespace {

/// A mean needs no more; the samples are taken evenly.
constexpr size_t kMostSamples = 512;

std::optional<double> MotionOf(const BoundarySamples& samples, size_t i, const glm::dmat3& ray_from_previous,
                               const ShadowProjection& previous, const ShadowProjection& current) {
  const glm::dvec3 ray = samples.Ray(i);
  if (!previous.Holds(ray) || !current.Holds(ray)) return std::nullopt;
  const glm::dmat2 texel_from_pixel =
      TexelJacobian(current.texel_from_ray, ray, samples.RayDx1(i), samples.RayDx2(i));
  const double determinant = glm::determinant(texel_from_pixel);
  const glm::dvec2 center = glm::floor(glm::dvec2(previous.TexelFromRay(ray))) + 0.5;
  const glm::dvec3 moved = current.TexelFromRay(ray_from_previous * glm::dvec3(center, 1.0));
  if (determinant == 0.0 || !(moved.z > 0.0)) return std::nullopt;
  const double distance = DistanceToLattice(glm::inverse(texel_from_pixel), glm::dvec2(moved) - 0.5);
  if (!std::isfinite(distance)) return std::nullopt;
  return distance;
}

std::optional<double> MeanOver(const BoundarySamples& samples, const ShadowProjection& previous,
                               const ShadowProjection& current) {
  const glm::dmat3 ray_from_previous = glm::inverse(previous.texel_from_ray);
  const size_t step = std::max<size_t>(1, samples.size() / kMostSamples);
  double sum = 0.0;
  double weights = 0.0;
  for (size_t i = step / 2; i < samples.size(); i += step) {
    const std::optional<double> motion = MotionOf(samples, i, ray_from_previous, previous, current);
    if (!motion) continue;
    sum += samples.length[i] * *motion;
    weights += samples.length[i];
  }
  if (!(weights > 0.0)) return std::nullopt;
  return sum / weights;
}

}  // namespace

double DistanceToLattice(const glm::dmat2& basis, const glm::dvec2& e) {
  // Gauss and Lagrange's reduction: of a reduced basis, the nearest lattice point is a corner of the cell
  // that holds the point.
  glm::dvec2 a = basis[0];
  glm::dvec2 b = basis[1];
  const glm::dvec2 point = basis * (e - glm::round(e));
  constexpr int kMostSteps = 64;
  for (int step = 0; step < kMostSteps; ++step) {
    if (glm::dot(a, a) > glm::dot(b, b)) std::swap(a, b);
    const double steps = std::round(glm::dot(a, b) / glm::dot(a, a));
    if (steps == 0.0 || !std::isfinite(steps)) break;
    b -= steps * a;
  }
  const glm::dmat2 reduced(a, b);
  const glm::dvec2 place = glm::inverse(reduced) * point;
  const glm::dvec2 within = place - glm::floor(place);
  double least = std::numeric_limits<double>::infinity();
  for (int corner = 0; corner < 4; ++corner) {
    least = std::min(least, glm::length(reduced * (within - glm::dvec2(corner & 1, corner >> 1))));
  }
  return least;
}

std::optional<double> MeanSwim(const LightSamples& samples, const ShadowProjection& previous,
                               const ShadowProjection& current) {
  if (samples.boundary.size() > 0) return MeanOver(samples.boundary, previous, current);
  return MeanOver(samples.rough_boundary, previous, current);
}

}  // namespace shadowfit
