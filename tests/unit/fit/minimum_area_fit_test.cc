#include "core/fit/minimum_area_fit.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "core/math/convex_hull.h"
#include "tests/support/analytic_scene.h"

namespace shadowfit {
namespace {

using testing::Uniform;

std::vector<glm::dvec2> RandomPolygon(std::mt19937& random, int points) {
  std::vector<glm::dvec2> cloud;
  const glm::dvec2 stretch(Uniform(random, 0.05, 3.0), Uniform(random, 0.05, 3.0));
  const double turn = Uniform(random, 0.0, 3.0);
  for (int i = 0; i < points; ++i) {
    const glm::dvec2 p = stretch * glm::dvec2(Uniform(random, -1, 1), Uniform(random, -1, 1));
    cloud.emplace_back(p.x * std::cos(turn) - p.y * std::sin(turn) + 4.0,
                       p.x * std::sin(turn) + p.y * std::cos(turn));
  }
  std::vector<glm::dvec2> polygon;
  for (const int index : ConvexHull2(cloud)) polygon.push_back(cloud[static_cast<size_t>(index)]);
  return polygon;
}

double TexelArea(const TexelFromPlane& fit) { return 1.0 / glm::determinant(fit.linear); }

TEST(MinimumAreaFit, RectangleEqualsBruteForceOverAngles) {
  std::mt19937 random(1);
  for (int trial = 0; trial < 40; ++trial) {
    const std::vector<glm::dvec2> polygon = RandomPolygon(random, 3 + static_cast<int>(random() % 30));
    if (polygon.size() < 3) continue;
    double least = 1e300;
    for (int step = 0; step < 9000; ++step) {
      const double angle = 0.01 * step * std::numbers::pi / 180.0;
      const glm::dvec2 e(std::cos(angle), std::sin(angle));
      glm::dvec2 low(1e300);
      glm::dvec2 high(-1e300);
      for (const glm::dvec2& p : polygon) {
        const glm::dvec2 q(glm::dot(e, p), glm::dot(glm::dvec2(-e.y, e.x), p));
        low = glm::min(low, q);
        high = glm::max(high, q);
      }
      least = std::min(least, (high.x - low.x) * (high.y - low.y));
    }
    const TexelFromPlane fit = FitMinimumArea(polygon, {100, 100}, /*skew=*/false, /*border=*/0.0);
    const double area = TexelArea(fit) * 100 * 100;
    EXPECT_LE(area, least * (1.0 + 1e-9));
    EXPECT_GE(area, least * (1.0 - 2e-3));
  }
}

TEST(MinimumAreaFit, HoldsThePolygonWithItsBorderAndNeverMirrors) {
  std::mt19937 random(2);
  for (int trial = 0; trial < 3000; ++trial) {
    const std::vector<glm::dvec2> polygon = RandomPolygon(random, 1 + static_cast<int>(random() % 12));
    const MapSize size{1 + static_cast<int>(random() % 500), 1 + static_cast<int>(random() % 500)};
    const bool skew = random() % 2 == 0;
    const double border = Uniform(random, 0.0, 0.2);
    const TexelFromPlane fit = FitMinimumArea(polygon, size, skew, border);
    ASSERT_GT(glm::determinant(fit.linear), 0.0);
    for (const glm::dvec2& p : polygon) {
      const glm::dvec2 u = fit.linear * p + fit.offset;
      EXPECT_GE(u.x, (border - 1e-6) * size.width);
      EXPECT_GE(u.y, (border - 1e-6) * size.height);
      EXPECT_LE(u.x, (1.0 - border + 1e-6) * size.width);
      EXPECT_LE(u.y, (1.0 - border + 1e-6) * size.height);
    }
  }
}

TEST(MinimumAreaFit, SkewNeverCostsAreaAndSavesItOnParallelograms) {
  std::mt19937 random(3);
  for (int trial = 0; trial < 500; ++trial) {
    const std::vector<glm::dvec2> polygon = RandomPolygon(random, 3 + static_cast<int>(random() % 12));
    if (polygon.size() < 3) continue;
    EXPECT_LE(TexelArea(FitMinimumArea(polygon, {64, 64}, true, 0.0)),
              TexelArea(FitMinimumArea(polygon, {64, 64}, false, 0.0)) * (1.0 + 1e-12));
  }
  const std::vector<glm::dvec2> leaning = {{0, 0}, {2, 0}, {3.5, 2}, {1.5, 2}};
  EXPECT_NEAR(TexelArea(FitMinimumArea(leaning, {10, 10}, true, 0.0)) * 100, 4.0, 1e-9);
}

TEST(MinimumAreaFit, MapsTheLongSideToTheLongSide) {
  const std::vector<glm::dvec2> wide = {{0, 0}, {4, 0}, {4, 1}, {0, 1}};
  for (const MapSize size : {MapSize{400, 100}, MapSize{100, 400}}) {
    const TexelFromPlane fit = FitMinimumArea(wide, size, false, 0.0);
    // A unit step along the long side covers 100 texels, and so does one along the short side.
    EXPECT_NEAR(glm::length(fit.linear * glm::dvec2(1, 0)), 100.0, 1e-9);
    EXPECT_NEAR(glm::length(fit.linear * glm::dvec2(0, 1)), 100.0, 1e-9);
  }
}

}  // namespace
}  // namespace shadowfit
