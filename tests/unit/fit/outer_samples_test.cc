#include "core/fit/outer_samples.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "core/fit/ray_hull.h"
#include "core/math/convex_hull.h"
#include "tests/support/analytic_scene.h"

namespace shadowfit {
namespace {

using testing::Uniform;

constexpr double kRound = 6.283;

/// Rays in a cone of up to 70 degrees, in clusters or all over it, with footprints of all sizes; some in
/// shadow.
LightSamples RandomSamples(std::mt19937& random, bool directional) {
  LightSamples samples;
  const int count = 3 + static_cast<int>(random() % 1500);
  const double reach = std::exp(Uniform(random, -4.0, 1.0));
  const double size = reach * std::exp(Uniform(random, -7.0, -1.0));
  const double in_shadow = Uniform(random, 0.0, 1.0);
  const bool on_a_line = random() % 16 == 0;
  const auto step = [&] {
    return size * glm::dvec3(Uniform(random, -1, 1), Uniform(random, -1, 1),
                             directional ? 0.0 : Uniform(random, -1, 1));
  };
  for (int i = 0; i < count; ++i) {
    const double angle = on_a_line ? 0.0 : Uniform(random, 0.0, kRound);
    const double radius = reach * std::sqrt(Uniform(random, 0.0, 1.0));
    const glm::dvec3 ray(radius * std::cos(angle), radius * std::sin(angle), 1.0);
    samples.hull_rays.push_back(directional ? ray : Uniform(random, 0.5, 5.0) * ray);
    samples.hull_rays_dx1.push_back(step());
    samples.hull_rays_dx2.push_back(step());
    samples.hull_in_shadow.push_back(Uniform(random, 0.0, 1.0) < in_shadow ? 1 : 0);
  }
  return samples;
}

/// The extent of the samples, or of their footprints, along a direction of the plane z = 1.
double Extent(const LightSamples& samples, const std::vector<int32_t>& chosen, HullOf hull_of,
              const glm::dvec2& direction) {
  double most = -HUGE_VAL;
  const auto add = [&](const glm::dvec3& r) {
    if (r.z > 0.0) most = std::max(most, glm::dot(direction, glm::dvec2(r) / r.z));
  };
  for (const int32_t index : chosen) {
    const auto i = static_cast<size_t>(index);
    add(samples.hull_rays[i]);
    for (int corner = 0; hull_of == HullOf::kShadow && corner < 4; ++corner) {
      add(samples.FootprintCorner(i, corner));
    }
  }
  return most;
}

TEST(OuterSamples, HaveTheHullOfAll) {
  std::mt19937 random(1);
  size_t all = 0;
  size_t outer = 0;
  for (int trial = 0; trial < 2000; ++trial) {
    const bool directional = random() % 2 == 0;
    const RaySpace space = directional ? *RaySpace::Create(DirectionalLight{{0, 0, 1}})
                                       : *RaySpace::Create(PointLight{{0, 0, 0}});
    const LightSamples samples = RandomSamples(random, directional);
    for (const HullOf hull_of : {HullOf::kSamples, HullOf::kShadow}) {
      const std::vector<int32_t> chosen = HullSamples(samples, hull_of);
      const std::vector<int32_t> found = OuterSamples(samples, space, hull_of);
      all += chosen.size();
      outer += found.size();
      for (int k = 0; k < 64; ++k) {
        const double angle = kRound * k / 64;
        const glm::dvec2 direction(std::cos(angle), std::sin(angle));
        const double expected = Extent(samples, chosen, hull_of, direction);
        ASSERT_NEAR(Extent(samples, found, hull_of, direction), expected, 1e-9 * std::abs(expected))
            << "trial " << trial;
      }
    }
  }
  EXPECT_LT(outer, all / 3);
}

TEST(HullSamples, AreThoseInShadowOrAllWhereNoneIs) {
  LightSamples samples;
  samples.hull_rays = {{0, 0, 1}, {1, 0, 1}, {0, 1, 1}};
  samples.hull_in_shadow = {0, 1, 1};
  EXPECT_EQ(HullSamples(samples, HullOf::kShadow), (std::vector<int32_t>{1, 2}));
  EXPECT_EQ(HullSamples(samples, HullOf::kSamples), (std::vector<int32_t>{0, 1, 2}));
  samples.hull_in_shadow = {0, 0, 0};
  EXPECT_EQ(HullSamples(samples, HullOf::kShadow), (std::vector<int32_t>{0, 1, 2}));
}

}  // namespace
}  // namespace shadowfit
