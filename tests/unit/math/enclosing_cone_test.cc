#include "core/math/enclosing_cone.h"

#include <gtest/gtest.h>

#include <cmath>
#include <optional>
#include <random>
#include <vector>

namespace shadowfit {
namespace {

double Uniform(std::mt19937& random, double low, double high) {
  return low + (high - low) * (static_cast<double>(random()) / 4294967296.0);
}

glm::dvec3 RandomDirection(std::mt19937& random) {
  for (;;) {
    const glm::dvec3 v(Uniform(random, -1, 1), Uniform(random, -1, 1), Uniform(random, -1, 1));
    if (const double length = glm::length(v); length > 0.1 && length < 1.0) return v / length;
  }
}

/// Smallest cosine to the axis.
double Cosine(const glm::dvec3& axis, const std::vector<glm::dvec3>& rays) {
  double smallest = 1.0;
  for (const glm::dvec3& r : rays) smallest = std::min(smallest, glm::dot(axis, r) / glm::length(r));
  return smallest;
}

/// The best axis among all that two or three rays define: the smallest cone is one of them.
double BestCosineByBruteForce(const std::vector<glm::dvec3>& rays) {
  std::vector<glm::dvec3> unit;
  for (const glm::dvec3& r : rays) unit.push_back(glm::normalize(r));
  double best = -1.0;
  const auto consider = [&](const glm::dvec3& axis) {
    const double length = glm::length(axis);
    if (length > 1e-12) best = std::max(best, Cosine(axis / length, rays));
  };
  for (size_t i = 0; i < unit.size(); ++i) {
    consider(unit[i]);
    for (size_t j = 0; j < i; ++j) {
      consider(unit[i] + unit[j]);
      for (size_t k = 0; k < j; ++k) {
        const glm::dvec3 normal = glm::cross(unit[j] - unit[i], unit[k] - unit[i]);
        consider(normal);
        consider(-normal);
      }
    }
  }
  return best;
}

TEST(SmallestEnclosingCone, EqualsBruteForce) {
  std::mt19937 random(1);
  for (int trial = 0; trial < 1000; ++trial) {
    const glm::dvec3 center = RandomDirection(random);
    const double width = std::pow(10.0, Uniform(random, -4.0, 0.3));
    std::vector<glm::dvec3> rays;
    const int count = 1 + static_cast<int>(random() % 12);
    for (int i = 0; i < count; ++i) {
      rays.push_back((center + width * RandomDirection(random)) * Uniform(random, 0.1, 10.0));
    }
    const double best = BestCosineByBruteForce(rays);
    const std::optional<EnclosingCone> cone = SmallestEnclosingCone(rays);
    if (best < 1e-6) {
      EXPECT_FALSE(cone.has_value() && cone->cos_half_angle > 1e-5) << "trial " << trial;
      continue;
    }
    ASSERT_TRUE(cone.has_value()) << "trial " << trial;
    EXPECT_NEAR(glm::length(cone->axis), 1.0, 1e-12);
    EXPECT_NEAR(cone->cos_half_angle, best, 1e-9);
    EXPECT_NEAR(cone->cos_half_angle, Cosine(cone->axis, rays), 1e-12);
  }
}

TEST(SmallestEnclosingCone, HasNoneForNothingAndForRaysAllAround) {
  EXPECT_FALSE(SmallestEnclosingCone({}).has_value());
  const std::vector<glm::dvec3> zero = {{0, 0, 0}};
  EXPECT_FALSE(SmallestEnclosingCone(zero).has_value());
  const std::vector<glm::dvec3> opposite = {{1, 0, 0}, {-1, 0, 0}};
  EXPECT_FALSE(SmallestEnclosingCone(opposite).has_value());
}

TEST(SmallestEnclosingCone, GivesUpOnAFullSphereInTime) {
  // Without its early exit the construction takes cubic time here, which for this many rays is hours.
  std::mt19937 random(2);
  std::vector<glm::dvec3> rays;
  for (int i = 0; i < 50000; ++i) rays.push_back(RandomDirection(random));
  EXPECT_FALSE(SmallestEnclosingCone(rays).has_value());
}

TEST(SmallestEnclosingCone, DoesNotMindDuplicatesAndOrder) {
  const std::vector<glm::dvec3> rays(1000, glm::dvec3(0, 0, 5));
  const std::optional<EnclosingCone> cone = SmallestEnclosingCone(rays);
  ASSERT_TRUE(cone.has_value());
  EXPECT_NEAR(cone->cos_half_angle, 1.0, 1e-12);
}

}  // namespace
}  // namespace shadowfit
