#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "core/baseline/baselines.h"
#include "tests/unit/baseline/random_problem.h"

namespace shadowfit {
namespace {

using testing::OwnedProblem;
using testing::ProblemSetup;

/// Fits with something visible between two view depths.
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
  // A directional light's window follows the view; those of others hold the whole scene and stay.
  for (const Light& light : FarLights()) {
    const bool directional = std::holds_alternative<DirectionalLight>(light);
    ProblemSetup setup;
    setup.light = light;
    const LightFit reference = FitSlice(setup, 0.5, 20.0);
    ASSERT_EQ(reference.outcome, FitOutcome::kFitted) << reference.note;
    bool moved = false;
    for (int round = 0; round < 50; ++round) {
      const double turn = 3.0;
      ProblemSetup turned = setup;
      turned.ws_target = turned.ws_eye + glm::dvec3(std::cos(turn * unit(random)),
                                                    std::sin(turn * unit(random)), 0.3 * unit(random) - 0.1);
      const LightFit fit = FitSlice(turned, 0.5, 20.0);
      glm::dvec2 shift;
      const double error = LatticeError(setup, reference, fit, &shift);
      EXPECT_LT(error, 1e-6) << "light " << light.index() << " round " << round;
      if (shift != glm::dvec2(0.0)) moved = true;
    }
    EXPECT_EQ(moved, directional);
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
    // The reach of the view changes with the walk, and with it, now and then, the size.
    const bool directional = std::holds_alternative<DirectionalLight>(light);
    EXPECT_GE(same_size, directional ? 30 : 50) << "light " << light.index();
    EXPECT_EQ(moved, directional);
  }
}

TEST(SphereStable, WhatIsVisibleDoesNotMatter) {
  ProblemSetup setup;
  for (const Light& light : FarLights()) {
    setup.light = light;
    const LightFit reference = FitSlice(setup, 0.5, 20.0);
    for (const double depth : {1.0, 5.0, 30.0, 70.0}) {
      EXPECT_EQ(FitSlice(setup, 0.2, depth).projection.texel_from_ray, reference.projection.texel_from_ray);
    }
  }
}

TEST(SphereStable, HoldsTheWholeViewSliceOrTheWholeScene) {
  std::mt19937_64 random(43);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  for (int round = 0; round < 300; ++round) {
    ProblemSetup setup = testing::RandomSetup(random);
    const OwnedProblem owned(setup);
    const LightFit fit = *MakeBaseline(Method::kSphereStable)->Fit(owned.problem());
    if (fit.outcome == FitOutcome::kFallback || std::holds_alternative<SpotLight>(setup.light)) continue;
    const auto holds = [&](const glm::dvec3& ws_point) {
      const glm::dvec3 u = fit.projection.TexelFromRay(owned.ray_space().RayFromPoint(ws_point));
      return u.z > 0.0 && u.x >= -1e-6 * setup.map_size.width && u.x <= setup.map_size.width * (1 + 1e-6) &&
             u.y >= -1e-6 * setup.map_size.height && u.y <= setup.map_size.height * (1 + 1e-6);
    };
    bool holds_view = true;
    bool holds_scene = true;
    for (int i = 0; i < 8; ++i) {
      const glm::dvec4 p = owned.camera().WsFromNdc(
          {(i & 1) != 0 ? 1.0 : -1.0, (i & 2) != 0 ? 1.0 : -1.0,
           (i & 4) != 0 ? owned.problem().farthest_ndc_depth : owned.problem().nearest_ndc_depth});
      holds_view = holds_view && holds(glm::dvec3(p) / p.w);
      holds_scene = holds_scene && holds(owned.problem().ws_scene_bounds.Corners()[static_cast<size_t>(i)]);
    }
    ASSERT_TRUE(holds_view || holds_scene) << round;
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
