#include "core/fit/map_quality.h"

#include <gtest/gtest.h>

#include <cmath>

#include "core/budget/texel_budget.h"
#include "core/fit/frame_optimizer.h"
#include "core/frame/frame_sampler.h"
#include "tests/support/analytic_scene.h"

namespace shadowfit {
namespace {

using testing::OwnedFrame;

FrameSummary Optimized(const FrameRequest& request, Method method) {
  Options options;
  options.method = method;
  options.assess_quality = true;
  FrameSummary summary;
  FrameOptimizer optimizer;
  const absl::Status status = optimizer.Optimize(request, options, Cancellation(), &summary);
  EXPECT_TRUE(status.ok()) << status;
  return summary;
}

double Product(const MapQuality& q) {
  return q.unit_pixels * q.perspective * q.projection * q.fit * q.budget * q.saturation;
}

OwnedFrame FrameOf(const glm::dvec3& ws_eye, const glm::dvec3& ws_target, double fov_y, const Light& light,
                   const testing::AnalyticScene& scene, MapSize map = {256, 256}) {
  CameraMatrices camera;
  const glm::dvec3 forward = glm::normalize(ws_target - ws_eye);
  const glm::dvec3 up = std::abs(forward.z) > 0.99 ? glm::dvec3(0, 1, 0) : glm::dvec3(0, 0, 1);
  camera.view_from_world = glm::lookAtRH(ws_eye, ws_target, up);
  camera.clip_from_view = testing::Perspective(fov_y, 1.0, 0.1, 500.0, ClipDepth::kNegativeOneToOne);
  return testing::Draw(scene, camera, 160, 160, {{1, light, map, {}}});
}

/// Spheres that float over the ground.
testing::AnalyticScene Spheres() {
  testing::AnalyticScene scene;
  for (int x = -2; x <= 2; ++x) {
    for (int y = 0; y < 12; ++y) scene.spheres.push_back({{3.0 * x, 3.0 * y, 1.0}, 0.7});
  }
  return scene;
}

TEST(MapQuality, FactorsMultiplyToThePrediction) {
  std::mt19937 random(8);
  for (int trial = 0; trial < 60; ++trial) {
    OwnedFrame frame = testing::Draw(testing::RandomSpheres(random, 10),
                                     testing::WalkThroughCamera(random, ClipDepth::kNegativeOneToOne), 60, 60,
                                     {testing::RandomLight(random, 1)});
    frame.request.screen = {240, 240};
    for (const Method method : {Method::kDefault, Method::kFocused}) {
      const FrameSummary summary = Optimized(frame.request, method);
      const MapQuality& quality = *summary.lights[0].quality;
      if (summary.lights[0].sample_source != SampleSource::kShadowBoundary) continue;
      if (summary.lights[0].outcome == FitOutcome::kFallback) continue;
      EXPECT_NEAR(quality.predicted_pixels, summary.lights[0].predicted_misclassified_pixels,
                  1e-6 * quality.predicted_pixels);
      EXPECT_NEAR(Product(quality), quality.predicted_pixels, 1e-6 * quality.predicted_pixels);
      EXPECT_GE(quality.perspective, 1.0 - 1e-9);
      EXPECT_GE(quality.fit, 1.0 - 1e-9);
    }
  }
}

TEST(MapQuality, TexelsChangeTheBudgetAlone) {
  OwnedFrame frame = FrameOf({0, -8, 3}, {0, 4, 0}, 0.9, PointLight{{5, 10, 20}}, Spheres());
  const MapQuality small = *Optimized(frame.request, Method::kFocused).lights[0].quality;
  frame.request.lights[0].map_size = {1024, 1024};
  const MapQuality large = *Optimized(frame.request, Method::kFocused).lights[0].quality;
  // Focused keeps a border of whole texels.
  EXPECT_NEAR(large.budget, small.budget / 4.0, 0.01 * large.budget);
  EXPECT_NEAR(large.fit, small.fit, 0.01 * small.fit);
  EXPECT_NEAR(large.perspective, small.perspective, 0.01);
  EXPECT_NEAR(large.projection, small.projection, 0.01);
  // Smaller texels lose less of what they displace.
  EXPECT_GT(large.saturation, small.saturation);
  EXPECT_LE(large.saturation, 1.0);
}

TEST(MapQuality, UnusedTexelsChangeTheFitAlone) {
  const OwnedFrame frame = FrameOf({0, -8, 3}, {0, 4, 0}, 0.9, PointLight{{5, 10, 20}}, Spheres());
  const Camera camera = *Camera::Create(frame.request.camera);
  const RaySpace space = *RaySpace::Create(frame.request.lights[0].light);
  FrameSampler sampler;
  FrameExtent extent;
  std::vector<LightSamples> samples;
  sampler.Sample(camera, frame.request.depth, frame.request.bits, {&space, 1}, {160, 160}, &extent, &samples);
  const ShadowProjection tight = Optimized(frame.request, Method::kDefault).lights[0].projection;
  // Everything in the lower left quarter of the map.
  ShadowProjection loose = Resized(tight, {128, 128});
  loose.size = {256, 256};
  const MapQuality a = AssessMaps(camera, space, samples[0], {&tight, 1}, {160, 160});
  const MapQuality b = AssessMaps(camera, space, samples[0], {&loose, 1}, {160, 160});
  EXPECT_NEAR(b.fit, 2.0 * a.fit, 1e-6 * b.fit);
  EXPECT_NEAR(b.budget, a.budget, 1e-6 * a.budget);
  EXPECT_NEAR(b.perspective, a.perspective, 1e-6);
  EXPECT_NEAR(b.projection, a.projection, 1e-6 * a.projection);
  EXPECT_EQ(b.Worst() == MapFlaw::kFit, b.fit > std::max({b.budget, b.perspective, b.projection}));
}

TEST(MapQuality, ALightAtTheCameraHasNeitherPerspectiveNorProjection) {
  // Shadows seen from the light itself: none. So the light stands a little aside, and its map is far too
  // small.
  const OwnedFrame frame =
      FrameOf({0, -8, 3}, {0, 4, 0}, 0.9, PointLight{{0.02, -8, 3.02}}, Spheres(), {32, 32});
  const MapQuality quality = *Optimized(frame.request, Method::kFocused).lights[0].quality;
  EXPECT_NEAR(quality.perspective, 1.0, 0.1);
  EXPECT_NEAR(quality.projection, 1.0, 0.25);
  EXPECT_GT(quality.budget * quality.fit, 2.0);
}

TEST(MapQuality, AUniformMapOfALongViewHasPerspective) {
  const OwnedFrame frame =
      FrameOf({0, -4, 0.6}, {0, 30, 0.0}, 0.9, DirectionalLight{{0.1, 0.05, -1}}, Spheres(), {2048, 2048});
  const MapQuality focused = *Optimized(frame.request, Method::kFocused).lights[0].quality;
  const MapQuality fitted = *Optimized(frame.request, Method::kDefault).lights[0].quality;
  EXPECT_GT(focused.perspective, 1.2);
  EXPECT_LT(fitted.perspective, focused.perspective);
}

TEST(MapQuality, AGrazingLightHasProjection) {
  // Seen from straight above, so that no perspective is in it; the light stands a few degrees above the
  // horizon.
  const OwnedFrame frame =
      FrameOf({0, 15, 40}, {0, 15.001, 0}, 0.5, DirectionalLight{{1, 0.02, -0.05}}, Spheres(), {1024, 1024});
  const MapQuality quality = *Optimized(frame.request, Method::kFocused).lights[0].quality;
  EXPECT_GT(quality.projection, 2.0);
  EXPECT_LT(quality.perspective, 1.2);
  EXPECT_EQ(quality.Worst(), MapFlaw::kProjection);
}

TEST(MapQuality, SaysNothingWithoutSamples) {
  const OwnedFrame frame =
      FrameOf({0, -8, 3}, {0, 4, 0}, 0.9, DirectionalLight{{0, 0, 1}}, testing::AnalyticScene{});
  const MapQuality quality = *Optimized(frame.request, Method::kDefault).lights[0].quality;
  EXPECT_EQ(quality.Worst(), MapFlaw::kNone);
  EXPECT_EQ(quality.budget, 1.0);
}

}  // namespace
}  // namespace shadowfit
