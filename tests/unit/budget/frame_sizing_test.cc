#include "core/fit/frame_sizing.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "core/budget/texel_budget.h"
#include "core/fit/frame_optimizer.h"
#include "tests/support/analytic_scene.h"

namespace shadowfit {
namespace {

using testing::OwnedFrame;
using ::testing::StartsWith;

OwnedFrame FrameWithLights(int count, uint32_t seed = 9) {
  std::mt19937 random(seed);
  std::vector<LightRequest> lights;
  for (int i = 0; i < count; ++i) {
    LightRequest& light = lights.emplace_back(testing::RandomLight(random, static_cast<uint32_t>(i)));
    light.map_size = {256, 256};
  }
  return testing::Draw(testing::RandomSpheres(random, 12),
                       testing::WalkThroughCamera(random, ClipDepth::kNegativeOneToOne), 80, 80,
                       std::move(lights));
}

absl::StatusOr<FrameSummary> Optimized(const FrameRequest& request, const MapSizing& sizing,
                                       Method method = Method::kDefault) {
  Options options;
  options.method = method;
  options.sizing = sizing;
  options.assess_quality = true;
  FrameOptimizer optimizer;
  FrameSummary summary;
  if (absl::Status status = optimizer.Optimize(request, options, Cancellation(), &summary); !status.ok()) {
    return status;
  }
  return summary;
}

double Predicted(const FrameSummary& summary) {
  double sum = 0.0;
  for (const LightSummary& light : summary.lights) sum += light.predicted_misclassified_pixels;
  return sum;
}

double Texels(const FrameSummary& summary) {
  double sum = 0.0;
  for (const LightSummary& light : summary.lights) sum += light.projection.size.texels();
  return sum;
}

TEST(Sizing, ABudgetPredictsFewerWrongPixelsThanEqualSizes) {
  for (const SizeRounding rounding :
       {SizeRounding::kExact, SizeRounding::kMultipleOf8, SizeRounding::kPowerOfTwo}) {
    for (const Method method : {Method::kDefault, Method::kFocused}) {
      const OwnedFrame frame = FrameWithLights(12);
      const FrameSummary equal = *Optimized(frame.request, {}, method);
      BudgetOptions budget;
      budget.total_texels = Texels(equal);
      budget.sides.rounding = rounding;
      const absl::StatusOr<FrameSummary> shared = Optimized(frame.request, budget, method);
      ASSERT_TRUE(shared.ok()) << shared.status();
      EXPECT_LE(Texels(*shared), budget.total_texels);
      EXPECT_GE(Texels(*shared), 0.75 * budget.total_texels);
      EXPECT_LT(Predicted(*shared), Predicted(equal));
    }
  }
}

TEST(Sizing, AWeightDrawsTexels) {
  OwnedFrame frame = FrameWithLights(3);
  BudgetOptions budget;
  budget.total_texels = 200'000.0;
  const FrameSummary plain = *Optimized(frame.request, budget);
  size_t i = 0;
  while (plain.lights[i].predicted_misclassified_pixels == 0.0) ++i;
  frame.request.lights[i].weight = 8.0;
  const FrameSummary weighted = *Optimized(frame.request, budget);
  EXPECT_GT(weighted.lights[i].projection.size.texels(), plain.lights[i].projection.size.texels());
  EXPECT_LT(weighted.lights[i].predicted_misclassified_pixels,
            plain.lights[i].predicted_misclassified_pixels);
}

TEST(Sizing, AnAtlasHoldsAllMaps) {
  for (const SizeRounding rounding :
       {SizeRounding::kExact, SizeRounding::kMultipleOf8, SizeRounding::kPowerOfTwo}) {
    const OwnedFrame frame = FrameWithLights(20);
    BudgetOptions budget;
    budget.sides.rounding = rounding;
    budget.atlas = MapSize{1024, 1024};
    const absl::StatusOr<FrameSummary> summary = Optimized(frame.request, budget);
    ASSERT_TRUE(summary.ok()) << summary.status();
    std::vector<bool> taken(1024 * 1024);
    for (const LightSummary& light : summary->lights) {
      ASSERT_TRUE(light.atlas_position.has_value());
      for (int y = 0; y < light.projection.size.height; ++y) {
        for (int x = 0; x < light.projection.size.width; ++x) {
          const int at_x = light.atlas_position->x + x;
          const int at_y = light.atlas_position->y + y;
          ASSERT_TRUE(at_x < 1024 && at_y < 1024);
          const auto texel = static_cast<size_t>(at_y) * 1024 + static_cast<size_t>(at_x);
          ASSERT_FALSE(taken[texel]);
          taken[texel] = true;
        }
      }
    }
    EXPECT_GE(Texels(*summary), 0.7 * 1024 * 1024);
  }
}

TEST(Sizing, ToleranceIsKeptByThePrediction) {
  const OwnedFrame frame = FrameWithLights(10);
  for (const double pixels : {4.0, 20.0, 100.0}) {
    ToleranceOptions tolerance;
    tolerance.max_misclassified_pixels = pixels;
    const absl::StatusOr<FrameSummary> summary = Optimized(frame.request, tolerance);
    ASSERT_TRUE(summary.ok()) << summary.status();
    for (const LightSummary& light : summary->lights) {
      if (light.projection.size.width == 8192 || light.projection.size.height == 8192) continue;
      if (light.sample_source != SampleSource::kShadowBoundary) continue;
      const TexelDemand demand{light.predicted_misclassified_pixels, 1.0, {1, 1}, light.quality->unit_pixels};
      EXPECT_LE(SafeWrongPixels(demand, {1, 1}), pixels * 1.001);
    }
  }
}

TEST(Sizing, WithoutBitsPossibleEdgesCount) {
  OwnedFrame frame = FrameWithLights(4);
  frame.request.bits.reset();
  BudgetOptions budget;
  budget.total_texels = 400'000.0;
  const FrameSummary summary = *Optimized(frame.request, budget);
  EXPECT_GE(Texels(summary), 0.95 * budget.total_texels);
}

TEST(Sizing, IsDeterministic) {
  const OwnedFrame frame = FrameWithLights(16);
  BudgetOptions budget;
  budget.atlas = MapSize{2048, 1024};
  const FrameSummary a = *Optimized(frame.request, budget);
  const FrameSummary b = *Optimized(frame.request, budget);
  for (size_t i = 0; i < a.lights.size(); ++i) {
    EXPECT_EQ(a.lights[i].clip_from_world, b.lights[i].clip_from_world);
    EXPECT_EQ(a.lights[i].projection.size, b.lights[i].projection.size);
    EXPECT_EQ(a.lights[i].atlas_position, b.lights[i].atlas_position);
  }
}

TEST(Sizing, ErrorsNameTheField) {
  OwnedFrame frame = FrameWithLights(4);
  const auto message = [&](const MapSizing& sizing) {
    const absl::StatusOr<FrameSummary> summary = Optimized(frame.request, sizing);
    EXPECT_EQ(summary.status().code(), absl::StatusCode::kInvalidArgument);
    return std::string(summary.status().message());
  };
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(message(BudgetOptions{}), StartsWith("options.texel_budget.total_texels: 0, "));
  EXPECT_THAT(message(BudgetOptions{-1.0, {}, {}}), StartsWith("options.texel_budget.total_texels: -1, "));
  EXPECT_THAT(message(BudgetOptions{kNan, {}, {}}), StartsWith("options.texel_budget.total_texels: nan, "));
  EXPECT_THAT(message(BudgetOptions{100.0, {}, {}}), StartsWith("options.texel_budget.total_texels: 100 "));
  EXPECT_THAT(message(BudgetOptions{1e6, {0, 100}, {}}),
              StartsWith("options.texel_budget.sides.min_side: 0 "));
  EXPECT_THAT(message(BudgetOptions{1e6, {200, 100}, {}}),
              StartsWith("options.texel_budget.sides.min_side: 200 "));
  EXPECT_THAT(message(BudgetOptions{1e6, {16, 70000}, {}}),
              StartsWith("options.texel_budget.sides.max_side: 70000 "));
  EXPECT_THAT(message(BudgetOptions{1e6, {4, 64, SizeRounding::kMultipleOf8}, {}}),
              StartsWith("options.texel_budget.sides.min_side: 4 "));
  EXPECT_THAT(message(BudgetOptions{0.0, {}, MapSize{0, 100}}),
              StartsWith("options.texel_budget.atlas: 0x100"));
  EXPECT_THAT(message(BudgetOptions{0.0, {64, 64}, MapSize{100, 100}}),
              StartsWith("options.texel_budget.atlas: "));
  EXPECT_THAT(message(ToleranceOptions{}), StartsWith("options.tolerance.max_misclassified_pixels: 0 "));
  EXPECT_THAT(message(ToleranceOptions{10.0, {16, 0}}), StartsWith("options.tolerance.sides.max_side: 0 "));
  frame.request.lights[2].weight = 0.0;
  EXPECT_THAT(message({}), StartsWith("lights[2].weight: 0 "));
}

}  // namespace
}  // namespace shadowfit
