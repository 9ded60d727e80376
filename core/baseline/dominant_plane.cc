#include "core/baseline/dominant_plane.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <random>
#include <vector>

namespace shadowfit {
namespace {

// A plane that holds the share f of the weight is missed by n tries with probability (1 - f^3)^n: once in 600
// times at f = 0.4 by the most tries, and sooner where one that holds more is found.
constexpr int kMostTries = 96;
constexpr double kMayMiss = 1.0 / 600.0;
// Tries are judged on this many samples; the refinement sees all.
constexpr size_t kJudged = 128;
constexpr int kRefinements = 3;
// Smallest spread of the samples across their main direction, as a share of that along it.
constexpr double kThinnest = 1e-6;

double Distance(const glm::dvec4& plane, const glm::dvec3& p) {
  return std::abs(glm::dot(glm::dvec3(plane), p) + plane.w);
}

/// A sample as the tries see it: distances count in units of its tolerance.
struct Judged {
  glm::dvec3 ws_position;
  double inverse_tolerance_squared;
  double weight;
};

/// The capped squares, given up once they exceed `enough`.
double Cost(const glm::dvec4& plane, std::span<const Judged> samples, double enough) {
  double cost = 0.0;
  for (size_t i = 0; i < samples.size() && cost < enough; ++i) {
    const double distance = glm::dot(glm::dvec3(plane), samples[i].ws_position) + plane.w;
    cost += samples[i].weight * std::min(distance * distance * samples[i].inverse_tolerance_squared, 1.0);
  }
  return cost;
}

/// Eigenvalues, ascending, with their eigenvectors, of a symmetric matrix: cyclic Jacobi rotations.
struct Eigen3 {
  std::array<double, 3> values;
  std::array<glm::dvec3, 3> vectors;
};
Eigen3 SymmetricEigen(glm::dmat3 a) {
  glm::dmat3 vectors(1.0);
  for (int sweep = 0; sweep < 16; ++sweep) {
    for (int p = 0; p < 2; ++p) {
      for (int q = p + 1; q < 3; ++q) {
        if (a[p][q] == 0.0) continue;
        // The rotation by the smaller of the two angles that annihilate a_pq.
        const double theta = 0.5 * (a[q][q] - a[p][p]) / a[p][q];
        const double t = std::copysign(1.0, theta) / (std::abs(theta) + std::sqrt(theta * theta + 1.0));
        const double c = 1.0 / std::sqrt(t * t + 1.0);
        glm::dmat3 rotation(1.0);
        rotation[p][p] = rotation[q][q] = c;
        rotation[q][p] = t * c;
        rotation[p][q] = -t * c;
        a = glm::transpose(rotation) * a * rotation;
        vectors = vectors * rotation;
      }
    }
  }
  std::array<int, 3> order = {0, 1, 2};
  std::sort(order.begin(), order.end(), [&a](int i, int j) { return a[i][i] < a[j][j]; });
  Eigen3 eigen;
  for (size_t i = 0; i < 3; ++i) {
    eigen.values[i] = a[order[i]][order[i]];
    eigen.vectors[i] = vectors[order[i]];
  }
  return eigen;
}

/// Weighted least squares over the samples that the plane holds.
std::optional<glm::dvec4> Refine(const glm::dvec4& plane, std::span<const PlaneSample> samples) {
  double total = 0.0;
  glm::dvec3 sum(0.0);
  std::vector<double> weights;
  weights.reserve(samples.size());
  for (const PlaneSample& sample : samples) {
    const bool held = Distance(plane, sample.ws_position) < sample.tolerance;
    weights.push_back(held ? sample.weight / (sample.tolerance * sample.tolerance) : 0.0);
    total += weights.back();
    sum += weights.back() * sample.ws_position;
  }
  if (!(total > 0.0)) return std::nullopt;
  const glm::dvec3 center = sum / total;
  glm::dmat3 covariance(0.0);
  for (size_t i = 0; i < samples.size(); ++i) {
    if (weights[i] == 0.0) continue;
    const glm::dvec3 p = samples[i].ws_position - center;
    covariance += glm::outerProduct(weights[i] * p, p);
  }
  const Eigen3 eigen = SymmetricEigen(covariance);
  if (!(eigen.values[1] > kThinnest * kThinnest * eigen.values[2])) return std::nullopt;
  const glm::dvec3 n = glm::normalize(eigen.vectors[0]);
  return glm::dvec4(n, -glm::dot(n, center));
}

}  // namespace

std::optional<glm::dvec4> DominantPlane(std::span<const PlaneSample> samples) {
  if (samples.size() < 3) return std::nullopt;
  std::vector<Judged> judged;
  judged.reserve(kJudged);
  double total = 0.0;
  const size_t stride = (samples.size() + kJudged - 1) / kJudged;
  for (size_t i = 0; i < samples.size(); i += stride) {
    const double tolerance = samples[i].tolerance;
    judged.push_back({samples[i].ws_position, 1.0 / (tolerance * tolerance), samples[i].weight});
    total += samples[i].weight;
  }

  std::optional<glm::dvec4> best;
  double best_cost = HUGE_VAL;
  std::minstd_rand random(1);
  const auto draw = [&] { return samples[random() % samples.size()].ws_position; };
  double tries = kMostTries;
  for (int attempt = 0; attempt < tries; ++attempt) {
    const glm::dvec3 a = draw();
    const glm::dvec3 ab = draw() - a;
    const glm::dvec3 ac = draw() - a;
    const glm::dvec3 normal = glm::cross(ab, ac);
    const double length = glm::length(normal);
    if (!(length > kThinnest * glm::length(ab) * glm::length(ac))) continue;
    const glm::dvec3 n = normal / length;
    const glm::dvec4 plane(n, -glm::dot(n, a));
    const double cost = Cost(plane, judged, best_cost);
    if (!(cost < best_cost)) continue;
    best_cost = cost;
    best = plane;
    const double held = std::max(0.0, 1.0 - cost / total);
    tries = std::min<double>(kMostTries, std::log(kMayMiss) / std::log1p(-held * held * held));
  }
  for (int i = 0; best && i < kRefinements; ++i) best = Refine(*best, samples);
  return best;
}

}  // namespace shadowfit
