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

constexpr double kNear = 1.5;
constexpr double kFar = 60.0;

/// A level camera that looks along +x and sees depths from kNear to kFar, in bounds that limit nothing.
std::unique_ptr<OwnedProblem> LevelView(const Light& light) {
  ProblemSetup setup;
  setup.ws_eye = {3.0, -2.0, 1.7};
  setup.ws_target = setup.ws_eye + glm::dvec3(1, 0, 0);
  setup.light = light;
  setup.discs = {{{0, 0, 0}, {0, 0, 1}, 1000.0}};
  auto owned = std::make_unique<OwnedProblem>(setup);
  const auto ndc = [&](double depth) {
    const glm::dvec4 clip =
        owned->camera().clip_from_world() * glm::dvec4(setup.ws_eye + glm::dvec3(depth, 0, 0), 1.0);
    return clip.z / clip.w;
  };
  owned->problem().nearest_ndc_depth = ndc(kNear);
  owned->problem().farthest_ndc_depth = ndc(kFar);
  owned->problem().ws_scene_bounds = {glm::dvec3(-1e3), glm::dvec3(1e3)};
  owned->samples().hull_rays.clear();
  owned->samples().hull_along_ray.clear();
  return owned;
}

/// World coordinate along `ws_along` at which w = h3.r vanishes: the centre of projection.
double CenterAlong(const OwnedProblem& owned, const LightFit& fit, const glm::dvec3& ws_along) {
  const auto w = [&](double s) {
    return glm::dot(fit.projection.Axis(), owned.ray_space().RayFromPoint(s * ws_along));
  };
  // w is affine in s.
  return w(0.0) / (w(0.0) - w(1.0));
}

TEST(Lispsm, OverheadSunHasThePapersN) {
  const auto owned = LevelView(DirectionalLight{{0, 0, -1}});
  const LightFit fit = *MakeBaseline(Method::kLispsm)->Fit(owned->problem());
  ASSERT_EQ(fit.outcome, FitOutcome::kFitted) << fit.note;
  // The body begins kNear before the eye; its near plane is n = z_n + sqrt(z_n z_f) from the centre.
  const double n = kNear + std::sqrt(kNear * kFar);
  EXPECT_NEAR(CenterAlong(*owned, fit, {1, 0, 0}), 3.0 + kNear - n, 1e-9);
  // The warp is straight: nothing changes across the view.
  const glm::dvec3 axis = fit.projection.Axis();
  EXPECT_NEAR(glm::dot(axis, owned->ray_space().RayFromVector({0, 1, 0})), 0.0, 1e-12);
}

TEST(Lispsm, TiltedSunDividesNByTheSineOfGamma) {
  for (const double degrees : {85.0, 60.0, 35.0, 20.0}) {
    const double gamma = degrees * std::numbers::pi / 180.0;
    // The angle between the view (+x) and the light is gamma.
    const auto owned = LevelView(DirectionalLight{{std::cos(gamma), 0.0, -std::sin(gamma)}});
    const LightFit fit = *MakeBaseline(Method::kLispsm)->Fit(owned->problem());
    ASSERT_EQ(fit.outcome, FitOutcome::kFitted) << fit.note;
    // The view direction's image, and the view slice's extent along it by brute force over its corners.
    const glm::dvec3 along(std::sin(gamma), 0.0, std::cos(gamma));
    double s_near = HUGE_VAL;
    double s_far = -HUGE_VAL;
    for (const double ndc_depth : {owned->problem().nearest_ndc_depth, owned->problem().farthest_ndc_depth}) {
      for (const double y : {-1.0, 1.0}) {
        const glm::dvec4 p = owned->camera().WsFromNdc({0.0, y, ndc_depth});
        s_near = std::min(s_near, glm::dot(along, glm::dvec3(p) / p.w));
        s_far = std::max(s_far, glm::dot(along, glm::dvec3(p) / p.w));
      }
    }
    const double z_f = kNear + (s_far - s_near) * std::sin(gamma);
    const double n = (kNear + std::sqrt(kNear * z_f)) / std::sin(gamma);
    EXPECT_NEAR(CenterAlong(*owned, fit, along), s_near - n, 1e-8 * n) << degrees << " degrees";
  }
}

