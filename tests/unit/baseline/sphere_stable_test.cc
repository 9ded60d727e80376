#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "core/baseline/baselines.h"
#include "tests/unit/baseline/random_problem.h"

namespace shadowfit {
namespace {

using testing::OwnedProblem;
using testing::ProblemSetup;

/// Fits with the visible slice held between two view depths: what the camera sees does not change the sphere.
LightFit FitSlice(const ProblemSetup& setup, double near_depth, double far_depth) {
  OwnedProblem owned(setup);
  const auto ndc = [&](double depth) {
    const glm::dvec4 clip = owned.camera().clip_from_view() * glm::dvec4(0, 0, -depth, 1.0);
    return clip.z / clip.w;
  };
  owned.problem().nearest_ndc_depth = ndc(near_depth);
  owned.problem().farthest_ndc_depth = ndc(far_depth);
  // Fixed bounds: the scene does not move with the camera either.
  owned.problem().ws_scene_bounds = {glm::dvec3(-60, -60, 0), glm::dvec3(60, 60, 8)};
  return *MakeBaseline(Method::kSphereStable)->Fit(owned.problem());
}

/// How far `b` lies from `a` moved by whole texels, over rays of the light around some world points; or
/// nothing where the texels differ in size.
double LatticeError(const ProblemSetup& setup, const LightFit& a, const LightFit& b, glm::dvec2* shift) {
  const RaySpace space = *RaySpace::Create(setup.light);
  double worst = 0.0;
  bool first = true;
  for (const glm::dvec3& ws_point : {glm::dvec3(0, 0, 0), {9, 3, 1}, {-4, 8, 2}, {2, -7, 0.5}}) {
    const glm::dvec2 u(a.projection.TexelFromRay(space.RayFromPoint(ws_point)));
    const glm::dvec2 v(b.projection.TexelFromRay(space.RayFromPoint(ws_point)));
    const glm::dvec2 moved = v - u;
    if (first) *shift = glm::round(moved);
    first = false;
    worst = std::max(worst, glm::distance(moved, *shift));
  }
  return worst;
}

std::vector<Light> FarLights() {
  return {DirectionalLight{{0.3, 0.5, -1.0}}, DirectionalLight{{0, 0, -1}},
          SpotLight{{40, 30, 90}, {-40, -30, -90}, 0.9}, PointLight{{60, -80, 200}}};
}

TEST(SphereStable, TurningTheCameraLeavesTheTexelGridInPlace) {
  std::mt19937_64 random(41);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  // Perspective makes a point light's window change size with the sphere's distance: turns must be small
  // enough to stay on one step of the ladder. Directional windows never change.
  for (const Light& light : FarLights()) {
    const bool directional = std::holds_alternative<DirectionalLight>(light);
    ProblemSetup setup;
    setup.light = light;
    const LightFit reference = FitSlice(setup, 0.5, 20.0);
    ASSERT_EQ(reference.outcome, FitOutcome::kFitted) << reference.note;
    int same_size = 0;
    bool moved = false;
    for (int round = 0; round < 50; ++round) {
      const double turn = directional ? 3.0 : 0.3;
      ProblemSetup turned = setup;
      turned.ws_target = turned.ws_eye + glm::dvec3(std::cos(turn * unit(random)),
                                                    std::sin(turn * unit(random)), 0.3 * unit(random) - 0.1);
      const LightFit fit = FitSlice(turned, 0.5, 20.0);
      glm::dvec2 shift;
      const double error = LatticeError(setup, reference, fit, &shift);
      EXPECT_TRUE(!directional || error < 1e-6)
          << "light " << light.index() << " round " << round << ": " << error;
      if (error < 1e-6) ++same_size;
      if (shift != glm::dvec2(0.0)) moved = true;
    }
    EXPECT_GE(same_size, directional ? 50 : 20) << "light " << light.index();
    EXPECT_TRUE(moved) << "the window follows the view";
  }
}

TEST(SphereStable, MovingTheCameraMovesTheGridByWholeTexels) {
  std::mt19937_64 random(42);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  for (const Light& light : FarLights()) {
    ProblemSetup setup;
    setup.light = light;
    const LightFit reference = FitSlice(setup, 0.5, 20.0);
    int same_size = 0;
    bool moved = false;
    for (int round = 0; round < 50; ++round) {
      const glm::dvec3 step(unit(random), unit(random), 0.2 * unit(random));
      ProblemSetup walked = setup;
      walked.ws_eye += step;
      walked.ws_target += step;
      glm::dvec2 shift;
      const double error = LatticeError(setup, reference, FitSlice(walked, 0.5, 20.0), &shift);
      if (error < 1e-6) ++same_size;
      if (shift != glm::dvec2(0.0)) moved = true;
    }
    EXPECT_GE(same_size, std::holds_alternative<DirectionalLight>(light) ? 50 : 30)
        << "light " << light.index();
    EXPECT_TRUE(moved);
  }
}

TEST(SphereStable, SmallChangesOfTheVisibleDepthLeaveTheGridAlone) {
  ProblemSetup setup;
  setup.light = DirectionalLight{{0.3, 0.5, -1.0}};
  const LightFit reference = FitSlice(setup, 0.5, 20.0);
  int same = 0;
  for (int i = 0; i < 20; ++i) {
    glm::dvec2 shift;
    same += LatticeError(setup, reference, FitSlice(setup, 0.5, 20.0 + 0.02 * i), &shift) < 1e-6 ? 1 : 0;
  }
  EXPECT_GE(same, 15);
}

TEST(SphereStable, HoldsTheWholeViewSlice) {
  std::mt19937_64 random(43);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  for (int round = 0; round < 300; ++round) {
    ProblemSetup setup = testing::RandomSetup(random);
    const OwnedProblem owned(setup);
    const LightFit fit = *MakeBaseline(Method::kSphereStable)->Fit(owned.problem());
    if (fit.outcome == FitOutcome::kFallback || std::holds_alternative<SpotLight>(setup.light)) continue;
    for (int i = 0; i < 8; ++i) {
      const glm::dvec4 p = owned.camera().WsFromNdc(
          {(i & 1) != 0 ? 1.0 : -1.0, (i & 2) != 0 ? 1.0 : -1.0,
           (i & 4) != 0 ? owned.problem().farthest_ndc_depth : owned.problem().nearest_ndc_depth});
      const glm::dvec3 u = fit.projection.TexelFromRay(owned.ray_space().RayFromPoint(glm::dvec3(p) / p.w));
      ASSERT_GT(u.z, 0.0);
      ASSERT_TRUE(u.x >= -1e-6 * setup.map_size.width && u.x <= setup.map_size.width * (1 + 1e-6));
      ASSERT_TRUE(u.y >= -1e-6 * setup.map_size.height && u.y <= setup.map_size.height * (1 + 1e-6));
    }
  }
}

TEST(SphereStable, FallsBackToNormal) {
  ProblemSetup setup;
  setup.light = PointLight{{5.0, 0.5, 1.2}};
  const OwnedProblem inside(setup);
  EXPECT_EQ(MakeBaseline(Method::kSphereStable)->Fit(inside.problem())->outcome, FitOutcome::kFallback);

  setup.light = DirectionalLight{{0.3, 0.5, -1.0}};
  setup.map_size = {1, 512};
  const OwnedProblem narrow(setup);
  const LightFit fit = *MakeBaseline(Method::kSphereStable)->Fit(narrow.problem());
  EXPECT_EQ(fit.outcome, FitOutcome::kFallback);
  EXPECT_EQ(fit.projection.texel_from_ray,
            MakeBaseline(Method::kNormal)->Fit(narrow.problem())->projection.texel_from_ray);
}

}  // namespace
}  // namespace shadowfit
