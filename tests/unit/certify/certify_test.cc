#include "core/fit/certify.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

#include "tests/support/whitened_samples.h"

namespace shadowfit {
namespace {

using testing::RandomWhitenedSamples;
using testing::Uniform;

constexpr double kPi = std::numbers::pi;

bool Sees(const WhitenedSamples& samples, const glm::dvec2& axis, double nearness = 0.02) {
  return std::all_of(samples.hull.begin(), samples.hull.end(),
                     [&](const glm::dvec2& v) { return 1.0 + glm::dot(axis, v) > nearness; });
}

TEST(LowerBound, IsNeverAboveACostInItsBox) {
  std::mt19937 random(1);
  int useful = 0;
  int tested = 0;
  for (int trial = 0; trial < 3000; ++trial) {
    const WhitenedSamples samples = RandomWhitenedSamples(random, 60);
    const MapSize size{400, random() % 2 == 0 ? 400 : 250};
    const double scale = std::exp(Uniform(random, -5.0, 0.0));
    CertifiedBox box;
    box.fan = random() % samples.hull.size();
    box.nearing_reach = scale * Uniform(random, 0.0, 1.0);
    box.nearing = box.nearing_reach + std::exp(Uniform(random, -3.0, 1.5));
    box.along_reach = scale * Uniform(random, 0.0, 0.5);
    box.along = Uniform(random, box.along_reach, 1.0 - box.along_reach);
    box.direction = Uniform(random, 0.0, kPi);
    box.direction_reach = scale * Uniform(random, 0.0, 0.4);
    box.angle_reach = scale * Uniform(random, 0.0, 0.4);
    box.angle = Uniform(random, 0.1 + box.angle_reach, kPi - 0.1 - box.angle_reach);
    box.log_stretch = Uniform(random, -0.9, 0.9);
    box.log_stretch_reach = scale * Uniform(random, 0.0, 0.5);
    const double bound = LowerBoundOver(samples, size, box);
    double least = 1e300;
    for (int i = 0; i < 200; ++i) {
      // Corners as often as the inside.
      const auto within = [&](double center, double reach) {
        const double share = i % 2 == 0 ? (random() % 2 == 0 ? 1.0 : -1.0) : Uniform(random, -1.0, 1.0);
        return center + share * reach;
      };
      const double nearing = within(box.nearing, box.nearing_reach);
      const glm::dvec2 axis = CertifiedAxis(samples, box.fan, nearing, within(box.along, box.along_reach));
      ASSERT_TRUE(Sees(samples, axis, 0.99 * std::exp(-nearing)));
      const double cost =
          ExactEdgeCost(samples, size, axis, within(box.direction, box.direction_reach),
                        within(box.angle, box.angle_reach), within(box.log_stretch, box.log_stretch_reach));
      ASSERT_GE(cost, bound) << "trial " << trial;
      least = std::min(least, cost);
    }
    ++tested;
    if (bound > 0.5 * least) ++useful;
  }
  std::printf("bounds of more than half the least cost met: %.1f %%\n", 100.0 * useful / tested);
  EXPECT_GT(useful, tested / 4);
}

TEST(LowerBound, NearsTheCostWithTheSquareOfTheBox) {
  std::mt19937 random(2);
  std::vector<double> ratios;
  std::vector<double> losses;
  for (int trial = 0; trial < 200; ++trial) {
    const WhitenedSamples samples = RandomWhitenedSamples(random, 200);
    const MapSize size{400, 400};
    CertifiedBox box;
    box.fan = random() % samples.hull.size();
    box.nearing = Uniform(random, 0.1, 1.0);
    box.along = Uniform(random, 0.1, 0.9);
    box.direction = Uniform(random, 0.0, kPi);
    box.angle = Uniform(random, 0.6, kPi - 0.6);
    const auto loss = [&](double reach) {
      CertifiedBox around = box;
      around.nearing_reach = around.along_reach = reach;
      around.direction_reach = around.angle_reach = reach;
      double least = 1e300;
      // The true least, nearly: cost is close to linear in so small a box, and least at a corner.
      for (int corner = 0; corner < 16; ++corner) {
        const auto end = [&](int bit, double r) { return (corner >> bit & 1) != 0 ? r : -r; };
        const glm::dvec2 axis =
            CertifiedAxis(samples, box.fan, box.nearing + end(0, reach), box.along + end(1, reach));
        least = std::min(least, ExactEdgeCost(samples, size, axis, box.direction + end(2, reach),
                                              box.angle + end(3, reach), 0.0));
      }
      return (least - LowerBoundOver(samples, size, around)) / least;
    };
    const double coarse = loss(0.04);
    const double fine = loss(0.01);
    if (coarse > 1.0) continue;
    ratios.push_back(fine / coarse);
    losses.push_back(coarse);
    EXPECT_LT(fine, 0.05);
  }
  std::sort(ratios.begin(), ratios.end());
  std::sort(losses.begin(), losses.end());
  std::printf("median loss at a reach of 0.04: %.4f\n", losses[losses.size() / 2]);
  // A sixteenth, but for what sorting covectors by direction gives away, which does not fall.
  EXPECT_LT(ratios[ratios.size() / 2], 0.2);
}

/// The projection over whitened coordinates as rays: of whatever the default search would find.
ShadowProjection Searched(const WhitenedSamples& samples, MapSize size) {
  EdgeFit fit(samples, size, false);
  EdgeFit::Result best;
  glm::dvec2 best_axis(0.0);
  for (int x = -4; x <= 4; ++x) {
    for (int y = -4; y <= 4; ++y) {
      const glm::dvec2 axis = 0.08 * glm::dvec2(x, y);
      const EdgeFit::Result result = fit.Evaluate(axis);
      if (result.cost >= best.cost) continue;
      best = result;
      best_axis = axis;
    }
  }
  return {fit.TexelFromWhitened(best_axis, best.shape, size), size};
}

TEST(Certify, BracketsBruteForce) {
  std::mt19937 random(3);
  constexpr double kTolerance = 0.01;
  double slowest = 0.0;
  int64_t most_boxes = 0;
  for (int trial = 0; trial < 4; ++trial) {
    const WhitenedSamples samples = RandomWhitenedSamples(random, 400);
    const MapSize size{400, 400};
    const ShadowProjection searched = Searched(samples, size);
    const Certificate certificate =
        Certify(samples, size, false, searched, {kTolerance, 1e6}, Cancellation());
    std::printf("cost %.1f best %.1f bound %.1f, %lld cells, %lld boxes, %.2f s\n", certificate.cost,
                certificate.best_cost, certificate.lower_bound, static_cast<long long>(certificate.cells),
                static_cast<long long>(certificate.boxes), certificate.seconds);
    ASSERT_TRUE(certificate.complete) << "trial " << trial << ", " << certificate.boxes << " boxes";
    EXPECT_LE(certificate.best_cost, certificate.cost);
    EXPECT_LE(certificate.best_cost, (1.0 + kTolerance) * certificate.lower_bound * (1.0 + 1e-9));
    slowest = std::max(slowest, certificate.seconds);
    most_boxes = std::max(most_boxes, certificate.boxes);
    // Nothing that a dense search finds is below the bound; and it finds little that is better than the best.
    EdgeFit fit(samples, size, false);
    double least = 1e300;
    for (int x = -20; x <= 20; ++x) {
      for (int y = -20; y <= 20; ++y) {
        const glm::dvec2 axis = 0.045 * glm::dvec2(x, y);
        if (Sees(samples, axis, 0.01)) least = std::min(least, fit.Evaluate(axis).cost);
      }
    }
    EXPECT_GE(least, certificate.lower_bound * 0.9985);  // Binned floats, see EdgeFit.
    EXPECT_LE(certificate.best_cost, least * (1.0015 + kTolerance));
    if (certificate.improved) {
      const Certificate again = Certify(samples, size, false, certificate.best, {0.5, 10.0}, Cancellation());
      EXPECT_NEAR(again.cost, certificate.best_cost, 1e-3 * again.cost);
    }
  }
  std::printf("slowest %.2f s, most boxes %lld\n", slowest, static_cast<long long>(most_boxes));
}

TEST(Certify, EndsWhereTheCostHasNoSlopeButBends) {
  // Along one axis range, which must be halved before shapes are.
  std::mt19937 random(43);
  const WhitenedSamples samples = RandomWhitenedSamples(random, 64 + 8 * static_cast<int>(random() % 40));
  const MapSize size{400, 400};
  const Certificate certificate =
      Certify(samples, size, false, Searched(samples, size), {0.01, 60.0}, Cancellation());
  EXPECT_TRUE(certificate.complete);
  EXPECT_LT(certificate.boxes, 400'000);
}

TEST(Certify, FindsWhatABadFitMissed) {
  std::mt19937 random(4);
  const WhitenedSamples samples = RandomWhitenedSamples(random, 300);
  const MapSize size{512, 256};
  EdgeFit fit(samples, size, false);
  const ShadowProjection bad{fit.TexelFromWhitened({0.0, 0.0}, {{1, 0}, {0.8, 0.6}, 1.0}, size), size};
  const Certificate certificate = Certify(samples, size, false, bad, {0.05, 1e6}, Cancellation());
  ASSERT_TRUE(certificate.complete);
  EXPECT_TRUE(certificate.improved);
  EXPECT_LT(certificate.best_cost, certificate.cost);
  EXPECT_GE(certificate.MostGap(), certificate.LeastGap());
  EXPECT_LE(1.0 + certificate.MostGap(), (1.0 + certificate.LeastGap()) * 1.05 * (1.0 + 1e-9));
}

TEST(Certify, StopsInTimeAndWhenCancelled) {
  std::mt19937 random(5);
  const WhitenedSamples samples = RandomWhitenedSamples(random, 2000);
  const MapSize size{400, 400};
  const ShadowProjection searched = Searched(samples, size);
  const Certificate late = Certify(samples, size, true, searched, {1e-6, 0.05}, Cancellation());
  EXPECT_FALSE(late.complete);
  EXPECT_GE(late.lower_bound, 0.0);
  EXPECT_LE(late.lower_bound, late.best_cost);
  Cancellation cancelled;
  cancelled.Cancel();
  EXPECT_FALSE(Certify(samples, size, false, searched, {0.01, 60.0}, cancelled).complete);
}

TEST(Certify, HasNothingToSayWithoutEdges) {
  std::mt19937 random(6);
  WhitenedSamples samples = RandomWhitenedSamples(random, 16);
  std::fill(samples.e1.begin(), samples.e1.end(), 0.0f);
  std::fill(samples.e2.begin(), samples.e2.end(), 0.0f);
  std::fill(samples.e3.begin(), samples.e3.end(), 0.0f);
  const ShadowProjection searched = Searched(samples, {64, 64});
  const Certificate certificate = Certify(samples, {64, 64}, false, searched, {}, Cancellation());
  EXPECT_TRUE(certificate.complete);
  EXPECT_EQ(certificate.MostGap(), 0.0);
}

}  // namespace
}  // namespace shadowfit
