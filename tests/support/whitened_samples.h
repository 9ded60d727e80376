#pragma once

#include <cmath>
#include <numbers>
#include <random>
#include <vector>

#include "core/fit/edge_kernels.h"
#include "core/fit/whitened_samples.h"
#include "core/math/convex_hull.h"
#include "tests/support/analytic_scene.h"

namespace shadowfit::testing {

/// A polygon about the origin that a whitened hull might be, and edges that favour some direction and some
/// part of the hull.
inline WhitenedSamples RandomWhitenedSamples(std::mt19937& random, int count) {
  WhitenedSamples samples;
  std::vector<glm::dvec2> points;
  const int corners = 4 + static_cast<int>(random() % 12);
  for (int i = 0; i < corners; ++i) {
    const double angle = 2.0 * std::numbers::pi * (i + Uniform(random, 0.0, 0.8)) / corners;
    points.push_back(Uniform(random, 1.0, 2.2) * glm::dvec2(std::cos(angle), std::sin(angle)));
  }
  for (const int i : ConvexHull2(points)) samples.hull.push_back(points[static_cast<size_t>(i)]);
  const double favoured = Uniform(random, 0.0, std::numbers::pi);
  const double spread = Uniform(random, 0.2, 2.0);
  const glm::dvec2 slope(Uniform(random, -1.0, 1.0), Uniform(random, -1.0, 1.0));
  while (samples.x.size() < static_cast<size_t>(count)) {
    const size_t i = random() % samples.hull.size();
    const glm::dvec2 a = samples.hull[i];
    const glm::dvec2 b = samples.hull[(i + 1) % samples.hull.size()];
    const glm::dvec2 x = (a + Uniform(random, 0.0, 1.0) * (b - a)) * std::sqrt(Uniform(random, 0.0, 1.0));
    const double angle = favoured + spread * Uniform(random, -1.0, 1.0);
    const double length = std::exp(glm::dot(slope, x)) * Uniform(random, 1.0, 20.0);
    samples.x.push_back(static_cast<float>(x.x));
    samples.y.push_back(static_cast<float>(x.y));
    samples.e1.push_back(static_cast<float>(length * std::cos(angle)));
    samples.e2.push_back(static_cast<float>(length * std::sin(angle)));
    // The plane through light and edge holds the ray: e . p = 0.
    samples.e3.push_back(static_cast<float>(-length * (std::cos(angle) * x.x + std::sin(angle) * x.y)));
  }
  while (samples.x.size() % kEdgeLanes != 0) {
    for (std::vector<float>* lane : {&samples.x, &samples.y, &samples.e1, &samples.e2, &samples.e3}) {
      lane->push_back(0.0f);
    }
  }
  for (std::vector<float>* lane : {&samples.inverse_limit, &samples.inverse_tail_limit, &samples.tail}) {
    lane->resize(samples.x.size(), 0.0f);
  }
  return samples;
}

}  // namespace shadowfit::testing
