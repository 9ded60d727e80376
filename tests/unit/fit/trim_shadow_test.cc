#include "core/fit/trim_shadow.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "core/fit/frame_optimizer.h"
#include "core/frame/frame_sampler.h"
#include "tests/support/analytic_scene.h"

namespace shadowfit {
namespace {

using testing::AnalyticScene;
using testing::OwnedFrame;

FrameSummary Optimize(const FrameRequest& request, const DefaultOptions& knobs,
                      const MapSizing& sizing = {}) {
  Options options;
  options.standard = knobs;
  options.sizing = sizing;
  FrameSummary summary;
  const absl::Status status = FrameOptimizer().Optimize(request, options, Cancellation(), &summary);
  EXPECT_TRUE(status.ok()) << status;
  return summary;
}

DefaultOptions HoldingAll(DefaultOptions knobs = {}) {
  knobs.hold_all_shadow = true;
  return knobs;
}

constexpr int kSide = 96;
constexpr double kPixelsPerSample = 4.0;

/// A heap of spheres and, far to the side of it, a pebble whose shadow is a few pixels.
OwnedFrame WithAPebble() {
  std::mt19937 random(4);
  AnalyticScene scene;
  for (int i = 0; i < 40; ++i) {
    const double radius = testing::Uniform(random, 0.05, 0.2);
    scene.spheres.push_back(
        {{testing::Uniform(random, -1, 1), testing::Uniform(random, -1, 1), 2.0 * radius}, radius});
  }
  scene.spheres.push_back({{-2.8, 0.0, 0.4}, 0.1});
  const CameraMatrices camera{glm::lookAtRH(glm::dvec3(0, -4, 2), glm::dvec3(0, 0, 0), glm::dvec3(0, 0, 1)),
                              testing::Perspective(1.3, 1.0, 0.1, 400.0, ClipDepth::kZeroToOne),
                              ClipDepth::kZeroToOne};
  LightRequest light;
  light.light = DirectionalLight{{0.45, 0.1, -1.0}};
  light.map_size = {24, 24};
  OwnedFrame frame = testing::Draw(scene, camera, kSide, kSide, {light});
  frame.request.screen = {2 * kSide, 2 * kSide};
  return frame;
}

/// Pixels of the final screen in shadow that no map of the light holds, as the definition reads.
double CountOutside(const FrameRequest& request, const LightSummary& light, size_t index,
                    double margin = 0.0) {
  const Camera camera = *Camera::Create(request.camera);
  const RaySpace space = *RaySpace::Create(request.lights[index].light);
  std::vector<ShadowProjection> maps = {light.projection};
  for (const LightMap& map : light.further_maps) maps.push_back(map.projection);
  const int width = request.depth.width;
  const int height = request.depth.height;
  int outside = 0;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      if ((request.bits->Row(y)[x] >> index & 1) == 0) continue;
      const auto depth = static_cast<double>(request.depth.Row(y)[x]);
      const glm::dvec4 ws = camera.WsFromNdc({(x + 0.5) * 2.0 / width - 1.0, (y + 0.5) * 2.0 / height - 1.0,
                                              NdcFromWindowDepth(request.camera.clip_depth, depth)});
      const glm::dvec3 ray = space.RayFromPoint(glm::dvec3(ws) / ws.w);
      outside += std::none_of(maps.begin(), maps.end(),
                              [&](const ShadowProjection& map) { return map.Holds(ray, margin); });
    }
  }
  return outside * kPixelsPerSample;
}

TEST(TrimShadow, LetsGoOfAPebblesShadowForTheSakeOfTheHeap) {
  const OwnedFrame frame = WithAPebble();
  const LightSummary whole = Optimize(frame.request, HoldingAll()).lights[0];
  const LightSummary trimmed = Optimize(frame.request, {}).lights[0];
  EXPECT_EQ(whole.shadow_outside_pixels, 0.0);
  EXPECT_EQ(CountOutside(frame.request, whole, 0), 0.0);
  EXPECT_GT(trimmed.shadow_outside_pixels, 0.0);
  EXPECT_EQ(trimmed.shadow_outside_pixels, CountOutside(frame.request, trimmed, 0));
  // Some, and worth more.
  EXPECT_LT(trimmed.shadow_outside_pixels, 0.2 * whole.predicted_misclassified_pixels);
  EXPECT_LT(trimmed.predicted_misclassified_pixels, 0.85 * whole.predicted_misclassified_pixels);
}

TEST(TrimShadow, AToleranceHoldsAll) {
  const OwnedFrame frame = WithAPebble();
  ToleranceOptions tolerance;
  tolerance.max_misclassified_pixels = 300.0;
  EXPECT_EQ(Optimize(frame.request, {}, tolerance).lights[0].shadow_outside_pixels, 0.0);
}

