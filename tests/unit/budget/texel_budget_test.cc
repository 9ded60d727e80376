#include "core/budget/texel_budget.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>
#include <random>

namespace shadowfit {
namespace {

double Uniform(std::mt19937& random, double low, double high) {
  return low + (high - low) * (static_cast<double>(random()) / 4294967296.0);
}

double WeightedCost(std::span<const TexelDemand> demands, std::span<const MapSize> sizes) {
  double sum = 0.0;
  for (size_t i = 0; i < demands.size(); ++i) sum += demands[i].weight * demands[i].WrongPixels(sizes[i]);
  return sum;
}

double Texels(std::span<const MapSize> sizes) {
  double sum = 0.0;
  for (const MapSize& size : sizes) sum += size.texels();
  return sum;
}

std::vector<TexelDemand> RandomDemands(std::mt19937& random, int count) {
  std::vector<TexelDemand> demands;
  for (int i = 0; i < count; ++i) {
    const int height = 64 << (random() % 3);
    demands.push_back({std::exp(Uniform(random, 5.0, 13.0)),
                       std::exp(Uniform(random, -1.0, 1.0)),
                       {random() % 2 == 0 ? height : 2 * height, height},
                       0.0});
  }
  return demands;
}

TEST(ShareTexels, FollowsTheClosedFormWhereNothingBounds) {
  const double demand[] = {1.0, 8.0, 27.0, 0.0};
  const double least[] = {0.0, 0.0, 0.0, 0.0};
  const double most[] = {1e9, 1e9, 1e9, 1e9};
  const std::vector<double> shares = ShareTexels(demand, least, most, 1400.0);
  EXPECT_NEAR(shares[0], 100.0, 1e-6);
  EXPECT_NEAR(shares[1], 400.0, 1e-6);
  EXPECT_NEAR(shares[2], 900.0, 1e-6);
  EXPECT_EQ(shares[3], 0.0);
}

TEST(ShareTexels, NoExchangeBetweenTwoLightsGains) {
  std::mt19937 random(3);
  for (int trial = 0; trial < 500; ++trial) {
    const size_t count = 2 + random() % 20;
    std::vector<double> demand(count);
    std::vector<double> least(count);
    std::vector<double> most(count);
    for (size_t i = 0; i < count; ++i) {
      demand[i] = std::exp(Uniform(random, 0.0, 10.0));
      least[i] = Uniform(random, 10.0, 1000.0);
      most[i] = least[i] + std::exp(Uniform(random, 0.0, 14.0));
    }
    const double floor = std::accumulate(least.begin(), least.end(), 0.0);
    const double ceiling = std::accumulate(most.begin(), most.end(), 0.0);
    const double total = Uniform(random, floor, ceiling);
    const std::vector<double> shares = ShareTexels(demand, least, most, total);
    EXPECT_NEAR(std::accumulate(shares.begin(), shares.end(), 0.0), total, 1e-6 * total);
    for (size_t i = 0; i < count; ++i) {
      ASSERT_GE(shares[i], least[i]);
      ASSERT_LE(shares[i], most[i]);
      for (size_t j = 0; j < count; ++j) {
        const double moved = std::min({1e-3 * shares[i], shares[i] - least[i], most[j] - shares[j]});
        if (i == j || !(moved > 0.0)) continue;
        const double before = demand[i] / std::sqrt(shares[i]) + demand[j] / std::sqrt(shares[j]);
        const double after =
            demand[i] / std::sqrt(shares[i] - moved) + demand[j] / std::sqrt(shares[j] + moved);
        ASSERT_GE(after, before * (1.0 - 1e-9)) << "trial " << trial;
      }
    }
  }
}

TEST(ShareTexels, KeepsToItsBoundsWhereTheTotalDoesNot) {
  const double demand[] = {5.0, 50.0};
  const double least[] = {10.0, 20.0};
  const double most[] = {100.0, 200.0};
  EXPECT_EQ(ShareTexels(demand, least, most, 3.0), (std::vector<double>{10.0, 20.0}));
  EXPECT_EQ(ShareTexels(demand, least, most, 3000.0), (std::vector<double>{100.0, 200.0}));
}

class EveryRounding : public ::testing::TestWithParam<SizeRounding> {};
INSTANTIATE_TEST_SUITE_P(Roundings, EveryRounding,
                         ::testing::Values(SizeRounding::kExact, SizeRounding::kMultipleOf8,
                                           SizeRounding::kPowerOfTwo));

TEST_P(EveryRounding, SizesAreAllowedFillTheTotalAndAreNearTheIdeal) {
  std::mt19937 random(4);
  double worst = 0.0;
  for (int trial = 0; trial < 200; ++trial) {
    const std::vector<TexelDemand> demands = RandomDemands(random, 1 + static_cast<int>(random() % 32));
    SideLimits sides{16, 2048, GetParam()};
    const double total = static_cast<double>(demands.size()) * Uniform(random, 2'000.0, 500'000.0);
    const std::vector<MapSize> sizes = ShareSizes(demands, sides, total);
    ASSERT_EQ(sizes.size(), demands.size());
    EXPECT_LE(Texels(sizes), total);
    std::vector<double> weighted;
    std::vector<double> least;
    std::vector<double> most;
    for (size_t i = 0; i < sizes.size(); ++i) {
      for (const int side : {sizes[i].width, sizes[i].height}) {
        ASSERT_GE(side, 16);
        ASSERT_LE(side, 2048);
        if (GetParam() == SizeRounding::kMultipleOf8) {
          ASSERT_EQ(side % 8, 0);
        }
        if (GetParam() == SizeRounding::kPowerOfTwo) {
          ASSERT_EQ(side & (side - 1), 0);
        }
      }
      weighted.push_back(demands[i].weight * demands[i].cost);
      least.push_back(256.0);
      most.push_back(2048.0 * 2048.0);
    }
    const std::vector<double> ideal = ShareTexels(weighted, least, most, total);
    double ideal_cost = 0.0;
    for (size_t i = 0; i < ideal.size(); ++i) ideal_cost += weighted[i] / std::sqrt(ideal[i]);
    worst = std::max(worst, WeightedCost(demands, sizes) / ideal_cost);
  }
  // Powers of two come in steps of twice the texels, so that one light alone may lose half of its share.
  EXPECT_LE(worst, GetParam() == SizeRounding::kPowerOfTwo    ? std::sqrt(2.0)
                   : GetParam() == SizeRounding::kMultipleOf8 ? 1.1
                                                              : 1.01);
}

/// The least cost over all powers of two for square requests.
double BruteForce(std::span<const TexelDemand> demands, int min_side, int max_side, double total) {
  std::vector<MapSize> sizes(demands.size());
  double best = 1e300;
  const std::function<void(size_t, double)> visit = [&](size_t i, double left) {
    if (i == demands.size()) {
      best = std::min(best, WeightedCost(demands, sizes));
      return;
    }
    for (int width = min_side; width <= max_side; width *= 2) {
      for (const int height : {width, width / 2}) {
        if (height < min_side || double(width) * height > left) continue;
        sizes[i] = {width, height};
        visit(i + 1, left - sizes[i].texels());
      }
    }
  };
  visit(0, total);
  return best;
}

TEST(ShareSizes, PowersOfTwoAreAsGoodAsBruteForce) {
  std::mt19937 random(5);
  double sum = 0.0;
  double worst = 0.0;
  constexpr int kTrials = 60;
  for (int trial = 0; trial < kTrials; ++trial) {
    std::vector<TexelDemand> demands = RandomDemands(random, 4);
    for (TexelDemand& demand : demands) demand.requested = {256, 256};
    const double total = std::exp(Uniform(random, 10.0, 14.0));
    const std::vector<MapSize> sizes = ShareSizes(demands, {32, 1024, SizeRounding::kPowerOfTwo}, total);
    const double excess = WeightedCost(demands, sizes) / BruteForce(demands, 32, 1024, total) - 1.0;
    ASSERT_GE(excess, -1e-9);
    sum += excess;
    worst = std::max(worst, excess);
  }
  std::printf("above brute force: mean %.3f %%, worst %.2f %%\n", 100.0 * sum / kTrials, 100.0 * worst);
  EXPECT_LE(worst, 1e-9);
}

TEST(ShareSizes, LightsWithoutWrongPixelsGetTheLeast) {
  const TexelDemand demands[] = {{0.0, 1.0, {512, 512}, 0.0}, {1000.0, 1.0, {512, 512}, 0.0}};
  const std::vector<MapSize> sizes = ShareSizes(demands, {64, 4096, SizeRounding::kMultipleOf8}, 1e6);
  EXPECT_EQ(sizes[0], (MapSize{64, 64}));
  EXPECT_GE(sizes[1].texels(), 0.97e6);
}

TEST(ShareSizes, KeepsTheAspectRatio) {
  const TexelDemand demands[] = {{500.0, 1.0, {1600, 400}, 0.0}, {700.0, 1.0, {300, 900}, 0.0}};
  const std::vector<MapSize> sizes = ShareSizes(demands, {16, 8192, SizeRounding::kExact}, 1e6);
  EXPECT_NEAR(double(sizes[0].width) / sizes[0].height, 4.0, 0.05);
  EXPECT_NEAR(double(sizes[1].width) / sizes[1].height, 1.0 / 3.0, 0.05);
}

TEST(ToleranceSafety, SafePixelsFallWithTexels) {
  const TexelDemand demand{1e5, 1.0, {100, 100}, 400.0};
  double last = 1e300;
  for (int side = 2; side < 20000; side = side * 5 / 4 + 1) {
    const double safe = SafeWrongPixels(demand, {side, side});
    EXPECT_LT(safe, last) << side;
    last = safe;
  }
}

TEST(SafeTexels, AreJustEnough) {
  std::mt19937 random(6);
  for (int trial = 0; trial < 200; ++trial) {
    TexelDemand demand = RandomDemands(random, 1)[0];
    demand.unit_pixels = std::exp(Uniform(random, 2.0, 7.0));
    demand.most_pixels = 16.0 * demand.unit_pixels;
    const double allowed = std::exp(Uniform(random, 1.0, 8.0));
    const double texels = SafeTexels(demand, allowed);
    if (texels < 4.0) continue;
    demand.cost /= std::sqrt(texels);
    EXPECT_NEAR(SafeWrongPixels(demand, {1, 1}), allowed, 1e-6 * allowed);
  }
  EXPECT_EQ(SafeTexels({0.0, 1.0, {100, 100}, 10.0}, 5.0), 0.0);
}

TEST(TexelDemand, DisplacedPixelsAreThoseOfTheirPrediction) {
  for (const double tail : {0.0, 0.01, 0.05, 1.0}) {
    TexelDemand demand;
    demand.tail = tail;
    EXPECT_DOUBLE_EQ(demand.Displaced(demand.Predicted(40.0)), 40.0) << "no limit, tail " << tail;
    demand.most_pixels = 200.0;
    for (const double displaced : {0.0, 1e-3, 1.0, 100.0, 1e4, 1e6}) {
      const double predicted = demand.Predicted(displaced);
      EXPECT_LE(predicted, displaced);
      EXPECT_GE(predicted, tail * displaced);
      if (tail == 0.0 && predicted > 0.99 * demand.most_pixels) continue;
      EXPECT_NEAR(demand.Displaced(predicted), displaced, 1e-6 * displaced) << tail;
    }
    EXPECT_TRUE(std::isfinite(demand.Displaced(1e9)));
  }
}

TEST(SizeFrom, IsTheSmallestThatServes) {
  std::mt19937 random(6);
  for (const SizeRounding rounding :
       {SizeRounding::kExact, SizeRounding::kMultipleOf8, SizeRounding::kPowerOfTwo}) {
    for (int trial = 0; trial < 200; ++trial) {
      const MapSize requested = RandomDemands(random, 1)[0].requested;
      const SideLimits sides{16, 4096, rounding};
      const double texels = std::exp(Uniform(random, 4.0, 18.0));
      const MapSize size = SizeFrom(requested, texels, sides);
      const bool least = size == SmallestSize(requested, sides);
      EXPECT_TRUE(size.texels() >= texels || std::max(size.width, size.height) == 4096);
      // A step or two less on each side is too few.
      const int step = rounding == SizeRounding::kExact ? 1 : 8;
      const MapSize less = rounding == SizeRounding::kPowerOfTwo
                               ? MapSize{size.width / 2, size.height}
                               : MapSize{size.width - 2 * step, size.height - 2 * step};
      if (!least) {
        EXPECT_LT(less.texels(), texels);
      }
    }
  }
}

TEST(Resized, ScalesTexelCoordinates) {
  ShadowProjection projection{glm::dmat3(1.0, 2.0, 0.1, -3.0, 4.0, 0.2, 5.0, 6.0, 1.0), {100, 50}};
  const ShadowProjection resized = Resized(projection, {300, 25});
  const glm::dvec3 ray(0.3, -0.4, 1.0);
  EXPECT_NEAR(resized.TexelFromRay(ray).x, 3.0 * projection.TexelFromRay(ray).x, 1e-12);
  EXPECT_NEAR(resized.TexelFromRay(ray).y, 0.5 * projection.TexelFromRay(ray).y, 1e-12);
  EXPECT_EQ(resized.size, (MapSize{300, 25}));
}

}  // namespace
}  // namespace shadowfit
