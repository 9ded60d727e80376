#include "core/fit/swim.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "core/fit/frame_optimizer.h"
#include "core/fit/rescale_previous.h"
#include "core/math/ray_space.h"
#include "tests/support/analytic_scene.h"

namespace shadowfit {
namespace {

using testing::Uniform;

TEST(DistanceToLattice, EqualsBruteForce) {
  std::mt19937 random(3);
  for (int i = 0; i < 2000; ++i) {
    glm::dmat2 basis;
    for (int k = 0; k < 4; ++k) basis[k / 2][k % 2] = Uniform(random, -1.0, 1.0);
    if (std::abs(glm::determinant(basis)) < 0.05) continue;
    const glm::dvec2 e(Uniform(random, -30.0, 30.0), Uniform(random, -30.0, 30.0));
    double least = 1e300;
    for (int x = -40; x <= 40; ++x) {
      for (int y = -40; y <= 40; ++y) {
        least = std::min(least, glm::length(basis * (e - glm::round(e) - glm::dvec2(x, y))));
      }
    }
    ASSERT_NEAR(DistanceToLattice(basis, e), least, 1e-12) << i;
  }
}

/// A plane under a camera and a light, whose screen positions and rays are known in closed form.
struct Ground {
  glm::dmat4 clip_from_world;
  glm::dmat4 world_from_clip;
  RaySpace space;
  double screen;

  glm::dvec3 PointAt(const glm::dvec2& pixel) const {
    const glm::dvec2 ndc = pixel * (2.0 / screen) - 1.0;
    const glm::dvec4 a = world_from_clip * glm::dvec4(ndc, -1.0, 1.0);
    const glm::dvec4 b = world_from_clip * glm::dvec4(ndc, 1.0, 1.0);
    const glm::dvec3 near = glm::dvec3(a) / a.w;
    const glm::dvec3 far = glm::dvec3(b) / b.w;
    return near + (far - near) * (near.z / (near.z - far.z));
  }
  glm::dvec3 RayAt(const glm::dvec2& pixel) const { return space.RayFromPoint(PointAt(pixel)); }
  glm::dvec2 PixelOf(const glm::dvec3& ws) const {
    const glm::dvec4 clip = clip_from_world * glm::dvec4(ws, 1.0);
    return (glm::dvec2(clip) / clip.w + 1.0) * (0.5 * screen);
  }
  /// Where a ray meets the ground, on the screen.
  glm::dvec2 PixelOfRay(const glm::dvec3& ray) const {
    const RaySpace::WsRay ws = space.WorldRay(ray);
    return PixelOf(ws.origin - ws.direction * (ws.origin.z / ws.direction.z));
  }
};

class Swim : public ::testing::TestWithParam<int> {
 protected:
  Swim() {
    const glm::dmat4 view = glm::lookAtRH(glm::dvec3(0, -6, 4), glm::dvec3(0.3, 0.5, 0), glm::dvec3(0, 0, 1));
    ground_.clip_from_world = glm::perspectiveRH_NO(0.7, 1.0, 0.5, 60.0) * view;
    ground_.world_from_clip = glm::inverse(ground_.clip_from_world);
    const Light light =
        GetParam() == 0 ? Light(PointLight{{3, 2, 7}}) : Light(DirectionalLight{{-0.4, 0.5, -1}});
    ground_.space = *RaySpace::Create(light);
    ground_.screen = 700.0;
    for (int y = 180; y < 560; y += 23) {
      for (int x = 120; x < 600; x += 29) {
        const glm::dvec2 pixel(x + Uniform(random_, 0, 1), y + Uniform(random_, 0, 1));
        pixels_.push_back(pixel);
        // The derivatives that a sampler finds, by finite differences.
        constexpr double kStep = 1e-4;
        const auto along = [&](const glm::dvec2& step) {
          return (ground_.RayAt(pixel + step) - ground_.RayAt(pixel - step)) / (2.0 * kStep);
        };
        samples_.boundary.Add(ground_.RayAt(pixel), along({kStep, 0}), along({0, kStep}), 1.0, {1, 0},
                              Uniform(random_, 0.5, 2.0));
      }
    }
  }