TEST(Lispsm, TurnsIntoFocusedAsTheSunTurnsIntoTheView) {
  double previous_n = 0.0;
  for (const double degrees : {40.0, 10.0, 3.0, 1.0, 0.3}) {
    const double gamma = degrees * std::numbers::pi / 180.0;
    const auto owned = LevelView(DirectionalLight{{std::cos(gamma), 0.0, -std::sin(gamma)}});
    const LightFit fit = *MakeBaseline(Method::kLispsm)->Fit(owned->problem());
    if (fit.outcome == FitOutcome::kFallback) {
      EXPECT_LT(degrees, 10.0);
      continue;
    }
    const double n = -CenterAlong(*owned, fit, {std::sin(gamma), 0.0, std::cos(gamma)});
    EXPECT_GT(n, previous_n);
    previous_n = n;
  }
  const auto owned = LevelView(DirectionalLight{{1.0, 0.0, 0.0}});
  const LightFit fit = *MakeBaseline(Method::kLispsm)->Fit(owned->problem());
  EXPECT_EQ(fit.outcome, FitOutcome::kFallback);
  EXPECT_EQ(fit.projection.texel_from_ray,
            MakeBaseline(Method::kFocused)->Fit(owned->problem())->projection.texel_from_ray);
}

TEST(Lispsm, AnOrthographicCameraIsFocused) {
  ProblemSetup setup;
  setup.orthographic = true;
  setup.light = DirectionalLight{{0.3, 0.2, -1.0}};
  const OwnedProblem owned(setup);
  const LightFit fit = *MakeBaseline(Method::kLispsm)->Fit(owned.problem());
  EXPECT_EQ(fit.outcome, FitOutcome::kFallback);
  EXPECT_EQ(fit.projection.texel_from_ray,
            MakeBaseline(Method::kFocused)->Fit(owned.problem())->projection.texel_from_ray);
}

// A point light that recedes becomes a directional one, and its map the same.
TEST(Lispsm, DistantPointLightAgreesWithTheSun) {
  const glm::dvec3 direction = glm::normalize(glm::dvec3(0.3, 0.4, -1.0));
  ProblemSetup setup;
  setup.light = DirectionalLight{direction};
  const OwnedProblem sun(setup);
  setup.light = PointLight{-1e6 * direction};
  const OwnedProblem lamp(setup);
  const LightFit of_sun = *MakeBaseline(Method::kLispsm)->Fit(sun.problem());
  const LightFit of_lamp = *MakeBaseline(Method::kLispsm)->Fit(lamp.problem());
  ASSERT_EQ(of_sun.outcome, FitOutcome::kFitted);
  ASSERT_EQ(of_lamp.outcome, FitOutcome::kFitted);
  for (size_t i = 0; i < sun.problem().samples->hull_rays.size(); ++i) {
    const glm::dvec2 a(of_sun.projection.TexelFromRay(sun.problem().samples->hull_rays[i]));
    const glm::dvec2 b(of_lamp.projection.TexelFromRay(lamp.problem().samples->hull_rays[i]));
    EXPECT_NEAR(glm::distance(a, b), 0.0, 0.05);
  }
}

// What the warp is for: near receivers get more texels a metre than Focused gives them.
TEST(Lispsm, SpendsTexelsNearTheEye) {
  const auto owned = LevelView(DirectionalLight{{0, 0.2, -1}});
  const LightFit lispsm = *MakeBaseline(Method::kLispsm)->Fit(owned->problem());
  const LightFit focused = *MakeBaseline(Method::kFocused)->Fit(owned->problem());
  const auto texels_per_metre = [&](const LightFit& fit, double depth) {
    const glm::dvec3 a =
        fit.projection.TexelFromRay(owned->ray_space().RayFromPoint({3.0 + depth, -2.0, 0.0}));
    const glm::dvec3 b =
        fit.projection.TexelFromRay(owned->ray_space().RayFromPoint({3.0 + depth, -1.9, 0.0}));
    return glm::distance(glm::dvec2(a), glm::dvec2(b)) / 0.1;
  };
  EXPECT_GT(texels_per_metre(lispsm, 3.0), 3.0 * texels_per_metre(focused, 3.0));
}

}  // namespace
}  // namespace shadowfit
