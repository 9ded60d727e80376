#include "core/fit/edge_objective.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>
#include <vector>

#include "tests/support/whitened_samples.h"

namespace shadowfit {
namespace {

using testing::RandomWhitenedSamples;
using testing::Uniform;
using Parameters = EdgeObjective::Parameters;

Parameters RandomParameters(std::mt19937& random) {
  const double angle = Uniform(random, -std::numbers::pi, std::numbers::pi);
  return {Uniform(random, -0.25, 0.25), Uniform(random, -0.25, 0.25), angle,
          angle + Uniform(random, 0.5, 2.5), Uniform(random, -0.8, 0.8)};
}

TEST(EdgeObjective, AgreesWithTheSearchAtOneAxis) {
  std::mt19937 random(1);
  for (int trial = 0; trial < 50; ++trial) {
    const WhitenedSamples samples = RandomWhitenedSamples(random, 300);
    const MapSize size{400, random() % 2 == 0 ? 400 : 250};
    const glm::dvec2 axis(Uniform(random, -0.2, 0.2), Uniform(random, -0.2, 0.2));
    const EdgeFit::Result result = EdgeFit(samples, size, true).Evaluate(axis);
    EdgeObjective objective(samples, size, true);
    Parameters gradient;
    const double value = objective.Evaluate(EdgeObjective::ParametersOf(axis, result.shape), &gradient);
    // EdgeFit gathers covectors by direction.
    EXPECT_NEAR(std::exp(value), result.cost, 2e-3 * result.cost);
    EXPECT_EQ(objective.evaluations(), 1);
  }
}

TEST(EdgeObjective, SlopesAreThoseOfFiniteDifferences) {
  std::mt19937 random(2);
  constexpr double kStep = 2e-3;
  int compared = 0;
  int different = 0;
  for (int trial = 0; trial < 200; ++trial) {
    const WhitenedSamples samples = RandomWhitenedSamples(random, 100);
    EdgeObjective objective(samples, {300, 500}, true);
    const Parameters at = RandomParameters(random);
    Parameters gradient;
    Parameters unused;
    if (!std::isfinite(objective.Evaluate(at, &gradient))) continue;
    for (size_t i = 0; i < at.size(); ++i) {
      Parameters more = at;
      Parameters less = at;
      more[i] += kStep;
      less[i] -= kStep;
      const double difference =
          (objective.Evaluate(more, &unused) - objective.Evaluate(less, &unused)) / (2.0 * kStep);
      ++compared;
      different += std::abs(difference - gradient[i]) > 5e-3 * (1.0 + std::abs(difference)) ? 1 : 0;
    }
  }
  // Some differences straddle a kink, where a side changes the vertex that it touches.
  EXPECT_GT(compared, 700);
  EXPECT_LT(different, compared / 25);
}

TEST(EdgeObjective, AFixedAspectHasNoSlope) {
  std::mt19937 random(3);
  const WhitenedSamples samples = RandomWhitenedSamples(random, 100);
  EdgeObjective objective(samples, {400, 400}, false);
  Parameters gradient;
  ASSERT_TRUE(std::isfinite(objective.Evaluate({0.05, 0.02, 0.1, 1.9, 0.0}, &gradient)));
  EXPECT_EQ(gradient[4], 0.0);
}

TEST(EdgeObjective, IsInfiniteWhereThereIsNoMap) {
  std::mt19937 random(4);
  const WhitenedSamples samples = RandomWhitenedSamples(random, 100);
  EdgeObjective objective(samples, {400, 400}, true);
  Parameters gradient;
  const double right_angle = 0.5 * std::numbers::pi;
  EXPECT_TRUE(std::isfinite(objective.Evaluate({0.0, 0.0, 0.0, right_angle, 0.0}, &gradient)));
  // Hulls reach out by one at least, so that this axis sees only a part.
  EXPECT_TRUE(std::isinf(objective.Evaluate({1.5, 0.0, 0.0, right_angle, 0.0}, &gradient)));
  EXPECT_TRUE(std::isinf(objective.Evaluate({0.0, 0.0, 0.0, 0.01, 0.0}, &gradient))) << "a sliver";
  // A strip is as a wider one: a descent ends at the limit.
  EXPECT_EQ(objective.Evaluate({0.0, 0.0, 0.0, right_angle, 2.0}, &gradient),
            objective.Evaluate({0.0, 0.0, 0.0, right_angle, 3.0}, &gradient));
  EXPECT_EQ(gradient[4], 0.0);
}

TEST(EdgeObjective, IsInfiniteWhereTheCostOverflows) {
  std::mt19937 random(6);
  for (const float extreme : {std::numeric_limits<float>::max(), std::numeric_limits<float>::quiet_NaN()}) {
    WhitenedSamples samples = RandomWhitenedSamples(random, 100);
    samples.e1[3] = extreme;
    Parameters gradient;
    EXPECT_TRUE(std::isinf(EdgeObjective(samples, {1, 1}, true).Evaluate({0, 0, 0.3, 1.9, 0}, &gradient)));
  }
}

TEST(EdgeObjective, IsFiniteWithoutEdgesAndWithoutWidth) {
  std::mt19937 random(5);
  WhitenedSamples samples = RandomWhitenedSamples(random, 100);
  const Parameters at = {0.0, 0.0, 0.3, 1.9, 0.1};
  Parameters gradient;
  samples.hull = {{-1.0, 0.0}, {1.0, 0.0}};
  EXPECT_TRUE(std::isfinite(EdgeObjective(samples, {400, 400}, true).Evaluate(at, &gradient)));
  for (const double slope : gradient) EXPECT_TRUE(std::isfinite(slope));
  samples.hull = {{0.0, 0.0}};
  EXPECT_TRUE(std::isfinite(EdgeObjective(samples, {400, 400}, true).Evaluate(at, &gradient)));
  for (const double slope : gradient) EXPECT_TRUE(std::isfinite(slope));
  for (std::vector<float>* lane : {&samples.e1, &samples.e2, &samples.e3}) {
    std::fill(lane->begin(), lane->end(), 0.0f);
  }
  EXPECT_TRUE(std::isfinite(EdgeObjective(samples, {400, 400}, true).Evaluate(at, &gradient)));
  for (const double slope : gradient) EXPECT_EQ(slope, 0.0);
}

}  // namespace
}  // namespace shadowfit
