#include "core/fit/axis_search.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <random>

#include "tests/support/whitened_samples.h"

namespace shadowfit {
namespace {

using testing::RandomWhitenedSamples;
using testing::Uniform;

constexpr MapSize kMap{400, 300};
constexpr double kNothingToBeat = std::numeric_limits<double>::infinity();

struct Found {
  AxisSearchResult result;
  int evaluations;
};

/// All samples are probes.
Found Search(const WhitenedSamples& samples, bool free_aspect,
             const std::optional<glm::dvec2>& previous_axis = {}, double to_beat = kNothingToBeat) {
  DefaultOptions options;
  options.free_aspect = free_aspect;
  AxisSearch search(samples, kMap, options);
  search.Survey(previous_axis, to_beat);
  const AxisSearchResult result = search.Descend(samples);
  return {result, search.evaluations()};
}

TEST(AxisSearch, CostOfAMapIsThatOfItsGrid) {
  std::mt19937 random(4);
  for (int i = 0; i < 40; ++i) {
    const WhitenedSamples samples = RandomWhitenedSamples(random, 400);
    const AxisSearchResult found = Search(samples, false).result;
    const TexelGrid grid = *GridOf(found.texel_from_whitened);
    const DefaultOptions options;
    AxisSearch search(samples, kMap, options);
    EXPECT_NEAR(search.CostOf(grid), found.cost, 1e-4 * found.cost);
    // A map of twice the extent gets twice as many pixels wrong.
    EXPECT_NEAR(search.CostOf({grid.axis, 2.0 * grid.step1, 2.0 * grid.step2}), 2.0 * found.cost,
                1e-4 * found.cost);
  }
  EXPECT_FALSE(GridOf(glm::dmat3(glm::dvec3(1, 0, 0), glm::dvec3(0, 1, 0), glm::dvec3(0, 0, -1))));
}

TEST(AxisSearch, DescendsFromAMapToTheFloorOfItsValley) {
  std::mt19937 random(8);
  double sum = 0.0;
  constexpr int kLights = 100;
  for (int i = 0; i < kLights; ++i) {
    const WhitenedSamples samples = RandomWhitenedSamples(random, 500);
    DefaultOptions options;
    options.free_aspect = i % 2 == 1;
    const AxisSearchResult best = Search(samples, options.free_aspect).result;
    // A little aside: larger, sheared and tilted.
    glm::dmat3 aside(1.0);
    aside[0][0] = Uniform(random, 0.7, 0.9);
    aside[1][0] = Uniform(random, -0.2, 0.2);
    aside[0][2] = Uniform(random, -0.1, 0.1) / best.size.width;
    const ShadowProjection map{aside * best.texel_from_whitened, best.size};
    AxisSearch search(samples, kMap, options);
    const double before = search.CostOf(*GridOf(map.texel_from_ray));
    const double cost = search.DescendFromMap(map).cost;
    EXPECT_LT(cost, before) << i;
    EXPECT_LT(cost, 1.1 * best.cost) << i;
    sum += cost / best.cost;
    EXPECT_LE(search.evaluations(), 2 + options.evaluations_to_polish);
  }
  EXPECT_LT(sum / kLights, 1.01);
}

TEST(AxisSearch, LooksAtNoAxisThatCannotReachWhatItIsToBeat) {
  std::mt19937 random(7);
  for (int i = 0; i < 50; ++i) {
    const WhitenedSamples samples = RandomWhitenedSamples(random, 500);
    const double cold = Search(samples, false).result.cost;
    const DefaultOptions options;
    AxisSearch search(samples, kMap, options);
    EXPECT_GT(search.Survey(std::nullopt, 0.5 * cold), 0.99 * cold);
    // The centre, the rings, and one descent.
    EXPECT_LE(search.evaluations(), 1 + 2 * options.search_directions + 1 + options.evaluations_per_start);
  }
}

TEST(AxisSearch, FindsWhatBeatsABadMapAndKnowsThatNothingBeatsAGoodOne) {
  std::mt19937 random(5);
  constexpr int kLights = 300;
  double sum = 0.0;
  for (int i = 0; i < kLights; ++i) {
    const WhitenedSamples samples = RandomWhitenedSamples(random, 500);
    const bool free_aspect = i % 2 == 1;
    const double cold = Search(samples, free_aspect).result.cost;
    // Whatever the previous axis was, and however bad its map.
    const double along = Uniform(random, 0.0, 2.0 * std::numbers::pi);
    const glm::dvec2 y(std::cos(along), std::sin(along));
    const glm::dvec2 axis = AxisAt(samples.hull, Uniform(random, 0.0, 3.0) * y);
    const double to_beat = Uniform(random, 1.1, 3.0) * cold;
    const double warm = Search(samples, free_aspect, axis, to_beat).result.cost;
    EXPECT_LT(warm, 1.05 * cold) << i;
    sum += warm / cold;
    DefaultOptions options;
    options.free_aspect = free_aspect;
    AxisSearch search(samples, kMap, options);
    EXPECT_GT(search.Survey(axis, 0.95 * cold), 0.95 * cold) << i;
  }
  EXPECT_LT(sum / kLights, 1.0005);
}

}  // namespace
}  // namespace shadowfit
