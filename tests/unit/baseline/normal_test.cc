#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>

#include "core/baseline/baselines.h"
#include "tests/unit/baseline/random_problem.h"

namespace shadowfit {
namespace {

using testing::OwnedProblem;
using testing::ProblemSetup;
using testing::RandomSetup;

LightFit FitNormal(const OwnedProblem& owned) { return *MakeBaseline(Method::kNormal)->Fit(owned.problem()); }

glm::dvec3 TexelOf(const LightFit& fit, const OwnedProblem& owned, const glm::dvec3& ws_point) {
  return fit.projection.TexelFromRay(owned.ray_space().RayFromPoint(ws_point));
}

TEST(Normal, PointAndDirectionalLightsSeeAllOfTheBoundsAndTouchTheRim) {
  std::mt19937_64 random(3);
  int tested = 0;
  while (tested < 200) {
    const ProblemSetup setup = RandomSetup(random);
    if (std::holds_alternative<SpotLight>(setup.light) || setup.map_size.width < 16 ||
        setup.map_size.height < 16) {
      continue;
    }
    const OwnedProblem owned(setup);
    const LightFit fit = FitNormal(owned);
    if (fit.outcome == FitOutcome::kFallback) continue;
    ++tested;
    glm::dvec2 low(HUGE_VAL);
    glm::dvec2 high(-HUGE_VAL);
    for (const glm::dvec3& corner : owned.problem().ws_scene_bounds.Corners()) {
      const glm::dvec3 u = TexelOf(fit, owned, corner);
      ASSERT_GT(u.z, 0.0);
      low = glm::min(low, glm::dvec2(u));
      high = glm::max(high, glm::dvec2(u));
    }
    const glm::dvec2 size(setup.map_size.width, setup.map_size.height);
    for (int i = 0; i < 2; ++i) {
      EXPECT_GE(low[i], 0.5 - 1e-9 * size[i]);
      EXPECT_LE(high[i], size[i] - 0.5 + 1e-9 * size[i]);
    }
    // A square: the wider of the two extents reaches the rim, half a texel before the end.
    const glm::dvec2 share = glm::max(0.5 * size - low, high - 0.5 * size) / (0.5 * size - 0.5);
    EXPECT_NEAR(std::max(share.x, share.y), 1.0, 1e-6);
  }
}

TEST(Normal, SpotIsTheSquareAroundItsCone) {
  ProblemSetup setup;
  const double half_angle = 0.5;
  setup.light = SpotLight{{2, 3, 10}, {1, 0, -2}, half_angle};
  setup.map_size = {100, 200};
  const OwnedProblem owned(setup);
  const LightFit fit = FitNormal(owned);
  EXPECT_EQ(fit.outcome, FitOutcome::kFitted);
  // Rays along the rim, in the spot's own ray coordinates, whose third axis is the cone's.
  glm::dvec2 low(HUGE_VAL);
  glm::dvec2 high(-HUGE_VAL);
  for (int degrees = 0; degrees < 360; ++degrees) {
    const double a = degrees * std::numbers::pi / 180.0;
    const glm::dvec3 rim(std::sin(half_angle) * std::cos(a), std::sin(half_angle) * std::sin(a),
                         std::cos(half_angle));
    const glm::dvec2 u(fit.projection.TexelFromRay(rim));
    low = glm::min(low, u);
    high = glm::max(high, u);
  }
  EXPECT_NEAR(low.x, 0.5, 0.02);
  EXPECT_NEAR(low.y, 0.5, 0.02);
  EXPECT_NEAR(high.x, 99.5, 0.02);
  EXPECT_NEAR(high.y, 199.5, 0.02);
}

TEST(Normal, WorldUpIsUpInTheMap) {
  for (const Light& light : {Light(PointLight{{-30, 0, 2}}), Light(SpotLight{{-30, 0, 2}, {1, 0, 0.1}}),
                             Light(DirectionalLight{{1, 0.3, -0.2}})}) {
    ProblemSetup setup;
    setup.light = light;
    setup.discs = {{{0, 0, 0}, {0, 0, 1}, 8.0}};
    const OwnedProblem owned(setup);
    const LightFit fit = FitNormal(owned);
    const glm::dvec3 below = TexelOf(fit, owned, {0, 0, 1});
    const glm::dvec3 above = TexelOf(fit, owned, {0, 0, 2});
    EXPECT_NEAR(below.x, above.x, 1e-6) << "index " << light.index();
    EXPECT_GT(above.y, below.y + 1.0) << "index " << light.index();
  }
}

TEST(Normal, AroundAnOverheadLightTheMapFollowsWorldY) {
  for (const Light& light : {Light(PointLight{{0, 0, 300}}), Light(DirectionalLight{{0, 0, -1}}),
                             Light(SpotLight{{0, 0, 300}, {0, 0, -1}})}) {
    ProblemSetup setup;
    setup.light = light;
    const OwnedProblem owned(setup);
    const LightFit fit = FitNormal(owned);
    const glm::dvec3 a = TexelOf(fit, owned, {0, 0, 0});
    const glm::dvec3 b = TexelOf(fit, owned, {0, 5, 0});
    EXPECT_NEAR(a.x, b.x, 1e-6) << "index " << light.index();
    EXPECT_GT(b.y, a.y + 1.0) << "index " << light.index();
  }
}

}  // namespace
}  // namespace shadowfit
