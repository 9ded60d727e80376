#include "core/fit/outline.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

#include "tests/support/analytic_scene.h"

namespace shadowfit {
namespace {

using testing::Uniform;

const glm::dmat3 kMap(glm::dvec3(30, 4, 0.1), glm::dvec3(-5, 20, -0.2), glm::dvec3(7, 9, 1.0));

LightSamples RandomSamples(std::mt19937& random, int count) {
  LightSamples samples;
  for (int i = 0; i < count; ++i) {
    const double length = Uniform(random, 0.5, 5.0);
    samples.hull_rays.push_back(length * glm::dvec3(Uniform(random, -1, 1), Uniform(random, -1, 1), 1.0));
    samples.hull_in_shadow.push_back(random() % 3 == 0 ? 1 : 0);
  }
  samples.hull_in_shadow[0] = 1;
  return samples;
}

/// How far samples reach along a direction of the map's plane.
double Reach(const LightSamples& samples, double angle, const std::vector<int32_t>& of) {
  double most = -HUGE_VAL;
  for (const int32_t i : of) {
    const glm::dvec3 h = kMap * samples.hull_rays[static_cast<size_t>(i)];
    most = std::max(most, (std::cos(angle) * h.x + std::sin(angle) * h.y) / h.z);
  }
  return most;
}

std::vector<int32_t> InShadow(const LightSamples& samples) {
  std::vector<int32_t> chosen;
  for (size_t i = 0; i < samples.hull_rays.size(); ++i) {
    if (samples.hull_in_shadow[i] != 0) chosen.push_back(static_cast<int32_t>(i));
  }
  return chosen;
}

TEST(OutlineOf, ReachesAsFarAsTheSamplesInItsDirectionsAndNearlySoBetween) {
  std::mt19937 random(3);
  for (int trial = 0; trial < 200; ++trial) {
    const LightSamples samples = RandomSamples(random, 32 + static_cast<int>(random() % 300));
    const auto outline = OutlineOf(samples, kMap);
    ASSERT_TRUE(outline.has_value());
    const std::vector<int32_t> all = InShadow(samples);
    for (const int32_t i : *outline) EXPECT_NE(samples.hull_in_shadow[static_cast<size_t>(i)], 0);
    for (int k = 0; k < 2 * kOutlineDirections; ++k) {
      const double angle = std::numbers::pi * k / kOutlineDirections;
      const double reach = Reach(samples, angle, all);
      if (k % 2 == 0) {
        EXPECT_NEAR(Reach(samples, angle, {(*outline)[static_cast<size_t>(k / 2)]}), reach, 1e-9);
      } else {
        const double back = angle + std::numbers::pi;
        const double width = reach + Reach(samples, back, all);
        EXPECT_GE(Reach(samples, angle, *outline) + Reach(samples, back, *outline), 0.9 * width);
      }
    }
  }
}

TEST(OutlineOf, TakesAllSamplesWhereNoneIsInShadow) {
  std::mt19937 random(4);
  LightSamples samples = RandomSamples(random, 100);
  std::fill(samples.hull_in_shadow.begin(), samples.hull_in_shadow.end(), uint8_t{0});
  const auto none = OutlineOf(samples, kMap);
  std::fill(samples.hull_in_shadow.begin(), samples.hull_in_shadow.end(), uint8_t{1});
  ASSERT_TRUE(none.has_value());
  EXPECT_EQ(none, OutlineOf(samples, kMap));
}

TEST(OutlineOf, HasNoneWhereTheMapDoesNotSeeWhatItMustHold) {
  std::mt19937 random(5);
  LightSamples samples = RandomSamples(random, 100);
  samples.hull_rays[99] *= -1.0;
  samples.hull_in_shadow[99] = 0;
  EXPECT_TRUE(OutlineOf(samples, kMap).has_value());
  samples.hull_in_shadow[99] = 1;
  EXPECT_FALSE(OutlineOf(samples, kMap).has_value());
  samples.hull_rays[99] = glm::dvec3(NAN, 1.0, 1.0);
  EXPECT_FALSE(OutlineOf(samples, kMap).has_value());
  EXPECT_FALSE(OutlineOf(RandomSamples(random, 20), kMap).has_value());
}

}  // namespace
}  // namespace shadowfit
