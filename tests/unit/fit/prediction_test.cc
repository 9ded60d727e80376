#include "core/fit/prediction.h"

#include <gtest/gtest.h>

#include <random>
#include <vector>

#include "core/fit/frame_optimizer.h"
#include "core/frame/frame_sampler.h"
#include "tests/support/analytic_scene.h"

namespace shadowfit {
namespace {

using testing::OwnedFrame;

/// The same texels over another part of the plane, so many maps' sides further.
ShadowProjection Moved(const ShadowProjection& projection, double maps_right, double maps_up) {
  glm::dmat3 shift(1.0);
  shift[2] = {-maps_right * projection.size.width, -maps_up * projection.size.height, 1.0};
  ShadowProjection moved = projection;
  moved.texel_from_ray = shift * projection.texel_from_ray;
  return moved;
}

struct Sampled {
  OwnedFrame frame;
  Camera camera;
  RaySpace ray_space;
  FrameSampler sampler;
  std::vector<LightSamples> samples;
  ShadowProjection map;  ///< The default method's.

  /// None where the light leaves no shadow's edge or no single map serves.
  static std::optional<Sampled> Any(std::mt19937& random) {
    OwnedFrame frame = Draw(testing::RandomSpheres(random, 12),
                            testing::WalkThroughCamera(random, ClipDepth::kNegativeOneToOne), 80, 80,
                            {testing::RandomLight(random, 1)});
    FrameSummary summary;
    Options options;
    options.standard.hold_all_shadow = true;
    if (!FrameOptimizer().Optimize(frame.request, options, Cancellation(), &summary).ok()) {
      return std::nullopt;
    }
    const LightSummary& light = summary.lights[0];
    if (light.sample_source != SampleSource::kShadowBoundary || !light.further_maps.empty() ||
        light.outcome != FitOutcome::kFitted) {
      return std::nullopt;
    }
    const Camera camera = *Camera::Create(frame.request.camera);
    const RaySpace ray_space = *RaySpace::Create(frame.request.lights[0].light);
    Sampled sampled{std::move(frame), camera, ray_space, {}, {}, light.projection};
    FrameExtent extent;
    sampled.sampler.Sample(sampled.camera, sampled.frame.request.depth, sampled.frame.request.bits,
                           {&sampled.ray_space, 1}, {160, 160}, &extent, &sampled.samples);
    return sampled;
  }

  double Outside(std::vector<ShadowProjection> maps) const {
    return sampler.ShadowOutside(camera, ray_space, 0, maps);
  }

