#include "core/fit/frame_optimizer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "core/fit/outer_samples.h"
#include "core/fit/rescale_previous.h"
#include "core/frame/frame_sampler.h"
#include "tests/support/analytic_scene.h"

namespace shadowfit {
namespace {

using testing::AnalyticScene;
using ::testing::HasSubstr;
using testing::OwnedFrame;
using ::testing::StartsWith;
using testing::Uniform;

/// Maps hold all that they are given: what they may let go of has its own tests (trim_shadow_test.cc).
Options WithMethod(Method method) {
  Options options;
  options.method = method;
  options.standard.hold_all_shadow = true;
  return options;
}

/// The hull samples of a frame, found anew by a sampler of its own.
std::vector<LightSamples> SamplesOf(const FrameRequest& request) {
  FrameSampler sampler;
  const Camera camera = *Camera::Create(request.camera);
  std::vector<RaySpace> spaces;
  for (const LightRequest& light : request.lights) spaces.push_back(*RaySpace::Create(light.light));
  FrameExtent extent;
  std::vector<LightSamples> samples;
  const MapSize screen =
      request.screen == MapSize{} ? MapSize{request.depth.width, request.depth.height} : request.screen;
  sampler.Sample(camera, request.depth, request.bits, spaces, screen, &extent, &samples);
  return samples;
}

/// Finite, not mirrored, w > 0 and inside the map for every hull sample, and equal in its 4x4 form.
/// Maps of the default method hold the shadow, the papers' all boundary samples.
void ExpectUsable(const FrameRequest& request, const FrameSummary& summary, Method method) {
  const std::vector<LightSamples> samples = SamplesOf(request);
  ASSERT_EQ(summary.lights.size(), request.lights.size());
  for (size_t i = 0; i < summary.lights.size(); ++i) {
    const LightSummary& light = summary.lights[i];
    const RaySpace space = *RaySpace::Create(request.lights[i].light);
    for (int k = 0; k < 16; ++k)
      ASSERT_TRUE(std::isfinite(light.clip_from_world[k / 4][k % 4])) << "light " << i;
    EXPECT_NEAR(glm::length(light.projection.Axis()), 1.0, 1e-9);
    double texels = light.projection.size.texels();
    for (const LightMap& map : light.further_maps) texels += map.projection.size.texels();
    EXPECT_LE(texels, request.lights[i].map_size.texels());
    if (light.outcome == FitOutcome::kFallback) {
      EXPECT_FALSE(light.note.empty());
      continue;
    }
    std::vector<const LightMap*> maps = {&light};
    for (const LightMap& map : light.further_maps) maps.push_back(&map);
    for (const int32_t k :
         HullSamples(samples[i], method == Method::kDefault ? HullOf::kShadow : HullOf::kSamples)) {
      const glm::dvec3& ray = samples[i].hull_rays[static_cast<size_t>(k)];
      if (glm::length(ray) == 0.0) continue;  // The light itself.
      bool held = false;
      for (const LightMap* map : maps) {
        const glm::dvec3 u = map->projection.TexelFromRay(ray);
        const double width = map->projection.size.width;
        const double height = map->projection.size.height;
        const double slack = 1e-6 * std::max(width, height);
        if (!map->projection.Holds(ray, slack)) continue;
        held = true;
        // The same through the 4x4 matrix.
        const RaySpace::WsRay ws_ray = space.WorldRay(ray);
        const glm::dvec3 ws = space.is_directional() ? ws_ray.origin : ws_ray.origin + ws_ray.direction;
        const glm::dvec4 clip = map->clip_from_world * glm::dvec4(ws, 1.0);
        EXPECT_NEAR((clip.x / clip.w + 1.0) / 2.0 * width, u.x, 1e-5 * width);
        EXPECT_NEAR((clip.y / clip.w + 1.0) / 2.0 * height, u.y, 1e-5 * height);
      }
      ASSERT_TRUE(held) << "light " << i;
    }
  }
}

OwnedFrame StandardFrame(std::vector<LightRequest> lights, int size = 64) {
  std::mt19937 random(5);
  return testing::Draw(testing::RandomSpheres(random, 12),
                       testing::WalkThroughCamera(random, ClipDepth::kNegativeOneToOne), size, size,
                       std::move(lights));
}

LightRequest MakeLight(Light light, uint32_t id = 1, MapSize size = {256, 256}) {
  return {id, light, size, {}};
}

FrameSummary Optimize(const FrameRequest& request, Method method = Method::kPaper) {
  FrameOptimizer optimizer;
  FrameSummary summary;
  const absl::Status status = optimizer.Optimize(request, WithMethod(method), Cancellation(), &summary);
  EXPECT_TRUE(status.ok()) << status;
  return summary;
}

class EveryMethod : public ::testing::TestWithParam<Method> {};
INSTANTIATE_TEST_SUITE_P(Methods, EveryMethod, ::testing::Values(Method::kPaper, Method::kDefault),
                         [](const auto& info) { return std::string(MethodName(info.param)); });

TEST_P(EveryMethod, NoHullSampleFallsOutsideTheMapInTenThousandFrames) {
  std::mt19937 random(11);
  FrameOptimizer optimizer;
  FrameSummary summary;
  for (int trial = 0; trial < 10000; ++trial) {
    const auto convention = static_cast<ClipDepth>(random() % 3);
    const AnalyticScene scene = testing::RandomSpheres(random, static_cast<int>(random() % 8));
    OwnedFrame frame = testing::Draw(scene, testing::WalkThroughCamera(random, convention), 14, 14,
                                     {testing::RandomLight(random, 0), testing::RandomLight(random, 1)});
    frame.request.output_clip_depth = static_cast<ClipDepth>(random() % 3);
    const absl::Status status =
        optimizer.Optimize(frame.request, WithMethod(GetParam()), Cancellation(), &summary);
    ASSERT_TRUE(status.ok()) << status;
    ASSERT_NO_FATAL_FAILURE(ExpectUsable(frame.request, summary, GetParam())) << "trial " << trial;
  }
}

TEST_P(EveryMethod, DepthIsMonotoneAlongEveryLightRay) {
  std::mt19937 random(12);
  for (int trial = 0; trial < 200; ++trial) {
    const auto convention = static_cast<ClipDepth>(random() % 3);
    OwnedFrame frame = testing::Draw(testing::RandomSpheres(random, 6),
                                     testing::WalkThroughCamera(random, ClipDepth::kNegativeOneToOne), 24, 24,
                                     {testing::RandomLight(random, 0)});
    frame.request.output_clip_depth = convention;
    const FrameSummary summary = Optimize(frame.request, GetParam());
    const std::vector<LightSamples> samples = SamplesOf(frame.request);
    const RaySpace space = *RaySpace::Create(frame.request.lights[0].light);
    const bool rising = convention != ClipDepth::kReversedZeroToOne;
    for (size_t k = 0; k < samples[0].hull_rays.size(); k += 7) {
      // A fallback's map, or the first of several, does not hold every ray.
      if (!summary.lights[0].projection.Holds(samples[0].hull_rays[k])) continue;
      const RaySpace::WsRay ray = space.WorldRay(samples[0].hull_rays[k]);
      double previous = rising ? -1e300 : 1e300;
      for (int tenth = 1; tenth < 20; ++tenth) {
        const double t = 0.1 * tenth;
        const double along = space.is_directional() ? samples[0].hull_along_ray[k] + 20.0 * (t - 1.0) : t;
        const glm::dvec4 clip =
            summary.lights[0].clip_from_world * glm::dvec4(ray.origin + along * ray.direction, 1.0);
        const double z = clip.z / clip.w;
        EXPECT_TRUE(rising ? z > previous : z < previous);
        previous = z;
        if (std::abs(t - 1.0) < 1e-9) {  // The receiver itself lies within the depth range.
          EXPECT_GE(z, std::min(NearNdc(convention), FarNdc(convention)) - 1e-9);
          EXPECT_LE(z, std::max(NearNdc(convention), FarNdc(convention)) + 1e-9);
        }
      }
    }
  }
}

TEST_P(EveryMethod, KeepsTheWindingOfTriangles) {
  std::mt19937 random(13);
  for (int trial = 0; trial < 200; ++trial) {
    OwnedFrame frame = testing::Draw(testing::RandomSpheres(random, 6),
                                     testing::WalkThroughCamera(random, ClipDepth::kNegativeOneToOne), 24, 24,
                                     {testing::RandomLight(random, 0)});
    const FrameSummary summary = Optimize(frame.request, GetParam());
    const std::vector<LightSamples> samples = SamplesOf(frame.request);
    if (samples[0].hull_rays.empty()) continue;
    const RaySpace space = *RaySpace::Create(frame.request.lights[0].light);
    const RaySpace::WsRay ray = space.WorldRay(samples[0].hull_rays[0]);
    if (!(summary.lights[0].projection.TexelFromRay(samples[0].hull_rays[0]).z > 0.0)) continue;
    // A small triangle across the ray, counter-clockwise for who looks along it.
    const glm::dvec3 center = space.is_directional() ? ray.origin : ray.origin + ray.direction;
    const glm::dvec3 back = -glm::normalize(ray.direction);
    const glm::dvec3 right =
        glm::normalize(glm::cross(std::abs(back.z) < 0.9 ? glm::dvec3(0, 0, 1) : glm::dvec3(1, 0, 0), back));
    const glm::dvec3 up = glm::cross(back, right);
    const auto clip = [&](const glm::dvec3& offset) {
      const glm::dvec4 c = summary.lights[0].clip_from_world * glm::dvec4(center + 1e-3 * offset, 1.0);
      return glm::dvec2(c) / c.w;
    };
    const glm::dvec2 a = clip(glm::dvec3(0.0));
    const glm::dvec2 b = clip(right) - a;
    const glm::dvec2 c = clip(up) - a;
    EXPECT_GT(b.x * c.y - b.y * c.x, 0.0) << "trial " << trial;
  }
}

TEST_P(EveryMethod, ServesOrStatesDegenerateConfigurations) {
  const glm::dmat4 world_from_view =
      glm::inverse(StandardFrame({MakeLight(DirectionalLight{})}, 2).request.camera.view_from_world);
  const glm::dvec3 camera_forward = -glm::dvec3(world_from_view[2]);
  const glm::dvec3 camera_eye(world_from_view[3]);
  struct Case {
    const char* name;
    Light light;
  };
  const Case cases[] = {
      {"inside the view frustum", PointLight{{0, 0, 1}}},
      {"inside the view frustum, spot", SpotLight{{0, 0, 2}, {0, 0, -1}, 0.8}},
      {"behind the camera", PointLight{{0, -30, 4}}},
      {"below the floor", PointLight{{0, 0, -5}}},
      {"in the floor", PointLight{{20, 0, 0}}},
      {"sun parallel to the view", DirectionalLight{camera_forward}},
      {"sun against the view", DirectionalLight{-camera_forward}},
      {"sun at the horizon", DirectionalLight{{1, 0, 0}}},
      {"sun from below", DirectionalLight{{0, 0, 1}}},
      {"very far point", PointLight{{1e7, 1e7, 1e7}}},
      {"sun at noon", DirectionalLight{{0, 0, -1}}},
      {"dueling frusta, spot",
       SpotLight{camera_eye + 12.0 * camera_forward + glm::dvec3(0, 0, 3), -camera_forward, 0.7}},
      {"dueling frusta, point", PointLight{camera_eye + 30.0 * camera_forward + glm::dvec3(0, 0, 12)}},
      {"in the floor that is seen", PointLight{{0, 0, 0}}},
      {"just above the floor", PointLight{{12, 3, 1e-6}}},
      {"sun in the floor's plane but for a hair", DirectionalLight{{1, 0.2, -1e-9}}},
  };
  for (const Case& c : cases) {
    SCOPED_TRACE(c.name);
    OwnedFrame frame = StandardFrame({MakeLight(c.light)});
    const FrameSummary summary = Optimize(frame.request, GetParam());
    ExpectUsable(frame.request, summary, GetParam());
  }
}

TEST_P(EveryMethod, ServesAllLitAllShadowedAndEmptyFrames) {
  const Light sun = DirectionalLight{{0.3, 0.2, -1}};
  OwnedFrame frame = StandardFrame({MakeLight(sun)});
  {
    SCOPED_TRACE("all lit");
    std::fill(frame.bits.begin(), frame.bits.end(), 0);
    const FrameSummary summary = Optimize(frame.request, GetParam());
    ExpectUsable(frame.request, summary, GetParam());
    EXPECT_EQ(summary.lights[0].sample_source, SampleSource::kAllVisible);
    EXPECT_EQ(summary.lights[0].predicted_misclassified_pixels, 0.0);
  }
  {
    SCOPED_TRACE("all shadowed");
    std::fill(frame.bits.begin(), frame.bits.end(), ~uint32_t{0});
    const FrameSummary summary = Optimize(frame.request, GetParam());
    ExpectUsable(frame.request, summary, GetParam());
    EXPECT_EQ(summary.lights[0].sample_source, SampleSource::kAllVisible);
  }
  {
    SCOPED_TRACE("no bits");
    frame.request.bits.reset();
    const FrameSummary summary = Optimize(frame.request, GetParam());
    ExpectUsable(frame.request, summary, GetParam());
    EXPECT_EQ(summary.lights[0].sample_source, SampleSource::kAllVisible);
  }
  {
    SCOPED_TRACE("empty scene");
    for (const float background :
         {1.0f, std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()}) {
      std::fill(frame.depth.begin(), frame.depth.end(), background);
      const FrameSummary summary = Optimize(frame.request, GetParam());
      ExpectUsable(frame.request, summary, GetParam());
      EXPECT_EQ(summary.lights[0].sample_source, SampleSource::kNone);
    }
  }
  {
    SCOPED_TRACE("one visible pixel");
    frame.depth[1000] = 0.9f;
    ExpectUsable(frame.request, Optimize(frame.request, GetParam()), GetParam());
  }
}

TEST_P(EveryMethod, ServesOneBoundarySample) {
  OwnedFrame frame =
      StandardFrame({MakeLight(DirectionalLight{{0.3, 0.2, -1}}), MakeLight(PointLight{{3, 2, 9}}, 2)});
  int served = 0;
  for (size_t pixel = 0; pixel < frame.bits.size(); pixel += 61) {
    std::fill(frame.bits.begin(), frame.bits.end(), 0);
    frame.bits[pixel] = 3;
    const FrameSummary summary = Optimize(frame.request, GetParam());
    ExpectUsable(frame.request, summary, GetParam());
    for (const LightSummary& light : summary.lights) {
      if (light.sample_source != SampleSource::kShadowBoundary) continue;
      EXPECT_LE(light.boundary_samples, 9);
      EXPECT_TRUE(std::isfinite(light.predicted_misclassified_pixels));
      ++served;
    }
  }
  EXPECT_GT(served, 10);
  // Two pixels see anything, and one of them is in shadow.
  const std::vector<float> depth = frame.depth;
  for (size_t pixel = 0; pixel + 1 < depth.size(); pixel += 61) {
    std::fill(frame.depth.begin(), frame.depth.end(), 1.0f);
    std::fill(frame.bits.begin(), frame.bits.end(), 0);
    frame.depth[pixel] = depth[pixel];
    frame.depth[pixel + 1] = depth[pixel + 1];
    frame.bits[pixel] = 3;
    ExpectUsable(frame.request, Optimize(frame.request, GetParam()), GetParam());
  }
}

TEST_P(EveryMethod, ServesCollinearHulls) {
  // A single row of the picture sees the ground: a line.
  AnalyticScene scene;
  std::mt19937 random(8);
  OwnedFrame frame =
      testing::Draw(scene, testing::WalkThroughCamera(random, ClipDepth::kNegativeOneToOne), 48, 48,
                    {MakeLight(PointLight{{3, 4, 9}}, 1), MakeLight(DirectionalLight{{0, 1, -1}}, 2)});
  const std::vector<float> depth = frame.depth;
  for (const bool column : {false, true}) {
    int visible = 0;
    for (size_t pixel = 0; pixel < depth.size(); ++pixel) {
      const bool kept = column ? pixel % 48 == 20 : pixel / 48 == 9;
      frame.depth[pixel] = kept ? depth[pixel] : 1.0f;
      frame.bits[pixel] = pixel % 5 == 0 ? 3 : 0;
      visible += frame.depth[pixel] < 1.0f;
    }
    ASSERT_GT(visible, 10);
    ExpectUsable(frame.request, Optimize(frame.request, GetParam()), GetParam());
  }
}

TEST_P(EveryMethod, ServesSamplesOnOneRay) {
  // The middle row of the picture lies in the plane z = 2, and what it sees on one line in it.
  constexpr int kSize = 33;
  CameraMatrices camera;
  camera.view_from_world = glm::lookAtRH(glm::dvec3(0, -10, 2), glm::dvec3(0, 0, 2), glm::dvec3(0, 0, 1));
  camera.clip_from_view = testing::Perspective(1.0, 1.0, 0.5, 100.0, ClipDepth::kNegativeOneToOne);
  const glm::dvec3 ws_start(-3.0, -2.0, 2.0);
  const glm::dvec3 along = glm::normalize(glm::dvec3(0.6, 0.8, 0.0));
  for (const Light& light : {Light(DirectionalLight{along}), Light(PointLight{ws_start - 4.0 * along}),
                             Light(SpotLight{ws_start - 4.0 * along, along, 0.3})}) {
    OwnedFrame frame;
    frame.request.camera = camera;
    frame.request.lights = {MakeLight(light)};
    frame.depth.assign(kSize * kSize, 1.0f);
    frame.bits.assign(kSize * kSize, 0);
    const glm::dmat4 clip_from_world = camera.clip_from_view * camera.view_from_world;
    int visible = 0;
    for (int x = 0; x < kSize; ++x) {
      const double slope = ((x + 0.5) * 2.0 / kSize - 1.0) * std::tan(0.5);
      // (slope, 1) s from the eye meets the line.
      const double s = (ws_start.x * along.y - (ws_start.y + 10.0) * along.x) / (slope * along.y - along.x);
      const glm::dvec3 ws(slope * s, s - 10.0, 2.0);
      if (!(s > 1.0) || !(s < 90.0) || glm::dot(ws - ws_start, along) < 0.0) continue;
      const glm::dvec4 clip = clip_from_world * glm::dvec4(ws, 1.0);
      const size_t pixel = static_cast<size_t>(kSize / 2 * kSize + x);
      frame.depth[pixel] = static_cast<float>(0.5 * clip.z / clip.w + 0.5);
      frame.bits[pixel] = static_cast<uint32_t>(x % 3 == 0);
      ++visible;
    }
    ASSERT_GT(visible, 5);
    frame.request.depth = BottomFirst(frame.depth.data(), kSize, kSize);
    for (const bool with_bits : {true, false}) {
      frame.request.bits.reset();
      if (with_bits) frame.request.bits = BottomFirst(frame.bits.data(), kSize, kSize);
      ExpectUsable(frame.request, Optimize(frame.request, GetParam()), GetParam());
    }
  }
}

TEST_P(EveryMethod, ServesThirtyTwoLights) {
  std::mt19937 random(15);
  std::vector<LightRequest> lights;
  for (uint32_t i = 0; i < kMaxLights; ++i) lights.push_back(testing::RandomLight(random, i));
  OwnedFrame frame = StandardFrame(lights);
  const FrameSummary summary = Optimize(frame.request, GetParam());
  ExpectUsable(frame.request, summary, GetParam());
  // Each is fitted as it would be alone.
  for (const size_t i : {0U, 17U, 31U}) {
    OwnedFrame alone = StandardFrame({lights[i]});
    EXPECT_EQ(Optimize(alone.request, GetParam()).lights[0].clip_from_world,
              summary.lights[i].clip_from_world)
        << i;
  }
}

TEST_P(EveryMethod, SurvivesCamerasOfExtremeNumbers) {
  // Unprojection overflows: a finite matrix or an error that says so, and no crash.
  std::mt19937 random(14);
  FrameOptimizer optimizer;
  FrameSummary summary;
  for (int trial = 0; trial < 2000; ++trial) {
    OwnedFrame frame = StandardFrame({testing::RandomLight(random, 1), testing::RandomLight(random, 2)}, 12);
    for (glm::dmat4* matrix : {&frame.request.camera.view_from_world, &frame.request.camera.clip_from_view}) {
      for (int k = 0; k < 4; ++k) {
        (*matrix)[static_cast<int>(random() % 4)][static_cast<int>(random() % 4)] =
            Uniform(random, -1, 1) * std::pow(10.0, Uniform(random, -300, 300));
      }
    }
    const absl::Status status =
        optimizer.Optimize(frame.request, WithMethod(GetParam()), Cancellation(), &summary);
    if (!status.ok()) {
      EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << status;
      continue;
    }
    for (const LightSummary& light : summary.lights) {
      for (int k = 0; k < 16; ++k) EXPECT_TRUE(std::isfinite(light.clip_from_world[k / 4][k % 4]));
    }
  }
}

TEST_P(EveryMethod, ServesACameraInsideAnObject) {
  AnalyticScene scene;
  scene.spheres.push_back({{0, -10, 1.5}, 3.0});
  std::mt19937 random(8);
  OwnedFrame frame =
      testing::Draw(scene, testing::WalkThroughCamera(random, ClipDepth::kNegativeOneToOne), 48, 48,
                    {MakeLight(PointLight{{3, 4, 9}}, 1), MakeLight(DirectionalLight{{0, 1, -1}}, 2)});
  ExpectUsable(frame.request, Optimize(frame.request, GetParam()), GetParam());
}

TEST_P(EveryMethod, AnswersDependOnTheRequestAlone) {
  std::mt19937 random(9);
  OwnedFrame first = StandardFrame({testing::RandomLight(random, 1), testing::RandomLight(random, 2)});
  OwnedFrame other = StandardFrame({testing::RandomLight(random, 1)}, 50);
  FrameOptimizer used;
  FrameSummary warm;
  FrameSummary discarded;
  ASSERT_TRUE(used.Optimize(other.request, WithMethod(GetParam()), Cancellation(), &discarded).ok());
  ASSERT_TRUE(used.Optimize(first.request, WithMethod(GetParam()), Cancellation(), &warm).ok());
  const FrameSummary fresh = Optimize(first.request, GetParam());
  for (size_t i = 0; i < fresh.lights.size(); ++i) {
    EXPECT_EQ(fresh.lights[i].clip_from_world, warm.lights[i].clip_from_world);
  }
}

TEST_P(EveryMethod, RowOrderDoesNotMatter) {
  std::mt19937 random(10);
  OwnedFrame frame = StandardFrame({testing::RandomLight(random, 1)});
  const FrameSummary bottom_first = Optimize(frame.request, GetParam());
  const int size = frame.request.depth.width;
  std::vector<float> depth(frame.depth.size());
  std::vector<uint32_t> bits(frame.bits.size());
  for (int y = 0; y < size; ++y) {
    std::copy_n(frame.depth.begin() + y * size, size, depth.begin() + (size - 1 - y) * size);
    std::copy_n(frame.bits.begin() + y * size, size, bits.begin() + (size - 1 - y) * size);
  }
  frame.request.depth = TopFirst(depth.data(), size, size);
  frame.request.bits = TopFirst(bits.data(), size, size);
  EXPECT_EQ(Optimize(frame.request, GetParam()).lights[0].clip_from_world,
            bottom_first.lights[0].clip_from_world);
}

TEST(PaperMethod, KeepsThePreviousMatrixUntilTheMedianImproves) {
  OwnedFrame frame = StandardFrame({MakeLight(PointLight{{4, -2, 12}})});
  const FrameSummary fresh = Optimize(frame.request);
  EXPECT_EQ(fresh.lights[0].outcome, FitOutcome::kFitted);
  frame.request.lights[0].previous_clip_from_world = fresh.lights[0].clip_from_world;
  const FrameSummary again = Optimize(frame.request);
  EXPECT_EQ(again.lights[0].outcome, FitOutcome::kKeptPrevious);
  for (int k = 0; k < 4; ++k) {
    EXPECT_LT(glm::length(again.lights[0].clip_from_world[k] - fresh.lights[0].clip_from_world[k]), 1e-9);
  }
  // A previous matrix of sixteen times the extent is not good enough.
  ShadowProjection loose = fresh.lights[0].projection;
  const glm::dmat3 shrink(glm::dvec3(0.25, 0, 0), glm::dvec3(0, 0.25, 0), glm::dvec3(96, 96, 1));
  loose.texel_from_ray = shrink * loose.texel_from_ray;
  const RaySpace space = *RaySpace::Create(frame.request.lights[0].light);
  frame.request.lights[0].previous_clip_from_world =
      ClipFromWorld(space, loose, fresh.lights[0].depth_range, ClipDepth::kNegativeOneToOne);
  EXPECT_EQ(Optimize(frame.request).lights[0].outcome, FitOutcome::kFitted);
}

TEST(DefaultMethod, KeepsThePreviousMatrixWhileItIsNearlyAsGood) {
  OwnedFrame frame = StandardFrame({MakeLight(PointLight{{4, -2, 12}})});
  const FrameSummary fresh = Optimize(frame.request, Method::kDefault);
  ASSERT_EQ(fresh.lights[0].outcome, FitOutcome::kFitted);
  const RaySpace space = *RaySpace::Create(frame.request.lights[0].light);
  // A map of the same axis and `factor` times the extent gets about `factor` times as many pixels wrong.
  const auto outcome_after = [&](double factor) {
    ShadowProjection loose = fresh.lights[0].projection;
    const double shift = 0.5 * (1.0 - 1.0 / factor) * loose.size.width;
    loose.texel_from_ray = glm::dmat3(glm::dvec3(1.0 / factor, 0, 0), glm::dvec3(0, 1.0 / factor, 0),
                                      glm::dvec3(shift, shift, 1)) *
                           loose.texel_from_ray;
    frame.request.lights[0].previous_clip_from_world =
        ClipFromWorld(space, loose, fresh.lights[0].depth_range, ClipDepth::kNegativeOneToOne);
    const FrameSummary next = Optimize(frame.request, Method::kDefault);
    // Never predicted worse than what the knob allows.
    EXPECT_LT(next.lights[0].predicted_misclassified_pixels,
              (DefaultOptions{}.keep_within + 0.01) * fresh.lights[0].predicted_misclassified_pixels);
    return next.lights[0].outcome;
  };
  EXPECT_EQ(outcome_after(1.0), FitOutcome::kKeptPrevious);
  EXPECT_EQ(outcome_after(1.05), FitOutcome::kKeptPrevious);
  EXPECT_EQ(outcome_after(1.2), FitOutcome::kFitted);
}

TEST(DefaultMethod, RecoversFromAMatrixForAnotherView) {
  std::mt19937 random(11);
  for (int i = 0; i < 30; ++i) {
    const AnalyticScene scene = testing::RandomSpheres(random, 12);
    const Light light = i % 3 == 0 ? Light(DirectionalLight{{0.3, -0.4, -0.7}})
                                   : Light(PointLight{{Uniform(random, -8, 8), Uniform(random, -8, 8), 12}});
    const auto frame_from = [&](const CameraMatrices& camera) {
      return testing::Draw(scene, camera, 90, 90, {MakeLight(light)});
    };
    const OwnedFrame before = frame_from(testing::WalkThroughCamera(random, ClipDepth::kNegativeOneToOne));
    OwnedFrame frame = frame_from(testing::WalkThroughCamera(random, ClipDepth::kNegativeOneToOne));
    const double fresh = Optimize(frame.request, Method::kDefault).lights[0].predicted_misclassified_pixels;
    frame.request.lights[0].previous_clip_from_world =
        Optimize(before.request, Method::kDefault).lights[0].clip_from_world;
    const FrameSummary next = Optimize(frame.request, Method::kDefault);
    EXPECT_LE(next.lights[0].predicted_misclassified_pixels, 1.1 * DefaultOptions{}.keep_within * fresh) << i;
    Options always_new = WithMethod(Method::kDefault);
    always_new.standard.keep_within = 0.0;
    FrameOptimizer optimizer;
    FrameSummary renewed;
    ASSERT_TRUE(optimizer.Optimize(frame.request, always_new, Cancellation(), &renewed).ok());
    EXPECT_LE(renewed.lights[0].predicted_misclassified_pixels, 1.05 * fresh) << i;
    EXPECT_EQ(renewed.lights[0].outcome, FitOutcome::kFitted);
  }
}

TEST(DefaultMethod, KeepsAtAGlanceWhatTheSearchWouldKeepToo) {
  std::mt19937 random(17);
  Options always_new = WithMethod(Method::kDefault);
  always_new.standard.keep_within = 0.0;
  Options without_glance = WithMethod(Method::kDefault);
  without_glance.standard.glance_samples = 0;
  const auto answer = [](const OwnedFrame& frame, const Options& options) {
    FrameOptimizer optimizer;
    FrameSummary summary;
    EXPECT_TRUE(optimizer.Optimize(frame.request, options, Cancellation(), &summary).ok());
    return summary.lights[0];
  };
  int kept = 0;
  int kept_too = 0;
  int cheaper = 0;
  for (int i = 0; i < 60; ++i) {
    const AnalyticScene scene = testing::RandomSpheres(random, 12);
    const Light light = i % 3 == 0 ? Light(DirectionalLight{{0.3, -0.4, -0.7}})
                                   : Light(PointLight{{Uniform(random, -8, 8), Uniform(random, -8, 8), 12}});
    CameraMatrices camera = testing::WalkThroughCamera(random, ClipDepth::kNegativeOneToOne);
    const LightSummary before = answer(testing::Draw(scene, camera, 90, 90, {MakeLight(light)}), always_new);
    // A step, or a long way: the previous matrix is nearly as good, or far from it.
    camera.view_from_world = glm::translate(camera.view_from_world,
                                            glm::dvec3(i % 2 == 0 ? 0.05 : Uniform(random, -3, 3), 0.0, 0.0));
    OwnedFrame frame = testing::Draw(scene, camera, 90, 90, {MakeLight(light)});
    frame.request.lights[0].previous_clip_from_world = before.clip_from_world;
    const LightSummary glanced = answer(frame, WithMethod(Method::kDefault));
    const LightSummary searched = answer(frame, without_glance);
    EXPECT_LE(glanced.predicted_misclassified_pixels,
              1.1 * DefaultOptions{}.keep_within * answer(frame, always_new).predicted_misclassified_pixels)
        << i;
    // What no glance decides is searched as without it.
    if (glanced.outcome != FitOutcome::kKeptPrevious) {
      EXPECT_EQ(glanced.clip_from_world, searched.clip_from_world) << i;
      continue;
    }
    ++kept;
    if (searched.outcome == FitOutcome::kKeptPrevious) ++kept_too;
    if (glanced.evaluations < searched.evaluations) ++cheaper;
  }
  EXPECT_GE(kept, 25);
  EXPECT_GE(kept_too, kept - 2);
  EXPECT_GE(cheaper, kept * 3 / 4);
}

TEST(PaperMethod, IgnoresAPreviousMatrixOfAnotherLightAndSaysSo) {
  OwnedFrame frame = StandardFrame({MakeLight(PointLight{{4, -2, 12}})});
  const glm::dmat4 matrix = Optimize(frame.request).lights[0].clip_from_world;
  frame.request.lights[0].light = PointLight{{-4, 2, 12}};
  const FrameSummary without = Optimize(frame.request);
  frame.request.lights[0].previous_clip_from_world = matrix;
  const FrameSummary with = Optimize(frame.request);
  EXPECT_THAT(with.lights[0].note, HasSubstr("not this light's"));
  EXPECT_EQ(with.lights[0].clip_from_world, without.lights[0].clip_from_world);
}

TEST(RescaleToHold, KeepsAxisAndDirectionsAndHoldsAllRays) {
  std::mt19937 random(21);
  const ShadowProjection previous{WithUnitAxis(glm::dmat3({3, 1, 0.1}, {-1, 2, 0.0}, {40, 50, 1.0})),
                                  {100, 100}};
  std::vector<glm::dvec3> rays;
  for (int i = 0; i < 50; ++i) rays.emplace_back(Uniform(random, -3, 3), Uniform(random, -3, 3), 2.0);
  const std::optional<ShadowProjection> held = RescaleToHold(previous, {200, 50}, rays, 0.1);
  ASSERT_TRUE(held.has_value());
  EXPECT_LT(glm::length(held->Axis() - previous.Axis()), 1e-12);
  for (const glm::dvec3& r : rays) {
    const glm::dvec3 u = held->TexelFromRay(r);
    EXPECT_GE(u.x, 20.0 - 1e-9);
    EXPECT_LE(u.x, 180.0 + 1e-9);
    EXPECT_GE(u.y, 5.0 - 1e-9);
    EXPECT_LE(u.y, 45.0 + 1e-9);
  }
  rays.emplace_back(0.0, 0.0, -1.0);
  EXPECT_FALSE(RescaleToHold(previous, {200, 50}, rays, 0.1).has_value());
}

/// Extremes of the rays' texel coordinates.
std::pair<glm::dvec2, glm::dvec2> ReachOf(const ShadowProjection& projection,
                                          const std::vector<glm::dvec3>& rays) {
  glm::dvec2 low(1e300);
  glm::dvec2 high(-1e300);
  for (const glm::dvec3& r : rays) {
    low = glm::min(low, glm::dvec2(projection.TexelFromRay(r)));
    high = glm::max(high, glm::dvec2(projection.TexelFromRay(r)));
  }
  return {low, high};
}

TEST(RescaleToHold, LosesNoRayAndMovesTexelsByWholeOnesWhereTheyFit) {
  std::mt19937 random(5);
  int stayed = 0;
  int shifted = 0;
  int scaled = 0;
  for (int trial = 0; trial < 4000; ++trial) {
    const int side = 1 << (2 + trial % 8);
    const MapSize size{side, side + trial % 5};
    glm::dmat3 matrix(
        glm::dvec3(Uniform(random, 0.5, 1), Uniform(random, -0.4, 0.4), Uniform(random, -0.1, 0.1)),
        glm::dvec3(Uniform(random, -0.4, 0.4), Uniform(random, 0.5, 1), Uniform(random, -0.1, 0.1)),
        glm::dvec3(0, 0, 1));
    std::vector<glm::dvec3> rays;
    for (int i = 0; i < 12; ++i) rays.emplace_back(Uniform(random, -1, 1), Uniform(random, -1, 1), 1.0);
    // A map that fits, more or less.
    const auto [low, high] = ReachOf({matrix, size}, rays);
    const glm::dvec2 sides(size.width, size.height);
    const glm::dvec2 scale = sides / (high - low) * Uniform(random, 0.6, 1.15);
    const glm::dvec2 shift = 0.5 * sides - scale * 0.5 * (low + high) +
                             sides * glm::dvec2(Uniform(random, -0.4, 0.4), Uniform(random, -0.4, 0.4));
    matrix = glm::dmat3(glm::dvec3(scale.x, 0, 0), glm::dvec3(0, scale.y, 0), glm::dvec3(shift, 1)) * matrix;
    const ShadowProjection previous{WithUnitAxis(matrix), size};
    const std::optional<ShadowProjection> held = RescaleToHold(previous, size, rays, 0.02);
    ASSERT_TRUE(held.has_value());
    ASSERT_EQ(held->size, size);
    const auto [held_low, held_high] = ReachOf(*held, rays);
    const auto [old_low, old_high] = ReachOf(previous, rays);
    for (int axis = 0; axis < 2; ++axis) {
      ASSERT_GE(held_low[axis], -1e-9) << trial;
      ASSERT_LE(held_high[axis], sides[axis] + 1e-9) << trial;
      const double grown = (held_high[axis] - held_low[axis]) / (old_high[axis] - old_low[axis]);
      const double move = held_low[axis] - old_low[axis];
      if (old_low[axis] >= 0.0 && old_high[axis] <= sides[axis]) {
        ASSERT_NEAR(move, 0.0, 1e-9) << trial;
        ++stayed;
      } else if (old_high[axis] - old_low[axis] <= sides[axis] - 1.0) {
        ASSERT_NEAR(grown, 1.0, 1e-9) << trial;
        ASSERT_NEAR(move, std::round(move), 1e-9) << trial;
        ++shifted;
      } else if (std::abs(grown - 1.0) > 1e-9) {
        const double steps = std::log(grown) / std::log(kScaleStep);
        ASSERT_NEAR(steps, std::round(steps), 1e-6) << trial;
        // Texels no more than a step larger than needed.
        ASSERT_GT((held_high[axis] - held_low[axis]) * kScaleStep, 0.96 * sides[axis] - 1e-9) << trial;
        ++scaled;
      }
    }
  }
  EXPECT_GT(stayed, 500);
  EXPECT_GT(shifted, 500);
  EXPECT_GT(scaled, 500);
}

TEST(RescaleToHold, KeepsTheMapsPartOfSpaceWhereItsSizeAloneChanges) {
  const ShadowProjection previous{WithUnitAxis(glm::dmat3({3, 1, 0.1}, {-1, 2, 0.0}, {40, 50, 1.0})),
                                  {100, 100}};
  const std::vector<glm::dvec3> rays = {{0, 0, 1}, {3, 1, 1}};
  const std::optional<ShadowProjection> held = RescaleToHold(previous, {300, 50}, rays, 0.02);
  ASSERT_TRUE(held.has_value());
  EXPECT_EQ(held->size, (MapSize{300, 50}));
  for (const glm::dvec3& r : rays) {
    const glm::dvec2 expected = glm::dvec2(previous.TexelFromRay(r)) * glm::dvec2(3.0, 0.5);
    EXPECT_LT(glm::distance(glm::dvec2(held->TexelFromRay(r)), expected), 1e-9);
  }
}

TEST(FrameOptimizer, NamesTheFieldOfBadInput) {
  const auto expect = [](auto&& spoil, const std::string& beginning) {
    OwnedFrame frame =
        StandardFrame({MakeLight(PointLight{{4, -2, 12}}, 1), MakeLight(SpotLight{{0, 0, 9}}, 2)}, 16);
    spoil(frame.request);
    FrameOptimizer optimizer;
    FrameSummary summary;
    const absl::Status status = optimizer.Optimize(frame.request, Options(), Cancellation(), &summary);
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << beginning;
    EXPECT_THAT(std::string(status.message()), StartsWith(beginning));
  };
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double infinity = std::numeric_limits<double>::infinity();
  expect([&](FrameRequest& r) { r.camera.view_from_world[1][2] = nan; }, "camera.view.m[6]: nan");
  expect([&](FrameRequest& r) { r.camera.clip_from_view[0][0] = infinity; }, "camera.projection.m[0]: inf");
  expect([&](FrameRequest& r) { r.camera.clip_from_view = glm::dmat4(0.0); }, "camera.projection: singular");
  expect([&](FrameRequest& r) { r.camera.view_from_world[0] = r.camera.view_from_world[1]; },
         "camera.view: singular");
  expect([&](FrameRequest& r) { r.depth.width = 0; }, "depth: size 0x16");
  expect([&](FrameRequest& r) { r.bits->height = 15; }, "shadow_bits: size 16x15");
  expect([&](FrameRequest& r) { r.lights.clear(); }, "lights: empty");
  expect([&](FrameRequest& r) { r.lights.resize(33, r.lights[0]); }, "lights: 33");
  expect([&](FrameRequest& r) { r.lights[1].id = 1; }, "lights[1].id: 1 is not unique");
  expect([&](FrameRequest& r) { r.lights[0].map_size.width = 0; }, "lights[0].shadow_map.width: 0");
  expect([&](FrameRequest& r) { r.lights[0].map_size.height = 1 << 20; },
         "lights[0].shadow_map.height: 1048576");
  expect(
      [&](FrameRequest& r) {
        r.lights[0].light = PointLight{{0, nan, 0}};
      },
      "lights[0].point.position: (0, nan, 0)");
  expect(
      [&](FrameRequest& r) {
        r.lights[1].light = SpotLight{{0, 0, 9}, {0, 0, 0}, 0.5};
      },
      "lights[1].spot.direction: zero-length vector");
  expect(
      [&](FrameRequest& r) {
        r.lights[1].light = SpotLight{{0, 0, 9}, {0, 0, -1}, 1.6};
      },
      "lights[1].spot.outer_half_angle: 1.6");
  expect(
      [&](FrameRequest& r) {
        r.lights[1].light = DirectionalLight{{0, infinity, 0}};
      },
      "lights[1].directional.direction: (0, inf, 0)");
  expect([&](FrameRequest& r) { r.lights[0].previous_clip_from_world = glm::dmat4(nan); },
         "lights[0].previous_world_to_shadow_clip.m[0]: nan");
  expect([&](FrameRequest& r) { r.screen = {-1, 5}; }, "screen.width: -1");
  expect(
      [&](FrameRequest& r) {
        r.ws_scene_bounds = Bounds{{0, 0, 1}, {1, 1, 0}};
      },
      "scene_bounds: min 1 is above");
}

TEST(FrameOptimizer, StopsWhenCancelled) {
  OwnedFrame frame = StandardFrame({MakeLight(PointLight{{4, -2, 12}})}, 16);
  FrameOptimizer optimizer;
  FrameSummary summary;
  Cancellation cancelled;
  cancelled.Cancel();
  EXPECT_EQ(optimizer.Optimize(frame.request, Options(), cancelled, &summary).code(),
            absl::StatusCode::kCancelled);
  Cancellation late(Cancellation::Clock::now() - std::chrono::seconds(1));
  EXPECT_EQ(optimizer.Optimize(frame.request, Options(), late, &summary).code(),
            absl::StatusCode::kDeadlineExceeded);
}

TEST(FrameSummary, ReportsEveryLight) {
  OwnedFrame frame =
      StandardFrame({MakeLight(PointLight{{4, -2, 12}}, 17), MakeLight(DirectionalLight{{0, 0, -1}}, 23)});
  const FrameSummary summary = Optimize(frame.request);
  EXPECT_THAT(summary.BriefReport(), HasSubstr("2 lights"));
  EXPECT_THAT(summary.FullReport(), HasSubstr("17"));
  EXPECT_THAT(summary.FullReport(), HasSubstr("23"));
}

}  // namespace
}  // namespace shadowfit