  /// A map of the ground's middle with some warp.
  ShadowProjection RandomMap(double turn) {
    const glm::dvec3 middle = ground_.RayAt({350, 350});
    glm::dvec3 axis = glm::normalize(middle + glm::length(middle) * 0.1 * testing::UniformDirection(random_));
    if (GetParam() == 1) axis = glm::normalize(glm::dvec3(Uniform(random_, -0.01, 0.01), 0.008, 1.0));
    const glm::dvec3 b1 = glm::normalize(glm::cross(axis, glm::dvec3(0.3, std::cos(turn), std::sin(turn))));
    const glm::dvec3 b2 = glm::cross(axis, b1);
    ShadowProjection map{glm::transpose(glm::dmat3(b1, b2, axis)), {1, 1}};
    std::vector<glm::dvec3> rays;
    for (size_t i = 0; i < samples_.boundary.size(); ++i) rays.push_back(samples_.boundary.Ray(i));
    return *RescaleToHold(map, {300, 260}, rays, 0.02);
  }

  std::mt19937 random_{11};
  Ground ground_;
  std::vector<glm::dvec2> pixels_;
  LightSamples samples_;
};

TEST_P(Swim, EqualsTheMotionOfTexelCentresFoundOneByOne) {
  for (int trial = 0; trial < 6; ++trial) {
    const ShadowProjection before = RandomMap(0.1 * trial);
    const ShadowProjection after = RandomMap(0.1 * trial + Uniform(random_, -0.05, 0.05));
    double sum = 0.0;
    double weights = 0.0;
    for (size_t i = 0; i < pixels_.size(); ++i) {
      const glm::dvec3 ray = ground_.RayAt(pixels_[i]);
      if (!before.Holds(ray) || !after.Holds(ray)) continue;
      const glm::dvec2 center = glm::floor(glm::dvec2(before.TexelFromRay(ray))) + 0.5;
      const glm::dvec2 old_pixel =
          ground_.PixelOfRay(glm::inverse(before.texel_from_ray) * glm::dvec3(center, 1.0));
      // Every new centre around.
      const glm::dvec2 near = glm::floor(glm::dvec2(after.TexelFromRay(ray))) + 0.5;
      double least = 1e300;
      for (int x = -6; x <= 6; ++x) {
        for (int y = -6; y <= 6; ++y) {
          const glm::dvec3 there =
              glm::inverse(after.texel_from_ray) * glm::dvec3(near + glm::dvec2(x, y), 1.0);
          least = std::min(least, glm::distance(old_pixel, ground_.PixelOfRay(there)));
        }
      }
      sum += samples_.boundary.length[i] * least;
      weights += samples_.boundary.length[i];
    }
    ASSERT_GT(weights, 0.0);
    const std::optional<double> swim = MeanSwim(samples_, before, after);
    ASSERT_TRUE(swim.has_value());
    // J is the texel's only at its middle.
    EXPECT_NEAR(*swim, sum / weights, 0.01 * sum / weights) << trial;
    EXPECT_GT(*swim, 0.05);
  }
}

TEST_P(Swim, IsNothingForShiftsByWholeTexels) {
  const ShadowProjection before = RandomMap(0.4);
  EXPECT_NEAR(*MeanSwim(samples_, before, before), 0.0, 1e-9);
  const glm::dmat3 shift(glm::dvec3(1, 0, 0), glm::dvec3(0, 1, 0), glm::dvec3(3, -2, 1));
  EXPECT_NEAR(*MeanSwim(samples_, before, {shift * before.texel_from_ray, before.size}), 0.0, 1e-9);
  const glm::dmat3 half(glm::dvec3(1, 0, 0), glm::dvec3(0, 1, 0), glm::dvec3(0.5, 0.5, 1));
  EXPECT_GT(*MeanSwim(samples_, before, {half * before.texel_from_ray, before.size}), 0.1);
}

TEST_P(Swim, NeedsSamplesInBothMaps) {
  const ShadowProjection map = RandomMap(0.4);
  EXPECT_FALSE(MeanSwim(LightSamples(), map, map).has_value());
  const glm::dmat3 away(glm::dvec3(1, 0, 0), glm::dvec3(0, 1, 0), glm::dvec3(1000, 0, 1));
  EXPECT_FALSE(MeanSwim(samples_, {away * map.texel_from_ray, map.size}, map).has_value());
}

INSTANTIATE_TEST_SUITE_P(Lights, Swim, ::testing::Values(0, 1));

}  // namespace
}  // namespace shadowfit
