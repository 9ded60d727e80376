#include "core/fit/whitened_samples.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

#include "core/fit/edge_fit.h"
#include "tests/support/whitened_samples.h"

namespace shadowfit {
namespace {

using testing::RandomWhitenedSamples;
using testing::Uniform;

constexpr MapSize kSize{400, 400};

struct Map {
  glm::dvec2 axis;
  double angle1, angle2;

  glm::dmat3 TexelFromWhitened(const WhitenedSamples& samples) const {
    const AffineShape shape{{std::cos(angle1), std::sin(angle1)}, {std::cos(angle2), std::sin(angle2)}, 1.0};
    return EdgeFit(samples, kSize, false).TexelFromWhitened(axis, shape, kSize);
  }
};

Map RandomMap(std::mt19937& random) {
  const double angle = Uniform(random, -std::numbers::pi, std::numbers::pi);
  return {{Uniform(random, -0.2, 0.2), Uniform(random, -0.2, 0.2)}, angle, angle + Uniform(random, 0.5, 2.5)};
}

/// l y of a sample, straight from the definitions.
double DisplacedPixels(const WhitenedSamples& samples, size_t i, const Map& map) {
  const glm::dmat3 texel_from_whitened = map.TexelFromWhitened(samples);
  // Points of the image plane, where w is 1.
  const auto texel_at = [&](const glm::dvec2& v) {
    return glm::dvec2(texel_from_whitened * glm::dvec3(v, 1.0 - glm::dot(map.axis, v)));
  };
  const glm::dvec2 origin = texel_at({0, 0});
  const glm::dmat2 steps = glm::inverse(glm::dmat2(texel_at({1, 0}) - origin, texel_at({0, 1}) - origin));
  const double w = 1.0 + map.axis.x * samples.x[i] + map.axis.y * samples.y[i];
  const glm::dvec2 g = w * (glm::dvec2(samples.e1[i], samples.e2[i]) - map.axis * double(samples.e3[i]));
  const double p = std::abs(glm::dot(g, steps[0])), q = std::abs(glm::dot(g, steps[1]));
  const double s = std::max(p, q), t = std::min(p, q);
  return s > 0.0 ? s / 4.0 + t * t / (12.0 * s) : 0.0;
}

double Sum(const WhitenedSamples& samples, const Map& map) {
  double sum = 0.0;
  for (size_t i = 0; i < samples.x.size(); ++i) sum += DisplacedPixels(samples, i, map);
  return sum;
}

double LimitedSum(const WhitenedSamples& samples, const Map& map) {
  double sum = 0.0;
  for (size_t i = 0; i < samples.x.size(); ++i) {
    const double displaced = DisplacedPixels(samples, i, map);
    const auto limited = [&](float inverse) { return displaced / (1.0 + displaced * double(inverse)); };
    const double tail = double(samples.tail[i]);
    sum += (1.0 - tail) * limited(samples.inverse_limit[i]) + tail * limited(samples.inverse_tail_limit[i]);
  }
  return sum;
}

WhitenedSamples RandomLimitedSamples(std::mt19937& random) {
  WhitenedSamples samples = RandomWhitenedSamples(random, 64);
  // Some samples lose next to nothing at the map of typical size, some next to all.
  const double typical = Sum(samples, {{0.0, 0.0}, 0.0, 1.5}) / double(samples.x.size());
  for (size_t i = 0; i < samples.x.size(); ++i) {
    samples.inverse_limit[i] = static_cast<float>(std::exp(Uniform(random, -5.0, 4.0)) / typical);
    samples.inverse_tail_limit[i] = 0.01f * samples.inverse_limit[i];
    samples.tail[i] = i % 2 == 0 ? static_cast<float>(Uniform(random, 0.0, 1.0)) : 0.0f;
  }
  return samples;
}

TEST(TangentAt, LiesAboveTheMetricAndTouchesItAtTheMap) {
  std::mt19937 random(5);
  for (int trial = 0; trial < 20; ++trial) {
    const WhitenedSamples samples = RandomLimitedSamples(random);
    const Map at = RandomMap(random);
    double reported = 0.0;
    const WhitenedSamples tangent = TangentAt(samples, *GridOf(at.TexelFromWhitened(samples)), &reported);
    const double metric = LimitedSum(samples, at);
    EXPECT_NEAR(reported, metric, 1e-4 * metric);
    const double touching = Sum(tangent, at);
    for (int other = 0; other < 10; ++other) {
      const Map map = RandomMap(random);
      EXPECT_LE(LimitedSum(samples, map) - metric, Sum(tangent, map) - touching + 1e-4 * metric);
    }
    constexpr double kStep = 1e-4;
    const Map less{at.axis, at.angle1 - kStep, at.angle2}, more{at.axis, at.angle1 + kStep, at.angle2};
    const double slope = LimitedSum(samples, more) - LimitedSum(samples, less);
    EXPECT_NEAR(Sum(tangent, more) - Sum(tangent, less), slope, 0.02 * std::abs(slope) + 1e-6 * metric);
  }
}

TEST(TangentAt, SamplesWithoutALimitStayAsTheyAre) {
  std::mt19937 random(6);
  WhitenedSamples samples = RandomWhitenedSamples(random, 64);
  std::fill(samples.inverse_limit.begin(), samples.inverse_limit.end(), 0.0f);
  const WhitenedSamples tangent = TangentAt(samples, *GridOf(RandomMap(random).TexelFromWhitened(samples)));
  EXPECT_EQ(tangent.e1, samples.e1);
  EXPECT_EQ(tangent.e2, samples.e2);
  EXPECT_EQ(tangent.e3, samples.e3);
}

}  // namespace
}  // namespace shadowfit
