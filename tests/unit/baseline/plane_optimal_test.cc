#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "core/baseline/baselines.h"
#include "core/baseline/dominant_plane.h"
#include "tests/unit/baseline/random_problem.h"

namespace shadowfit {
namespace {

using testing::OwnedProblem;
using testing::ProblemSetup;
using testing::RandomSetup;

/// du_i/dx_j of boundary sample k, texels per pixel (math.md's Jacobian).
glm::dmat2 Jacobian(const LightFit& fit, const BoundarySamples& samples, size_t k) {
  const glm::dmat3& h = fit.projection.texel_from_ray;
  const glm::dvec3 u = fit.projection.TexelFromRay(samples.Ray(k));
  const glm::dvec3 d1 = h * samples.RayDx1(k);
  const glm::dvec3 d2 = h * samples.RayDx2(k);
  return {(glm::dvec2(d1) - glm::dvec2(u) * d1.z) / u.z, (glm::dvec2(d2) - glm::dvec2(u) * d2.z) / u.z};
}

TEST(PlaneOptimal, OnAPlaneEveryTexelIsAsManyPixels) {
  std::mt19937_64 random(21);
  int tested = 0;
  for (int round = 0; round < 600; ++round) {
    ProblemSetup setup = RandomSetup(random);
    setup.discs.resize(1);  // The floor alone.
    const OwnedProblem owned(setup);
    const BoundarySamples& samples = owned.problem().samples->boundary;
    if (samples.size() < 8) continue;
    const LightFit fit = *MakeBaseline(Method::kPlaneOptimal)->Fit(owned.problem());
    if (fit.outcome == FitOutcome::kFallback) continue;
    ++tested;
    // Diagonal up to a mirrored u, and the same at every sample.
    const glm::dmat2 first = Jacobian(fit, samples, 0);
    for (size_t k = 0; k < samples.size(); ++k) {
      const glm::dmat2 jacobian = Jacobian(fit, samples, k);
      ASSERT_NEAR(jacobian[0][0] / first[0][0], 1.0, 1e-4) << "round " << round;
      ASSERT_NEAR(jacobian[1][1] / first[1][1], 1.0, 1e-4) << "round " << round;
      ASSERT_NEAR(jacobian[0][1] / first[1][1], 0.0, 1e-4) << "round " << round;
      ASSERT_NEAR(jacobian[1][0] / first[0][0], 0.0, 1e-4) << "round " << round;
    }
    // And all of the plane's samples, being on the screen, are in the map.
    for (const glm::dvec3& ray : owned.problem().samples->hull_rays) {
      const glm::dvec3 u = fit.projection.TexelFromRay(ray);
      ASSERT_TRUE(u.x >= -1e-6 && u.x <= setup.map_size.width + 1e-6 && u.y >= -1e-6 &&
                  u.y <= setup.map_size.height + 1e-6)
          << "round " << round << ": " << u.x << ", " << u.y;
    }
  }
  EXPECT_GT(tested, 200);
}

TEST(PlaneOptimal, AFilledScreenGetsItsOwnPixels) {
  // The floor fills the screen: a map of the screen's size has one texel a pixel, but for the
  // border of half a texel.
  ProblemSetup setup;
  setup.ws_eye = {0, 0, 8};
  setup.ws_target = {4, 1, 0};
  setup.fov_y = 0.6;
  setup.pixels_x = 64;
  setup.pixels_y = 48;
  setup.map_size = {64, 48};
  setup.light = PointLight{{6, 5, 9}};
  const OwnedProblem owned(setup);
  const LightFit fit = *MakeBaseline(Method::kPlaneOptimal)->Fit(owned.problem());
  ASSERT_EQ(fit.outcome, FitOutcome::kFitted) << fit.note;
  const BoundarySamples& samples = owned.problem().samples->boundary;
  ASSERT_EQ(samples.size(), 64U * 48U);
  for (size_t k = 0; k < samples.size(); k += 100) {
    const glm::dmat2 jacobian = Jacobian(fit, samples, k);
    EXPECT_NEAR(std::abs(jacobian[0][0]), 63.0 / 64.0, 1e-5);
    EXPECT_NEAR(std::abs(jacobian[1][1]), 47.0 / 48.0, 1e-5);
  }
}

TEST(PlaneOptimal, FallsBackToFocusedWhereThereIsNoUsablePlane) {
  struct Case {
    const char* name;
    ProblemSetup setup;
  };
  std::vector<Case> cases(3);
  cases[0].name = "the light lies in the plane";
  cases[0].setup.light = DirectionalLight{{1.0, 0.0, -1e-5}};
  cases[1].name = "a row of samples is no plane";
  cases[1].setup.pixels_y = 1;
  cases[1].setup.ws_target = {1.0, 0.0, 0.0};
  cases[1].setup.light = DirectionalLight{{0.2, 0.1, -1.0}};
  cases[2].name = "nothing visible";
  cases[2].setup.discs.clear();
  cases[2].setup.scene_bounds = false;
  for (const Case& test_case : cases) {
    const OwnedProblem owned(test_case.setup);
    const LightFit fit = *MakeBaseline(Method::kPlaneOptimal)->Fit(owned.problem());
    EXPECT_EQ(fit.outcome, FitOutcome::kFallback) << test_case.name;
    EXPECT_EQ(fit.projection.texel_from_ray,
              MakeBaseline(Method::kFocused)->Fit(owned.problem())->projection.texel_from_ray)
        << test_case.name;
  }
}

TEST(PlaneOptimal, FallsBackWhereAReceiversRayMeetsThePlaneBehindTheEye) {
  // A low sun ahead and a wall beside the view: the wall's shadow would fall behind the eye.
  ProblemSetup setup;
  setup.light = DirectionalLight{{-1.0, 0.0, -0.15}};
  setup.ws_target = {10.0, 0.0, 1.0};
  setup.discs.push_back({{4.0, -3.0, 1.5}, glm::normalize(glm::dvec3(0.3, 1.0, 0.0)), 2.5});
  const OwnedProblem owned(setup);
  const LightFit fit = *MakeBaseline(Method::kPlaneOptimal)->Fit(owned.problem());
  EXPECT_EQ(fit.outcome, FitOutcome::kFallback);
  EXPECT_NE(std::string(fit.note).find("behind the eye"), std::string::npos) << fit.note;
}

TEST(DominantPlane, IsFoundAmongClutter) {
  std::mt19937_64 random(31);
  std::normal_distribution<double> normal;
  for (int round = 0; round < 100; ++round) {
    const glm::dvec3 n = glm::normalize(glm::dvec3(normal(random), normal(random), normal(random)));
    const glm::dvec3 x = glm::normalize(glm::cross(n, glm::dvec3(0.3, -0.5, 0.8)));
    const glm::dvec3 y = glm::cross(n, x);
    const glm::dvec3 center(100.0 * normal(random), 100.0 * normal(random), 100.0 * normal(random));
    std::vector<PlaneSample> samples;
    for (int i = 0; i < 400; ++i) {
      const glm::dvec3 p = i % 2 == 0
                               ? 5.0 * (normal(random) * x + normal(random) * y) + 1e-3 * normal(random) * n
                               : 5.0 * glm::dvec3(normal(random), normal(random), normal(random));
      samples.push_back({center + p, 1.0, 0.02});
    }
    const std::optional<glm::dvec4> plane = DominantPlane(samples);
    ASSERT_TRUE(plane);
    EXPECT_NEAR(std::abs(glm::dot(glm::dvec3(*plane), n)), 1.0, 1e-6);
    EXPECT_NEAR(glm::dot(glm::dvec3(*plane), center) + plane->w, 0.0, 2e-3);
  }
}

TEST(DominantPlane, PointsAndLinesAreNone) {
  EXPECT_FALSE(DominantPlane({}));
  std::vector<PlaneSample> samples(2, {{1, 2, 3}, 1.0, 0.1});
  EXPECT_FALSE(DominantPlane(samples));
  samples.resize(50, samples[0]);
  EXPECT_FALSE(DominantPlane(samples)) << "one point, many times";
  for (size_t i = 0; i < samples.size(); ++i) samples[i].ws_position = glm::dvec3(1, 2, 3) * double(i);
  EXPECT_FALSE(DominantPlane(samples)) << "a line";
}

}  // namespace
}  // namespace shadowfit
