#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>

#include "core/baseline/baselines.h"
#include "core/baseline/light_frustum.h"
#include "tests/unit/baseline/random_problem.h"

namespace shadowfit {
namespace {

using testing::OwnedProblem;
using testing::ProblemSetup;
using testing::RandomSetup;

TEST(Focused, HoldsWhateverIsInTheViewAndInTheLightsFrustum) {
  std::mt19937_64 random(11);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  int inside = 0;
  for (int round = 0; round < 400; ++round) {
    const OwnedProblem owned(RandomSetup(random));
    const LightProblem& problem = owned.problem();
    const LightFrustum frustum = NormalFrustum(problem);
    const LightFit fit = *MakeBaseline(Method::kFocused)->Fit(problem);
    const double half = 0.5 * frustum.extents.width;
    for (int i = 0; i < 50; ++i) {
      const double share = 0.5 + 0.5 * unit(random);
      const glm::dvec4 p = owned.camera().WsFromNdc(
          {unit(random), unit(random),
           problem.nearest_ndc_depth + share * (problem.farthest_ndc_depth - problem.nearest_ndc_depth)});
      const glm::dvec3 ray = owned.ray_space().RayFromPoint(glm::dvec3(p) / p.w);
      if (!(glm::dot(frustum.plane.w, ray) > 0.0)) continue;
      const glm::dvec2 v = glm::abs(frustum.plane.Project(ray) - frustum.extents.center);
      if (std::max(v.x, v.y) > half) continue;
      ++inside;
      const glm::dvec3 u = fit.projection.TexelFromRay(ray);
      ASSERT_GT(u.z, 0.0);
      ASSERT_GE(u.x, -1e-6 * fit.projection.size.width) << "round " << round;
      ASSERT_LE(u.x, fit.projection.size.width * (1.0 + 1e-6)) << "round " << round;
      ASSERT_GE(u.y, -1e-6 * fit.projection.size.height) << "round " << round;
      ASSERT_LE(u.y, fit.projection.size.height * (1.0 + 1e-6)) << "round " << round;
    }
  }
  EXPECT_GT(inside, 5000);
}

// Same image plane, smaller rectangle: the texels of a map are spent on no more than Normal's are.
TEST(Focused, NeverHasLargerTexelsThanNormal) {
  std::mt19937_64 random(12);
  double smallest_ratio = HUGE_VAL;
  double largest_ratio = 0.0;
  for (int round = 0; round < 1000; ++round) {
    const OwnedProblem owned(RandomSetup(random));
    const LightFit normal = *MakeBaseline(Method::kNormal)->Fit(owned.problem());
    const LightFit focused = *MakeBaseline(Method::kFocused)->Fit(owned.problem());
    ASSERT_NEAR(glm::distance(normal.projection.Axis(), focused.projection.Axis()), 0.0, 1e-12);
    // Texels per area of the image plane: the determinant, for a common unit h3.
    const double ratio = glm::determinant(focused.projection.texel_from_ray) /
                         glm::determinant(normal.projection.texel_from_ray);
    smallest_ratio = std::min(smallest_ratio, ratio);
    largest_ratio = std::max(largest_ratio, ratio);
  }
  EXPECT_GT(smallest_ratio, 1.0 - 1e-6);
  EXPECT_GT(largest_ratio, 10.0) << "and the view cuts it down";
}

TEST(Focused, OverheadSunFitsTheTrapezoidOfTheView) {
  // A level camera: the view slice, seen from above, is the trapezoid between its near and far width.
  ProblemSetup setup;
  setup.ws_target = setup.ws_eye + glm::dvec3(1, 0, 0);
  setup.map_size = {1000, 500};
  setup.discs = {{{0, 0, 0}, {0, 0, 1}, 500.0}};
  OwnedProblem owned(setup);
  const auto ndc = [&](double depth) {
    const glm::dvec4 clip =
        owned.camera().clip_from_world() * glm::dvec4(setup.ws_eye + glm::dvec3(depth, 0, 0), 1.0);
    return clip.z / clip.w;
  };
  const double near_depth = 2.0;
  const double far_depth = 50.0;
  owned.problem().nearest_ndc_depth = ndc(near_depth);
  owned.problem().farthest_ndc_depth = ndc(far_depth);
  owned.samples().hull_rays.clear();
  const LightFit fit = *MakeBaseline(Method::kFocused)->Fit(owned.problem());
  EXPECT_EQ(fit.outcome, FitOutcome::kFitted);
  const double far_width = 2.0 * far_depth * std::tan(0.5 * setup.fov_y) * setup.aspect;
  const double near_width = far_width * near_depth / far_depth;
  const glm::dvec2 trapezoid[] = {{near_depth, -0.5 * near_width},
                                  {far_depth, -0.5 * far_width},
                                  {far_depth, 0.5 * far_width},
                                  {near_depth, 0.5 * near_width}};
  double area = HUGE_VAL;
  for (int step = 0; step < 9000; ++step) {
    const double angle = step * 0.01 * std::numbers::pi / 180.0;
    area = std::min(area, RectangleAlong(trapezoid, {std::cos(angle), std::sin(angle)}).Area());
  }
  const double texels = 999.0 * 499.0;  // Half a texel of border on every side.
  EXPECT_NEAR(glm::determinant(fit.projection.texel_from_ray), texels / area, 5e-4 * texels / area);
}

}  // namespace
}  // namespace shadowfit