TEST(TrimShadow, ABudgetsSidesStayAsTheyWereChosen) {
  OwnedFrame frame = WithAPebble();
  BudgetOptions budget;
  budget.total_texels = 20.0 * 20.0;
  for (const bool free_aspect : {false, true}) {
    DefaultOptions knobs;
    knobs.free_aspect = free_aspect;
    const LightSummary trimmed = Optimize(frame.request, knobs, budget).lights[0];
    const LightSummary whole = Optimize(frame.request, HoldingAll(knobs), budget).lights[0];
    EXPECT_GT(trimmed.shadow_outside_pixels, 0.0);
    EXPECT_EQ(trimmed.projection.size, whole.projection.size);
  }
}

// Rescaled to hold what the map had let go of, every texel would move in every frame.
TEST(TrimShadow, TheNextFrameKeepsTheMapAsItIs) {
  OwnedFrame frame = WithAPebble();
  const LightSummary first = Optimize(frame.request, {}).lights[0];
  ASSERT_GT(first.shadow_outside_pixels, 0.0);
  frame.request.lights[0].previous_clip_from_world = first.clip_from_world;
  for (const int glance_samples : {0, DefaultOptions{}.glance_samples}) {
    DefaultOptions knobs;
    knobs.glance_samples = glance_samples;
    const LightSummary next = Optimize(frame.request, knobs).lights[0];
    EXPECT_EQ(next.outcome, FitOutcome::kKeptPrevious);
    EXPECT_EQ(next.shadow_outside_pixels, first.shadow_outside_pixels);
    ASSERT_TRUE(next.swim_pixels.has_value());
    EXPECT_LT(*next.swim_pixels, 1e-6);
  }
  // Where all is to be held the same map has to grow.
  const LightSummary whole = Optimize(frame.request, HoldingAll()).lights[0];
  EXPECT_EQ(whole.shadow_outside_pixels, 0.0);
}

// Whatever the frame: a light inside the scene or behind the camera, slivers, single samples, several maps.
TEST(TrimShadow, IsNeverPredictedWorseThanHoldingAll) {
  std::mt19937 random(21);
  int trimmed_lights = 0;
  for (int trial = 0; trial < 400; ++trial) {
    const auto convention = static_cast<ClipDepth>(trial % 3);
    OwnedFrame frame = testing::Draw(testing::RandomSpheres(random, static_cast<int>(random() % 12)),
                                     testing::WalkThroughCamera(random, convention), 48, 48,
                                     {testing::RandomLight(random, 0), testing::RandomLight(random, 1)});
    frame.request.screen = {96, 96};
    // Texels that are many pixels wide: where maps are good there is nothing to gain.
    for (LightRequest& light : frame.request.lights) light.map_size = {16, 16};
    DefaultOptions knobs;
    knobs.free_aspect = trial % 2 == 1;
    knobs.most_maps = 1 + trial % 4;
    const FrameSummary whole = Optimize(frame.request, HoldingAll(knobs));
    const FrameSummary trimmed = Optimize(frame.request, knobs);
    for (size_t i = 0; i < 2; ++i) {
      const LightSummary& light = trimmed.lights[i];
      EXPECT_LE(light.predicted_misclassified_pixels,
                whole.lights[i].predicted_misclassified_pixels * (1.0 + 1e-9))
          << "trial " << trial << ", light " << i;
      EXPECT_EQ(light.further_maps.size(), whole.lights[i].further_maps.size());
      EXPECT_LE(light.projection.size.texels(), frame.request.lights[i].map_size.texels());
      trimmed_lights += light.shadow_outside_pixels > 0.0;
      if (light.outcome != FitOutcome::kFitted || light.sample_source != SampleSource::kShadowBoundary)
        continue;
      // Half a texel beside a map counts as held where all is; surfaces that the light grazes are dark.
      const double margin = light.shadow_outside_pixels > 0.0 ? 0.0 : 0.5;
      EXPECT_NEAR(light.shadow_outside_pixels, CountOutside(frame.request, light, i, margin),
                  0.02 * light.shadow_outside_pixels + 8.0 * kPixelsPerSample)
          << "trial " << trial << ", light " << i;
    }
  }
  EXPECT_GT(trimmed_lights, 40);
}

TEST(TrimShadow, IsTheSameEveryTime) {
  const OwnedFrame frame = WithAPebble();
  const LightSummary first = Optimize(frame.request, {}).lights[0];
  for (int repeat = 0; repeat < 3; ++repeat) {
    EXPECT_EQ(Optimize(frame.request, {}).lights[0].clip_from_world, first.clip_from_world);
  }
}

}  // namespace
}  // namespace shadowfit
