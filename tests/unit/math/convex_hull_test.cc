#include "core/math/convex_hull.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

namespace shadowfit {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

double Cross(const glm::dvec2& a, const glm::dvec2& b) { return a.x * b.y - a.y * b.x; }

/// A point is a hull vertex exactly when the directions from it to all others fit in an open half plane
/// bounded by two lines that are not one: their angles, sorted, have a gap above pi.
std::vector<int> BruteForceVertices(const std::vector<glm::dvec2>& points) {
  std::vector<int> vertices;
  for (size_t i = 0; i < points.size(); ++i) {
    std::vector<double> angles;
    for (const glm::dvec2& p : points) {
      if (p != points[i]) angles.push_back(std::atan2(p.y - points[i].y, p.x - points[i].x));
    }
    std::sort(angles.begin(), angles.end());
    double gap = angles.front() + 2.0 * std::numbers::pi - angles.back();
    for (size_t k = 1; k < angles.size(); ++k) gap = std::max(gap, angles[k] - angles[k - 1]);
    if (gap > std::numbers::pi + 1e-9) vertices.push_back(static_cast<int>(i));
  }
  return vertices;
}

TEST(ConvexHull2, HasTheVerticesThatBruteForceFinds) {
  std::mt19937_64 random(1);
  for (int round = 0; round < 300; ++round) {
    const int count = std::uniform_int_distribution<int>(3, 120)(random);
    // Discs, boxes and thin slivers, some far from the origin.
    const double squash = std::pow(10.0, -std::uniform_int_distribution<int>(0, 4)(random));
    const glm::dvec2 offset(round % 3 == 0 ? 1000.0 : 0.0, round % 5 == 0 ? -500.0 : 0.0);
    std::uniform_real_distribution<double> uniform(-1.0, 1.0);
    std::vector<glm::dvec2> points;
    while (points.size() < static_cast<size_t>(count)) {
      const glm::dvec2 p(uniform(random), uniform(random));
      if (round % 2 == 0 || glm::length(p) < 1.0) points.push_back(offset + p * glm::dvec2(1.0, squash));
    }
    std::vector<int> hull = ConvexHull2(points);
    for (size_t k = 0; k < hull.size(); ++k) {
      const glm::dvec2 a = points[static_cast<size_t>(hull[k])];
      const glm::dvec2 b = points[static_cast<size_t>(hull[(k + 1) % hull.size()])];
      for (const glm::dvec2& p : points) ASSERT_GE(Cross(b - a, p - a), -1e-12) << "counter-clockwise";
    }
    std::sort(hull.begin(), hull.end());
    EXPECT_EQ(hull, BruteForceVertices(points)) << "round " << round;
  }
}

TEST(ConvexHull2, FindsTheVerticesAmongManyThatAreNearlySome) {
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  for (int round = 0; round < 60; ++round) {
    // Rings, and polygons whose sides are jagged: most points are outside the octagon of the extreme ones.
    const int count = 100 + 10 * round;
    const int corners = round % 4 == 0 ? count : 3 + round % 7;
    const double jag = std::pow(10.0, -2.0 - round % 5);
    std::vector<glm::dvec2> points;
    for (int i = 0; i < count; ++i) {
      const auto corner = [&](int k) {
        const double angle = 2.0 * std::numbers::pi * (k + 0.3) / corners;
        return glm::dvec2(std::cos(angle), std::sin(angle));
      };
      const double along = static_cast<double>(i) / count * corners;
      const int side = static_cast<int>(along);
      const glm::dvec2 p = glm::mix(corner(side), corner(side + 1), along - side);
      points.push_back(p * (1.0 + jag * uniform(random)));
      if (i % 9 == 0) points.push_back(points.back());
    }
    std::vector<int> hull = ConvexHull2(points);
    std::sort(hull.begin(), hull.end());
    std::vector<int> expected = BruteForceVertices(points);
    // Of equal points the first.
    std::erase_if(expected, [&](int i) { return i > 0 && points[size_t(i)] == points[size_t(i) - 1]; });
    EXPECT_EQ(hull, expected) << "round " << round;
  }
}

TEST(ConvexHull2, BeginsWithTheLeftmostPoint) {
  const std::vector<glm::dvec2> points = {{1, 1}, {0, 1}, {1, 0}, {0, 0}, {0.5, 0.5}};
  EXPECT_THAT(ConvexHull2(points), ElementsAre(3, 2, 0, 1));
}

TEST(ConvexHull2, DegenerateSets) {
  EXPECT_THAT(ConvexHull2(std::vector<glm::dvec2>{}), IsEmpty());
  EXPECT_THAT(ConvexHull2(std::vector<glm::dvec2>{{2, 3}}), ElementsAre(0));
  EXPECT_THAT(ConvexHull2(std::vector<glm::dvec2>{{2, 3}, {1, 3}}), ElementsAre(1, 0));
  EXPECT_THAT(ConvexHull2(std::vector<glm::dvec2>(100, glm::dvec2(4, 5))), ElementsAre(0));
}

TEST(ConvexHull2, CollinearPointsLeaveTheTwoEnds) {
  for (const glm::dvec2 step : {glm::dvec2(1, 0), glm::dvec2(0, 1), glm::dvec2(2, -3), glm::dvec2(-1, -1)}) {
    std::vector<glm::dvec2> points;
    for (int i = 0; i < 50; ++i) points.push_back(glm::dvec2(7, 11) + double((i * 17) % 50) * step);
    std::vector<int> hull = ConvexHull2(points);
    ASSERT_EQ(hull.size(), 2U);
    EXPECT_DOUBLE_EQ(
        glm::distance(points[static_cast<size_t>(hull[0])], points[static_cast<size_t>(hull[1])]),
        49.0 * glm::length(step));
  }
}

TEST(ConvexHull2, LatticeKeepsItsCornersOnly) {
  std::vector<glm::dvec2> points;
  for (int repeat = 0; repeat < 2; ++repeat) {
    for (int y = 0; y < 20; ++y) {
      for (int x = 0; x < 30; ++x) points.emplace_back(x, y);
    }
  }
  EXPECT_THAT(ConvexHull2(points), ElementsAre(0, 29, 599, 570)) << "and of equal points the first";
}

TEST(ConvexHull2, ScratchIsReusable) {
  std::mt19937_64 random(2);
  std::normal_distribution<double> normal;
  ConvexHullScratch scratch;
  std::vector<int> hull;
  for (const int count : {1000, 3, 200, 1, 0, 5000}) {
    std::vector<glm::dvec2> points;
    for (int i = 0; i < count; ++i) points.emplace_back(normal(random), normal(random));
    ConvexHull2(points, &scratch, &hull);
    EXPECT_EQ(hull, ConvexHull2(points));
  }
}

}  // namespace
}  // namespace shadowfit
