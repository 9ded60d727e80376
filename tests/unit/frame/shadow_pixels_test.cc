#include "core/frame/shadow_pixels.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <vector>

#include "core/frame/frame_sampler.h"
#include "tests/support/analytic_scene.h"

namespace shadowfit {
namespace {

using testing::OwnedFrame;

constexpr int kWidth = 61;
constexpr int kHeight = 47;

/// A frame with one light, and as the definitions read, what a sampler says of its shadow.
struct Sampled {
  OwnedFrame frame;
  Camera camera;
  RaySpace ray_space;
  FrameSampler sampler;

  Sampled(std::mt19937& random, const CameraMatrices& matrices)
      : frame(testing::Draw(testing::RandomSpheres(random, 9), matrices, kWidth, kHeight,
                            {testing::RandomLight(random, 0)})),
        camera(*Camera::Create(matrices)),
        ray_space(*RaySpace::Create(frame.request.lights[0].light)) {
    FrameExtent extent;
    std::vector<LightSamples> samples;
    sampler.Sample(camera, frame.request.depth, frame.request.bits, {&ray_space, 1}, {kWidth, kHeight},
                   &extent, &samples);
  }

  /// The rays of all pixels in shadow of every row_step-th row.
  std::vector<glm::dvec3> Shadow(int first_row, int row_step) const {
    std::vector<glm::dvec3> rays;
    for (int y = first_row; y < kHeight; y += row_step) {
      for (int x = 0; x < kWidth; ++x) {
        if ((frame.request.bits->Row(y)[x] & 1) == 0) continue;
        const auto depth = static_cast<double>(frame.request.depth.Row(y)[x]);
        const glm::dvec4 ws =
            camera.WsFromNdc({(x + 0.5) * 2.0 / kWidth - 1.0, (y + 0.5) * 2.0 / kHeight - 1.0,
                              NdcFromWindowDepth(camera.clip_depth(), depth)});
        rays.push_back(ray_space.RayFromPoint(glm::dvec3(ws) / ws.w));
      }
    }
    return rays;
  }

  /// About one of the shadow's rays, and so wide that it holds some of the others.
  ShadowProjection AnyMap(std::mt19937& random, const std::vector<glm::dvec3>& shadow) const {
    const glm::dvec3& ray = shadow[random() % shadow.size()];
    const glm::dvec3 axis = ray_space.is_directional() ? glm::dvec3(0, 0, 1) : glm::normalize(ray);
    const glm::dvec3 b1 = glm::normalize(glm::cross(axis, glm::dvec3(0.3, 0.8, 0.5)));
    const glm::dvec3 b2 = glm::cross(axis, b1);
    const double extent = ray_space.is_directional() ? 3.0 : 0.2;
    const glm::dmat3 plane_from_ray = glm::transpose(glm::dmat3(b1, b2, axis));
    const glm::dvec3 middle = plane_from_ray * ray;
    const double scale = 100.0 / extent;
    const glm::dmat3 texel_from_plane(
        glm::dvec3(scale, 0, 0), glm::dvec3(0, scale, 0),
        glm::dvec3(60.0 - scale * middle.x / middle.z, 40.0 - scale * middle.y / middle.z, 1.0));
    return {texel_from_plane * plane_from_ray, {120, 80}};
  }
};

CameraMatrices AnyCamera(std::mt19937& random, int trial) {
  CameraMatrices matrices = testing::WalkThroughCamera(random, static_cast<ClipDepth>(trial % 3));
  // Every fourth looks down in parallel.
  if (trial % 4 == 3) {
    matrices.clip_depth = ClipDepth::kNegativeOneToOne;
    matrices.view_from_world = glm::lookAtRH(glm::dvec3(3, -9, 14), glm::dvec3(0), glm::dvec3(0, 0, 1));
    matrices.clip_from_view = glm::orthoRH_NO(-9.0, 9.0, -7.0, 7.0, 1.0, 60.0);
  }
  return matrices;
}

TEST(ShadowOutside, IsThatOfEveryPixelInShadowThatNoMapHolds) {
  std::mt19937 random(5);
  int partial = 0;
  for (int trial = 0; trial < 200; ++trial) {
    const Sampled sampled(random, AnyCamera(random, trial));
    const std::vector<glm::dvec3> shadow = sampled.Shadow(0, 1);
    if (shadow.empty()) continue;
    std::vector<ShadowProjection> maps;
    for (int k = 0; k < 1 + trial % 3; ++k) maps.push_back(sampled.AnyMap(random, shadow));
    const auto outside = std::count_if(shadow.begin(), shadow.end(), [&](const glm::dvec3& ray) {
      return std::none_of(maps.begin(), maps.end(),
                          [&](const ShadowProjection& map) { return map.Holds(ray); });
    });
    // At a sphere's rim a sampled normal may face away from the light: what is dark in any case is not lost.
    const double found = sampled.sampler.ShadowOutside(sampled.camera, sampled.ray_space, 0, maps);
    EXPECT_LE(found, static_cast<double>(outside)) << "trial " << trial;
    EXPECT_GE(found, 0.9 * static_cast<double>(outside) - 10.0) << "trial " << trial;
    partial += outside > 0 && outside < static_cast<std::ptrdiff_t>(shadow.size());
  }
  EXPECT_GT(partial, 60);
}

TEST(ShadowPlaces, AreThoseOfWhatOneMapHoldsAndNoOther) {
  std::mt19937 random(6);
  size_t compared = 0;
  for (int trial = 0; trial < 200; ++trial) {
    const Sampled sampled(random, AnyCamera(random, trial));
    const std::vector<glm::dvec3> shadow = sampled.Shadow(kShadowRowStep / 2, kShadowRowStep);
    if (shadow.empty()) continue;
    const ShadowProjection map = sampled.AnyMap(random, shadow);
    std::vector<ShadowProjection> others;
    for (int k = 0; k < trial % 3; ++k) others.push_back(sampled.AnyMap(random, shadow));
    std::vector<glm::dvec2> expected;
    for (const glm::dvec3& ray : shadow) {
      const auto holds = [&](const ShadowProjection& other) { return other.Holds(ray); };
      if (!map.Holds(ray) || std::any_of(others.begin(), others.end(), holds)) continue;
      expected.push_back(glm::dvec2(map.TexelFromRay(ray)) / glm::dvec2(map.size.width, map.size.height));
    }
    ShadowPlaces places;
    EXPECT_EQ(sampled.sampler.PlacesOfShadow(sampled.camera, sampled.ray_space, 0, map, others, &places),
              static_cast<double>(kShadowRowStep));
    ASSERT_EQ(places.x.size(), expected.size()) << "trial " << trial;
    ASSERT_EQ(places.y.size(), expected.size());
    for (size_t i = 0; i < expected.size(); ++i) {
      EXPECT_NEAR(static_cast<double>(places.x[i]), expected[i].x, 1e-5);
      EXPECT_NEAR(static_cast<double>(places.y[i]), expected[i].y, 1e-5);
    }
    compared += expected.size();
  }
  EXPECT_GT(compared, 1000U);
}

}  // namespace
}  // namespace shadowfit
