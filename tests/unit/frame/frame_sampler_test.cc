#include "core/frame/frame_sampler.h"

#include <gtest/gtest.h>
#include <hwy/targets.h>

#include <cmath>
#include <limits>
#include <numbers>

#include "core/fit/metric.h"
#include "tests/support/analytic_scene.h"
#include "tests/unit/frame/plain_sampler.h"

namespace shadowfit {
namespace {

using testing::AnalyticScene;
using testing::OwnedFrame;
using testing::Uniform;

std::vector<LightSamples> Sample(const OwnedFrame& frame, MapSize screen, FrameExtent* extent = nullptr) {
  FrameSampler sampler;
  std::vector<RaySpace> spaces;
  for (const LightRequest& light : frame.request.lights) spaces.push_back(*RaySpace::Create(light.light));
  FrameExtent ignored;
  std::vector<LightSamples> samples;
  sampler.Sample(*Camera::Create(frame.request.camera), frame.request.depth, frame.request.bits, spaces,
                 screen, extent != nullptr ? extent : &ignored, &samples);
  return samples;
}

LightRequest Lamp(Light light) { return {1, light, {256, 256}, {}}; }

/// The world position of boundary sample i.
glm::dvec3 WsPosition(const LightSamples& samples, const RaySpace& space, size_t i) {
  const RaySpace::WsRay ray = space.WorldRay(samples.boundary.Ray(i));
  return space.is_directional() ? ray.origin + samples.boundary.q[i] * ray.direction
                                : ray.origin + ray.direction;
}

class SamplerByConvention : public ::testing::TestWithParam<ClipDepth> {};
INSTANTIATE_TEST_SUITE_P(Conventions, SamplerByConvention,
                         ::testing::Values(ClipDepth::kNegativeOneToOne, ClipDepth::kZeroToOne,
                                           ClipDepth::kReversedZeroToOne));

TEST_P(SamplerByConvention, DerivativesFollowTheFloor) {
  std::mt19937 random(1);
  int checked = 0;
  for (int trial = 0; trial < 20; ++trial) {
    const CameraMatrices matrices = testing::WalkThroughCamera(random, GetParam());
    const Camera camera = *Camera::Create(matrices);
    const OwnedFrame frame =
        testing::Draw(testing::RandomSpheres(random, 5), matrices, 100, 100,
                      {Lamp(PointLight{{3, -2, 15}}), Lamp(DirectionalLight{{0.2, 0.3, -1}})});
    const MapSize screen{800, 600};
    const std::vector<LightSamples> samples = Sample(frame, screen);
    for (size_t light = 0; light < samples.size(); ++light) {
      const RaySpace space = *RaySpace::Create(frame.request.lights[light].light);
      for (size_t i = 0; i < samples[light].boundary.size(); ++i) {
        const glm::dvec3 ws = WsPosition(samples[light], space, i);
        if (std::abs(ws.z) > 1e-3 || glm::length(ws - glm::dvec3(camera.ws_eye())) > 20.0) continue;
        // On the floor, screen and ray coordinates are related by a homography: differentiate it numerically.
        const glm::dvec4 clip = camera.clip_from_world() * glm::dvec4(ws, 1.0);
        const auto ray_at = [&](double dx1, double dx2) {
          const glm::dvec2 ndc(clip.x / clip.w + dx1 * 2.0 / screen.width,
                               clip.y / clip.w + dx2 * 2.0 / screen.height);
          const glm::dvec4 a = camera.WsFromNdc({ndc, NearNdc(GetParam())});
          const glm::dvec4 b = camera.WsFromNdc({ndc, FarNdc(GetParam())});
          const glm::dvec3 origin = glm::dvec3(a) / a.w;
          const glm::dvec3 direction = glm::dvec3(b) / b.w - origin;
          return space.RayFromPoint(origin - (origin.z / direction.z) * direction);
        };
        const glm::dvec3 d1 = (ray_at(0.5, 0) - ray_at(-0.5, 0));
        const glm::dvec3 d2 = (ray_at(0, 0.5) - ray_at(0, -0.5));
        const double scale = glm::length(d1) + glm::length(d2);
        // Float32 depth limits what the buffer's differences can tell.
        EXPECT_LT(glm::length(samples[light].boundary.RayDx1(i) - d1), 0.05 * scale);
        EXPECT_LT(glm::length(samples[light].boundary.RayDx2(i) - d2), 0.05 * scale);
        ++checked;
      }
    }
  }
  EXPECT_GT(checked, 1000);
}

// Between two planes that meet at a small angle there is no discontinuity, and still no derivative of both.
TEST(FrameSampler, DerivativesStayOnTheirSideOfACrease) {
  constexpr int kSide = 64;
  constexpr double kEyeHeight = 10.0;
  constexpr double kCreases[] = {0.03, 0.1, 0.3, -0.1, -0.3};
  for (const double slope : kCreases) {
    // The ground, and from x = 0 on a ramp: z = slope x.
    OwnedFrame frame = testing::DrawShadowOnGround(kSide, Lamp(DirectionalLight{{0.2, 0.3, -1.0}}),
                                                   [](int, int y) { return y < kSide / 2; });
    const Camera camera = *Camera::Create(frame.request.camera);
    const auto point_at = [&](double sx, double sy, bool on_ramp) {
      const double t = std::tan(0.5);
      const glm::dvec2 per_depth((2.0 * sx / kSide - 1.0) * t, (2.0 * sy / kSide - 1.0) * t);
      const double depth = kEyeHeight / (1.0 + (on_ramp ? slope * per_depth.x : 0.0));
      return glm::dvec3(per_depth * depth, kEyeHeight - depth);
    };
    for (int y = 0; y < kSide; ++y) {
      for (int x = 0; x < kSide; ++x) {
        const glm::dvec4 clip =
            camera.clip_from_world() * glm::dvec4(point_at(x + 0.5, y + 0.5, x >= kSide / 2), 1.0);
        frame.depth[static_cast<size_t>(y * kSide + x)] = static_cast<float>(0.5 * clip.z / clip.w + 0.5);
      }
    }
    const LightSamples samples = Sample(frame, {kSide, kSide})[0];
    const RaySpace space = *RaySpace::Create(frame.request.lights[0].light);
    ASSERT_EQ(samples.boundary.size(), size_t{2 * kSide});
    for (size_t i = 0; i < samples.boundary.size(); ++i) {
      const glm::dvec4 clip = camera.clip_from_world() * glm::dvec4(WsPosition(samples, space, i), 1.0);
      const glm::dvec2 screen = (glm::dvec2(clip) / clip.w + 1.0) * (0.5 * kSide);
      const bool on_ramp = screen.x > kSide / 2;
      const glm::dvec3 expected = space.RayFromPoint(point_at(screen.x + 0.5, screen.y, on_ramp)) -
                                  space.RayFromPoint(point_at(screen.x - 0.5, screen.y, on_ramp));
      EXPECT_LT(glm::distance(samples.boundary.RayDx1(i), expected),
                0.02 * std::abs(slope) * glm::length(expected))
          << "slope " << slope << ", column " << screen.x;
    }
  }
}

TEST(FrameSampler, BoundaryLengthAndNormalMeasureAStraightEdge) {
  // A floor seen from straight above, half of it in shadow behind an edge at any angle.
  std::mt19937 random(2);
  for (int trial = 0; trial < 50; ++trial) {
    CameraMatrices matrices;
    matrices.view_from_world = glm::lookAtRH(glm::dvec3(0, 0, 10), glm::dvec3(0, 0, 0), glm::dvec3(0, 1, 0));
    matrices.clip_from_view = glm::perspectiveRH_NO(1.0, 1.0, 0.1, 100.0);
    OwnedFrame frame = testing::Draw(AnalyticScene{}, matrices, 120, 120, {Lamp(PointLight{{0, 0, 20}})});
    const double angle = Uniform(random, 0.0, 2.0 * std::numbers::pi);
    const glm::dvec2 n(std::cos(angle), std::sin(angle));
    const double radius = 50.0;  // A disc, so that the length does not depend on the angle.
    double expected = 0.0;
    for (int y = 0; y < 120; ++y) {
      for (int x = 0; x < 120; ++x) {
        const glm::dvec2 p(x + 0.5 - 60.0, y + 0.5 - 60.0);
        frame.bits[static_cast<size_t>(y * 120 + x)] =
            glm::dot(n, p) > 3.0 && glm::length(p) < radius ? 1 : 0;
      }
    }
    const double half_chord = std::sqrt(radius * radius - 9.0);
    const double arc = 2.0 * radius * std::acos(3.0 / radius);
    expected = 2.0 * half_chord + arc;
    const std::vector<LightSamples> samples = Sample(frame, {480, 480});
    double length = 0.0;
    double along_chord = 0.0;
    for (size_t i = 0; i < samples[0].boundary.size(); ++i) {
      length += samples[0].boundary.length[i];
      const double cosine = std::abs(samples[0].boundary.n1[i] * n.x + samples[0].boundary.n2[i] * n.y);
      if (cosine > 0.95) along_chord += samples[0].boundary.length[i];
    }
    EXPECT_NEAR(length, 4.0 * expected, 0.06 * 4.0 * expected) << "angle " << angle;
    EXPECT_GT(along_chord, 0.9 * 4.0 * 2.0 * half_chord);
    EXPECT_EQ(samples[0].rough_boundary.size(), 0u);
  }
}

TEST(FrameSampler, PlanesHaveNoDiscontinuityAndSilhouettesDo) {
  // Shadow everywhere: hull samples are the rim of the shadow, at the screen's border and at silhouettes.
  std::mt19937 random(3);
  const CameraMatrices matrices = testing::WalkThroughCamera(random, ClipDepth::kNegativeOneToOne);
  OwnedFrame floor = testing::Draw(AnalyticScene{}, matrices, 64, 64, {Lamp(PointLight{{0, 0, 30}})});
  std::fill(floor.bits.begin(), floor.bits.end(), 0);
  for (int y = 0; y < 20; ++y) {
    for (int x = 0; x < 64; ++x) floor.bits[static_cast<size_t>(y * 64 + x)] = 1;
  }
  const std::vector<LightSamples> samples = Sample(floor, {64, 64});
  // The border's 64 + 2 * 20 - 2 pixels, and 2 * 64 along the edge, 2 and 0 of which are at the border too.
  // And of the shadow's inside every eighth pixel of every eighth row.
  EXPECT_EQ(samples[0].hull_rays.size(), 64u + 2 * 20 - 2 + 2 * 64 - 2 + 8 * 2);
  EXPECT_EQ(samples[0].hull_rays_dx1.size(), samples[0].hull_rays.size());
  EXPECT_EQ(samples[0].hull_rays_dx2.size(), samples[0].hull_rays.size());
}

TEST(FrameSampler, GroundUnderALowSunBelongsIntoTheMap) {
  // Half a degree above the horizon: the light grazes all that is seen, and all of it is in shadow.
  std::mt19937 random(3);
  OwnedFrame floor =
      testing::Draw(AnalyticScene{}, testing::WalkThroughCamera(random, ClipDepth::kNegativeOneToOne), 64, 64,
                    {Lamp(DirectionalLight{{1.0, 0.0, -0.009}})});
  std::fill(floor.bits.begin(), floor.bits.end(), 1);
  EXPECT_GE(Sample(floor, {64, 64})[0].hull_rays.size(), 4u * 64 - 4) << "the rim of the picture";
}

TEST(FrameSampler, IgnoresBitsOfSurfacesThatFaceAway) {
  // A light below the floor: whatever the bits say, it reaches nothing that is visible.
  std::mt19937 random(4);
  OwnedFrame frame =
      testing::Draw(AnalyticScene{}, testing::WalkThroughCamera(random, ClipDepth::kNegativeOneToOne), 64, 64,
                    {Lamp(PointLight{{0, 0, -5}})});
  for (size_t i = 0; i < frame.bits.size(); i += 3) frame.bits[i] = 1;
  const std::vector<LightSamples> samples = Sample(frame, {64, 64});
  EXPECT_EQ(samples[0].boundary.size(), 0u);
}

/// The covector of sample i's edge in the plane of a light straight above: l A^-T n, where its length means
/// wrong pixels and its direction is the edge's in the light's picture.
glm::dvec2 LightCovector(const BoundarySamples& samples, size_t i) {
  const glm::dmat2 ray_from_screen(glm::dvec2(samples.RayDx1(i)), glm::dvec2(samples.RayDx2(i)));
  return samples.length[i] * (glm::dvec2(samples.n1[i], samples.n2[i]) * glm::inverse(ray_from_screen));
}

TEST(FrameSampler, EdgesOfATextureHaveAllDirectionsInTheLightsPicture) {
  // Leaves' shadows at noon, smaller than a sample, on ground that runs away from the viewer: each bit is one
  // of its own, and the screen's rows are metres apart where its columns are decimetres.
  std::mt19937 random(7);
  CameraMatrices matrices;
  matrices.view_from_world =
      glm::lookAtRH(glm::dvec3(0, -8, 1.5), glm::dvec3(0, 4, 0.5), glm::dvec3(0, 0, 1));
  matrices.clip_from_view = glm::perspectiveRH_NO(0.4, 1.0, 0.1, 100.0);
  OwnedFrame frame = testing::Draw(AnalyticScene{}, matrices, 100, 100, {Lamp(DirectionalLight{{0, 0, -1}})});
  for (uint32_t& bits : frame.bits) bits = random() & 1u;
  const std::vector<LightSamples> samples = Sample(frame, {400, 400});
  const BoundarySamples& boundary = samples[0].boundary;
  ASSERT_GT(boundary.size(), 1000u);
  double along[4] = {};
  for (size_t i = 0; i < boundary.size(); ++i) {
    const glm::dvec2 g = LightCovector(boundary, i);
    const double size = glm::length(g);
    for (int k = 0; k < 4; ++k) {
      const double angle = k * std::numbers::pi / 4.0;
      along[k] += std::abs(glm::dot(g, glm::dvec2(std::cos(angle), std::sin(angle)))) / size;
    }
    // And however they are turned, they are edges that these samples could have shown.
    EXPECT_GT(boundary.length[i], 0.0);
    EXPECT_NEAR(std::hypot(boundary.n1[i], boundary.n2[i]), 1.0, 1e-9);
  }
  // E|cos| = 2 / pi in every direction, but for the few samples around which bits happen to line up.
  for (const double sum : along) {
    EXPECT_NEAR(sum / static_cast<double>(boundary.size()), 2.0 / std::numbers::pi, 0.07);
  }
}

TEST(FrameSampler, OutlinesOfWhatIsWhollyInShadowAreNoEdges) {
  // A ball before the ground under a lamp: all that is seen of the ball is in shadow, and of the ground the
  // nearest rows; then the other way round.
  AnalyticScene scene;
  scene.spheres = {{{0, 0, 1.2}, 1.2}};
  CameraMatrices matrices;
  matrices.view_from_world = glm::lookAtRH(glm::dvec3(0, -8, 3), glm::dvec3(0, 0, 1), glm::dvec3(0, 0, 1));
  matrices.clip_from_view = glm::perspectiveRH_NO(0.7, 1.0, 0.1, 100.0);
  OwnedFrame frame = testing::Draw(scene, matrices, 100, 100, {Lamp(PointLight{{0.5, -30, 25}})});
  const Camera camera = *Camera::Create(matrices);
  const auto total = [](const BoundarySamples& samples) {
    double sum = 0.0;
    for (const double length : samples.length) sum += length;
    return sum;
  };
  // The ball's outline is some 300 pixels long.
  for (size_t pixel = 0; pixel < frame.bits.size(); ++pixel) {
    const auto x = static_cast<double>(pixel % 100);
    const auto y = static_cast<double>(pixel / 100);
    const glm::dvec4 ws =
        camera.world_from_clip() *
        glm::dvec4((x + 0.5) / 50.0 - 1.0, (y + 0.5) / 50.0 - 1.0, 2.0 * frame.depth[pixel] - 1.0, 1.0);
    frame.bits[pixel] = (ws.z / ws.w > 0.02 && frame.depth[pixel] < 1.0f) || y < 5 ? 1 : 0;
  }
  const LightSamples ball = Sample(frame, {200, 200})[0];
  EXPECT_GT(ball.rough_boundary.size(), 50u);
  EXPECT_LT(total(ball.rough_boundary), 60.0);
  for (size_t pixel = 0; pixel < frame.bits.size(); ++pixel) frame.bits[pixel] = 1 - frame.bits[pixel];
  const LightSamples ground = Sample(frame, {200, 200})[0];
  EXPECT_LT(total(ground.rough_boundary), 60.0);
}

TEST(FrameSampler, AShadowsInsideMayHaveEdgesThatDoNotShow) {
  // The right half of a floor in shadow: its edge shows, and what is a few samples away from it does not.
  const OwnedFrame frame = testing::DrawShadowOnGround(120, Lamp(DirectionalLight{{0, 0, -1}}),
                                                       [](int x, int) { return x >= 60; });
  const LightSamples samples = Sample(frame, {480, 480})[0];
  const RaySpace space = *RaySpace::Create(frame.request.lights[0].light);
  const auto right = space.RayFromPoint({1, 0, 0}) - space.RayFromPoint({0, 0, 0});
  // A sample every eight, and those at the border.
  EXPECT_GT(samples.unseen_boundary.size(), 60u * 120u / 64u / 2u);
  double unseen = 0.0;
  for (size_t i = 0; i < samples.unseen_boundary.size(); ++i) {
    EXPECT_GT(glm::dot(right, samples.unseen_boundary.Ray(i) - space.RayFromPoint({0, 0, 0})), 0.0);
    unseen += samples.unseen_boundary.length[i];
  }
  EXPECT_GT(unseen, 0.0);
  EXPECT_LT(unseen, 0.1 * 480.0);
  // Texels as wide as the shadow get more of it wrong than those of which there are a hundred.
  const ShadowProjection coarse{glm::dmat3(1.0), {2, 2}};
  ShadowProjection fine = coarse;
  fine.texel_from_ray = glm::dmat3(50, 0, 0, 0, 50, 0, 0, 0, 1) * coarse.texel_from_ray;
  const double lost = EdgeMetric(samples.unseen_boundary, coarse.texel_from_ray);
  EXPECT_GT(lost, 20.0 * EdgeMetric(samples.unseen_boundary, fine.texel_from_ray));
}

TEST(FrameSampler, WhatIsLitIsSampledEveryEighthPixel) {
  std::mt19937 random(24);
  OwnedFrame frame =
      testing::Draw(AnalyticScene{}, testing::WalkThroughCamera(random, ClipDepth::kNegativeOneToOne), 64, 64,
                    {Lamp(DirectionalLight{{0.2, 0.3, -1}})});
  const Camera camera = *Camera::Create(frame.request.camera);
  const RaySpace space = *RaySpace::Create(frame.request.lights[0].light);
  FrameSampler sampler;
  FrameExtent extent;
  std::vector<LightSamples> samples;
  const auto lit = [&] {
    sampler.Sample(camera, frame.request.depth, frame.request.bits, {&space, 1}, {128, 256}, &extent,
                   &samples);
    return sampler.LitSamples(camera, space, 0);
  };
  size_t visible = 0;
  for (int y = 4; y < 64; y += 8) {
    for (int x = 4; x < 64; x += 8) visible += frame.request.depth.At(x, y) < 1.0f ? 1 : 0;
  }
  ASSERT_GT(visible, 10u);
  // Nothing casts a shadow.
  const BoundarySamples all = lit();
  ASSERT_EQ(all.size(), 2 * visible);
  for (size_t i = 0; i < all.size(); i += 2) {
    EXPECT_EQ(all.Ray(i), all.Ray(i + 1));
    EXPECT_EQ(glm::dvec2(all.n1[i], all.n2[i + 1]), glm::dvec2(1.0));
    EXPECT_DOUBLE_EQ(all.length[i], 0.1 * 0.5 * 4.0);
    EXPECT_DOUBLE_EQ(all.length[i + 1], 0.1 * 0.5 * 2.0);
  }
  // The picture's lower half in shadow, then all of it.
  std::fill_n(frame.bits.begin(), 32 * 64, 1u);
  EXPECT_LT(lit().size(), all.size());
  std::fill(frame.bits.begin(), frame.bits.end(), 1u);
  EXPECT_EQ(lit().size(), 0u);
}

TEST(FrameSampler, MeasuresTheVisibleDepthRange) {
  std::mt19937 random(5);
  for (const ClipDepth convention :
       {ClipDepth::kNegativeOneToOne, ClipDepth::kZeroToOne, ClipDepth::kReversedZeroToOne}) {
    const OwnedFrame frame =
        testing::Draw(testing::RandomSpheres(random, 5), testing::WalkThroughCamera(random, convention), 32,
                      32, {Lamp(PointLight{{0, 0, 9}})});
    FrameExtent extent;
    Sample(frame, {32, 32}, &extent);
    int visible = 0;
    double nearest = FarNdc(convention);
    double farthest = NearNdc(convention);
    const bool reversed = convention == ClipDepth::kReversedZeroToOne;
    for (const float d : frame.depth) {
      if (static_cast<double>(d) == BackgroundWindowDepth(convention)) continue;
      ++visible;
      const double ndc = NdcFromWindowDepth(convention, static_cast<double>(d));
      nearest = reversed ? std::max(nearest, ndc) : std::min(nearest, ndc);
      farthest = reversed ? std::min(farthest, ndc) : std::max(farthest, ndc);
    }
    EXPECT_EQ(extent.visible_pixels, visible);
    EXPECT_DOUBLE_EQ(extent.nearest_ndc_depth, nearest);
    EXPECT_DOUBLE_EQ(extent.farthest_ndc_depth, farthest);
  }
}

TEST(FrameSampler, AllThirtyTwoLightsAreSampledAlone) {
  // The samples of a light do not depend on which other lights share the frame.
  std::mt19937 random(6);
  std::vector<LightRequest> lights;
  for (uint32_t i = 0; i < 32; ++i) lights.push_back(testing::RandomLight(random, i));
  const AnalyticScene scene = testing::RandomSpheres(random, 6);
  const CameraMatrices matrices = testing::WalkThroughCamera(random, ClipDepth::kZeroToOne);
  const OwnedFrame all = testing::Draw(scene, matrices, 48, 48, lights);
  const std::vector<LightSamples> together = Sample(all, {48, 48});
  for (size_t i = 0; i < lights.size(); i += 5) {
    const OwnedFrame one = testing::Draw(scene, matrices, 48, 48, {lights[i]});
    const std::vector<LightSamples> alone = Sample(one, {48, 48});
    ASSERT_EQ(alone[0].boundary.size(), together[i].boundary.size());
    for (size_t k = 0; k < alone[0].boundary.size(); ++k) {
      EXPECT_EQ(alone[0].boundary.Ray(k), together[i].boundary.Ray(k));
      EXPECT_EQ(alone[0].boundary.length[k], together[i].boundary.length[k]);
    }
  }
}

/// A frame of any size, seen through any camera, with holes in its depth and noise in its bits.
OwnedFrame AnyFrame(std::mt19937& random) {
  const auto convention = static_cast<ClipDepth>(random() % 3);
  CameraMatrices matrices = testing::WalkThroughCamera(random, convention, Uniform(random, 0.5, 2.0));
  if (random() % 4 == 0) {
    const double size = Uniform(random, 2.0, 6.0);
    matrices.clip_from_view = glm::orthoRH_NO(-size, size, -size, size, 0.1, 40.0);
    matrices.clip_depth = ClipDepth::kNegativeOneToOne;
  }
  std::vector<LightRequest> lights;
  for (uint32_t i = 0; i < 1 + random() % 4; ++i) lights.push_back(testing::RandomLight(random, i));
  OwnedFrame frame =
      testing::Draw(testing::RandomSpheres(random, 6), matrices, static_cast<int>(1 + random() % 80),
                    static_cast<int>(1 + random() % 60), lights);
  const bool holes = random() % 2 == 0;
  const bool noise = random() % 2 == 0;
  const float no_depths[] = {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(),
                             1.5f, -0.5f};
  for (size_t i = 0; i < frame.depth.size(); ++i) {
    if (holes && random() % 30 == 0) frame.depth[i] = no_depths[random() % 4];
    if (noise && random() % 10 == 0) frame.bits[i] ^= static_cast<uint32_t>(random());
  }
  if (random() % 8 == 0) frame.request.bits.reset();
  return frame;
}

using Numbers = std::vector<double>;

void Append(const BoundarySamples& samples, Numbers* numbers) {
  numbers->push_back(static_cast<double>(samples.size()));
  numbers->push_back(samples.limit);
  for (size_t i = 0; i < samples.size(); ++i) {
    for (const glm::dvec3& v : {samples.Ray(i), samples.RayDx1(i), samples.RayDx2(i)}) {
      numbers->insert(numbers->end(), {v.x, v.y, v.z});
    }
    numbers->insert(numbers->end(),
                    {samples.q[i], samples.n1[i], samples.n2[i], samples.length[i], samples.tail[i]});
  }
}

Numbers AllNumbersOf(const LightSamples& samples) {
  Numbers numbers = {static_cast<double>(samples.source), samples.pixels_per_sample, samples.narrow_share};
  for (const BoundarySamples* boundary : samples.Boundaries()) Append(*boundary, &numbers);
  for (size_t i = 0; i < samples.hull_rays.size(); ++i) {
    for (const glm::dvec3& v : {samples.hull_rays[i], samples.hull_rays_dx1[i], samples.hull_rays_dx2[i]}) {
      numbers.insert(numbers.end(), {v.x, v.y, v.z});
    }
    numbers.push_back(samples.hull_along_ray[i]);
    numbers.push_back(samples.hull_in_shadow[i]);
  }
  return numbers;
}

TEST(FrameSampler, FindsWhatAPlainSamplerFinds) {
  std::mt19937 random(8);
  FrameSampler sampler;  // The same for frames of all sizes: what earlier ones leave does not matter.
  size_t compared = 0;
  for (int trial = 0; trial < 120; ++trial) {
    const OwnedFrame frame = AnyFrame(random);
    const Camera camera = *Camera::Create(frame.request.camera);
    std::vector<RaySpace> spaces;
    for (const LightRequest& light : frame.request.lights) spaces.push_back(*RaySpace::Create(light.light));
    const MapSize screen{640, 480};
    FrameExtent extent;
    std::vector<LightSamples> samples;
    sampler.Sample(camera, frame.request.depth, frame.request.bits, spaces, screen, &extent, &samples);
    const std::vector<LightSamples> expected =
        testing::SamplePlainly(camera, frame.request.depth, frame.request.bits, spaces, screen);
    for (size_t light = 0; light < spaces.size(); ++light) {
      const Numbers a = AllNumbersOf(samples[light]);
      const Numbers b = AllNumbersOf(expected[light]);
      ASSERT_EQ(a.size(), b.size()) << "trial " << trial << ", light " << light;
      for (size_t i = 0; i < a.size(); ++i) {
        ASSERT_NEAR(a[i], b[i], 1e-7 * (1.0 + std::abs(b[i]))) << "trial " << trial << ", number " << i;
      }
      compared += a.size();
    }
  }
  EXPECT_GT(compared, 500'000u);
}

TEST(FrameSampler, SamplesAreTheSameOnEveryMachine) {
  std::mt19937 random(9);
  for (int trial = 0; trial < 20; ++trial) {
    const OwnedFrame frame = AnyFrame(random);
    std::vector<Numbers> first;
    for (int64_t targets = hwy::SupportedTargets(); targets != 0; targets &= targets - 1) {
      // Lower bits are better targets.
      hwy::SetSupportedTargetsForTest(targets);
      const std::vector<LightSamples> samples = Sample(frame, {640, 480});
      std::vector<Numbers> numbers;
      for (const LightSamples& light : samples) numbers.push_back(AllNumbersOf(light));
      if (first.empty()) first = numbers;
      EXPECT_EQ(numbers, first) << "targets " << targets;
    }
    hwy::SetSupportedTargetsForTest(0);
  }
}

}  // namespace
}  // namespace shadowfit