  /// As its definition reads; Draw() gives no bit to what faces away.
  double CountOutside(const ShadowProjection& projection) const {
    double outside = 0.0;
    for (int y = 0; y < 80; ++y) {
      for (int x = 0; x < 80; ++x) {
        if ((frame.request.bits->Row(y)[x] & 1) == 0) continue;
        const glm::dvec3 ndc((x + 0.5) / 40.0 - 1.0, (y + 0.5) / 40.0 - 1.0,
                             2.0 * static_cast<double>(frame.request.depth.Row(y)[x]) - 1.0);
        const glm::dvec4 ws = camera.WsFromNdc(ndc);
        if (!projection.Holds(ray_space.RayFromPoint(glm::dvec3(ws) / ws.w))) outside += 4.0;
      }
    }
    return outside;
  }
};

TEST(Prediction, ShadowOutsideTheMapsIsCounted) {
  std::mt19937 random(31);
  int compared = 0;
  for (int trial = 0; trial < 60; ++trial) {
    const std::optional<Sampled> sampled = Sampled::Any(random);
    if (!sampled) continue;
    ++compared;
    const ShadowProjection& whole = sampled->map;
    EXPECT_TRUE(HoldShadow(sampled->samples[0], {&whole, 1}));
    EXPECT_EQ(sampled->Outside({whole}), 0.0);
    EXPECT_LE(PredictHeldPixels(sampled->samples[0], {&whole, 1}),
              PredictMisclassifiedPixels(sampled->samples[0], {&whole, 1}) * (1.0 + 1e-9));
    const ShadowProjection right = Moved(whole, 0.5, 0.0);
    const double lost = sampled->Outside({right});
    EXPECT_EQ(lost == 0.0, sampled->CountOutside(right) == 0.0);
    // A sphere's rim is grazed by the light.
    EXPECT_NEAR(lost, sampled->CountOutside(right), 0.02 * lost + 40.0) << trial;
    EXPECT_EQ(HoldShadow(sampled->samples[0], {&right, 1}), lost == 0.0);
    // What one half of the map loses the other holds.
    const ShadowProjection left = Moved(whole, -0.5, 0.0);
    EXPECT_EQ(sampled->Outside({right, left}), 0.0);
    EXPECT_DOUBLE_EQ(lost + sampled->Outside({left}), sampled->Outside({Moved(whole, 2.0, 0.0)}));
  }
  EXPECT_GT(compared, 30);
}

// A shadow's inside is sampled here and there: what lies between the samples of two maps is in neither,
// though these hold every sample.
TEST(Prediction, ShadowBetweenTwoMapsIsCounted) {
  LightRequest light;
  light.light = DirectionalLight{{0, 0, -1}};
  const OwnedFrame frame = testing::DrawShadowOnGround(80, light, [](int, int y) { return y < 78; });
  const Camera camera = *Camera::Create(frame.request.camera);
  const RaySpace ray_space = *RaySpace::Create(frame.request.lights[0].light);
  FrameSampler sampler;
  FrameExtent extent;
  std::vector<LightSamples> samples;
  sampler.Sample(camera, frame.request.depth, frame.request.bits, {&ray_space, 1}, {80, 80}, &extent,
                 &samples);
  // Its inside is sampled in columns 4, 12 and so on: the gap lies between two of them.
  const auto ray_at = [&](double x) {
    const auto depth = static_cast<double>(frame.request.depth.At(40, 40));
    const glm::dvec4 ws = camera.WsFromNdc({x / 40.0 - 1.0, 0.0, 2.0 * depth - 1.0});
    return ray_space.RayFromPoint(glm::dvec3(ws) / ws.w);
  };
  const glm::dvec3 across = ray_at(80.0) - ray_at(0.0);
  const auto strip = [&](double from, double to) {
    // u = 0 at one end, 100 at the other; v everywhere the same.
    const double scale = 100.0 / ((to - from) / 80.0 * glm::dot(across, across));
    const glm::dvec3 u_row = scale * (across - glm::dot(across, ray_at(from)) * glm::dvec3(0, 0, 1));
    return ShadowProjection{glm::transpose(glm::dmat3(u_row, glm::dvec3(0, 0, 50), glm::dvec3(0, 0, 1))),
                            {100, 100}};
  };
  const std::vector<ShadowProjection> maps = {strip(-1.0, 38.0), strip(42.0, 81.0)};
  LightProblem problem;
  problem.camera = &camera;
  problem.ray_space = &ray_space;
  problem.samples = samples.data();
  problem.sampler = &sampler;
  ASSERT_TRUE(problem.KnowsShadow());
  const std::optional<double> lost = ShadowOutside(problem, maps);
  ASSERT_TRUE(lost.has_value());
  // Four columns, but for the two lit rows.
  EXPECT_NEAR(*lost, 4.0 * 78.0, 1.0);
  EXPECT_EQ(ShadowOutside(problem, std::vector{strip(-1.0, 81.0)}).value_or(0.0), 0.0);
}

TEST(Prediction, NarrowShadowsTellOfMissedOnes) {
  std::mt19937 random(32);
  for (int trial = 0; trial < 60; ++trial) {
    std::optional<Sampled> sampled = Sampled::Any(random);
    if (!sampled) continue;
    LightSamples& samples = sampled->samples[0];
    ASSERT_GE(samples.narrow_share, 0.0);
    ASSERT_LE(samples.narrow_share, 1.0);
    samples.narrow_share = 0.0;
    const double seen = PredictMisclassifiedPixels(samples, {&sampled->map, 1});
    samples.narrow_share = 0.5;
    EXPECT_DOUBLE_EQ(PredictMisclassifiedPixels(samples, {&sampled->map, 1}),
                     seen * (1.0 + 0.5 * kMissedPerNarrow));
  }
}

}  // namespace
}  // namespace shadowfit
