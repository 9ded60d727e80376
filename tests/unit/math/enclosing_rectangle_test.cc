#include "core/math/enclosing_rectangle.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>
#include <vector>

#include "core/math/convex_hull.h"

namespace shadowfit {
namespace {

std::vector<glm::dvec2> Hull(const std::vector<glm::dvec2>& points) {
  std::vector<glm::dvec2> hull;
  for (const int i : ConvexHull2(points)) hull.push_back(points[static_cast<size_t>(i)]);
  return hull;
}

std::vector<glm::dvec2> RandomPoints(std::mt19937_64& random, int count) {
  std::normal_distribution<double> normal;
  const glm::dvec2 offset(10.0 * normal(random), 10.0 * normal(random));
  const double squash = std::exp(normal(random));
  const double angle = normal(random);
  std::vector<glm::dvec2> points;
  for (int i = 0; i < count; ++i) {
    const glm::dvec2 p(normal(random), squash * normal(random));
    points.push_back(offset + glm::dvec2(std::cos(angle) * p.x - std::sin(angle) * p.y,
                                         std::sin(angle) * p.x + std::cos(angle) * p.y));
  }
  return points;
}

void ExpectContains(const EnclosingRectangle& rectangle, const std::vector<glm::dvec2>& points) {
  const glm::dvec2 side(-rectangle.axis.y, rectangle.axis.x);
  EXPECT_NEAR(glm::length(rectangle.axis), 1.0, 1e-14);
  for (const glm::dvec2& p : points) {
    EXPECT_LE(std::abs(glm::dot(p - rectangle.center, rectangle.axis)), 0.5 * rectangle.width + 1e-12);
    EXPECT_LE(std::abs(glm::dot(p - rectangle.center, side)), 0.5 * rectangle.height + 1e-12);
  }
}

TEST(MinimumAreaRectangle, EqualsBruteForceOverHundredthsOfADegree) {
  std::mt19937_64 random(1);
  for (int round = 0; round < 60; ++round) {
    const std::vector<glm::dvec2> points = RandomPoints(random, 3 + round);
    const std::vector<glm::dvec2> hull = Hull(points);
    const EnclosingRectangle rectangle = MinimumAreaRectangle(hull);
    ExpectContains(rectangle, points);
    EXPECT_GE(rectangle.width, rectangle.height);

    double brute_force = HUGE_VAL;
    for (int step = 0; step < 9000; ++step) {
      const double angle = step * 0.01 * std::numbers::pi / 180.0;
      brute_force = std::min(brute_force, RectangleAlong(hull, {std::cos(angle), std::sin(angle)}).Area());
    }
    EXPECT_LE(rectangle.Area(), brute_force * (1.0 + 1e-12));
    // Turning the best rectangle by half a step widens each side by at most the other's length times it.
    const double half_step = 0.005 * std::numbers::pi / 180.0;
    const double w = rectangle.width;
    const double h = rectangle.height;
    EXPECT_GE(rectangle.Area(), brute_force - half_step * 1.01 * (w * w + h * h));
  }
}

TEST(MinimumAreaRectangle, FindsATurnedRectangleItself) {
  for (int degrees = -180; degrees < 180; degrees += 7) {
    const double angle = degrees * std::numbers::pi / 180.0;
    const glm::dvec2 axis(std::cos(angle), std::sin(angle));
    const glm::dvec2 side(-axis.y, axis.x);
    const glm::dvec2 center(3.0, -8.0);
    const std::vector<glm::dvec2> corners = {
        center - 2.0 * axis - 0.5 * side, center + 2.0 * axis - 0.5 * side, center + 2.0 * axis + 0.5 * side,
        center - 2.0 * axis + 0.5 * side};
    const EnclosingRectangle rectangle = MinimumAreaRectangle(corners);
    EXPECT_NEAR(rectangle.width, 4.0, 1e-12);
    EXPECT_NEAR(rectangle.height, 1.0, 1e-12);
    EXPECT_NEAR(glm::distance(rectangle.center, center), 0.0, 1e-12);
    EXPECT_NEAR(std::abs(glm::dot(rectangle.axis, axis)), 1.0, 1e-12);
  }
}

TEST(MinimumAreaRectangle, DegenerateSets) {
  EXPECT_EQ(MinimumAreaRectangle({}).Area(), 0.0);

  const EnclosingRectangle one = MinimumAreaRectangle(std::vector<glm::dvec2>{{2, 3}});
  EXPECT_EQ(one.center, glm::dvec2(2, 3));
  EXPECT_EQ(one.width, 0.0);
  EXPECT_EQ(one.height, 0.0);
  EXPECT_EQ(glm::length(one.axis), 1.0);

  const EnclosingRectangle two = MinimumAreaRectangle(std::vector<glm::dvec2>{{2, 3}, {5, 7}});
  EXPECT_NEAR(two.width, 5.0, 1e-15);
  EXPECT_NEAR(two.height, 0.0, 1e-15);
  EXPECT_NEAR(glm::distance(two.center, glm::dvec2(3.5, 5.0)), 0.0, 1e-15);
  EXPECT_NEAR(std::abs(glm::dot(two.axis, glm::dvec2(0.6, 0.8))), 1.0, 1e-15);

  // Many points on a line that doubles cannot hold exactly: a sliver with next to no height.
  std::vector<glm::dvec2> line;
  for (int i = 0; i < 200; ++i) line.emplace_back(0.1 * i + 3.3, 0.3 * i - 1.7);
  const EnclosingRectangle sliver = MinimumAreaRectangle(Hull(line));
  ExpectContains(sliver, line);
  EXPECT_NEAR(sliver.width, 19.9 * std::sqrt(10.0), 1e-9);
  EXPECT_NEAR(sliver.height, 0.0, 1e-12);
}

TEST(RectangleAlong, IsTheBoundingBoxForTheXAxis) {
  const std::vector<glm::dvec2> points = {{1, 5}, {4, 2}, {-2, 3}};
  const EnclosingRectangle box = RectangleAlong(points, {1.0, 0.0});
  EXPECT_EQ(box.center, glm::dvec2(1.0, 3.5));
  EXPECT_EQ(box.width, 6.0);
  EXPECT_EQ(box.height, 3.0);
}

}  // namespace
}  // namespace shadowfit
