// What every baseline promises, over thousands of random problems.

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <string>

#include "core/baseline/baselines.h"
#include "core/math/enclosing_cone.h"
#include "tests/unit/baseline/random_problem.h"

namespace shadowfit {
namespace {

using testing::OwnedProblem;
using testing::ProblemSetup;
using testing::RandomSetup;

constexpr Method kBaselines[] = {Method::kNormal, Method::kFocused, Method::kLispsm, Method::kPlaneOptimal,
                                 Method::kSphereStable};

bool IsFinite(const glm::dmat3& m) {
  for (int i = 0; i < 9; ++i) {
    if (!std::isfinite(m[i / 3][i % 3])) return false;
  }
  return true;
}

/// Whether one map can serve the rays at all.
bool FitOneMap(const OwnedProblem& owned) {
  if (owned.problem().samples->hull_rays.empty()) return true;
  const std::optional<EnclosingCone> cone = SmallestEnclosingCone(owned.problem().samples->hull_rays);
  return cone && cone->cos_half_angle > 0.02;
}

void ExpectWellFormed(const LightFit& fit, const OwnedProblem& owned) {
  const glm::dmat3& h = fit.projection.texel_from_ray;
  ASSERT_TRUE(IsFinite(h));
  EXPECT_NEAR(glm::length(fit.projection.Axis()), 1.0, 1e-12);
  EXPECT_GT(glm::determinant(h), 0.0);
  EXPECT_EQ(fit.projection.size, owned.setup().map_size);
  EXPECT_EQ(fit.outcome == FitOutcome::kFallback, fit.note[0] != '\0') << fit.note;
}

void ExpectInFront(const LightFit& fit, const OwnedProblem& owned) {
  for (const glm::dvec3& ray : owned.problem().samples->hull_rays) {
    ASSERT_GT(fit.projection.TexelFromRay(ray).z, 0.0) << fit.note;
  }
}

void ExpectContains(const LightFit& fit, const OwnedProblem& owned) {
  const MapSize size = fit.projection.size;
  for (const glm::dvec3& ray : owned.problem().samples->hull_rays) {
    const glm::dvec3 u = fit.projection.TexelFromRay(ray);
    ASSERT_GE(u.x, -1e-9 * size.width) << fit.note;
    ASSERT_LE(u.x, size.width * (1.0 + 1e-9)) << fit.note;
    ASSERT_GE(u.y, -1e-9 * size.height) << fit.note;
    ASSERT_LE(u.y, size.height * (1.0 + 1e-9)) << fit.note;
  }
}

class BaselineProperties : public ::testing::TestWithParam<Method> {};

TEST_P(BaselineProperties, HoldOnRandomProblems) {
  const std::unique_ptr<LightMatrixMethod> method = MakeBaseline(GetParam());
  ASSERT_NE(method, nullptr);
  std::mt19937_64 random(17);
  int fitted = 0;
  int with_samples = 0;
  for (int round = 0; round < 3000; ++round) {
    const OwnedProblem owned(RandomSetup(random));
    SCOPED_TRACE("round " + std::to_string(round));
    const absl::StatusOr<LightFit> fit = method->Fit(owned.problem());
    ASSERT_TRUE(fit.ok()) << fit.status();
    ExpectWellFormed(*fit, owned);
    if (FitOneMap(owned)) {
      ExpectInFront(*fit, owned);
      if (GetParam() != Method::kPlaneOptimal || fit->outcome == FitOutcome::kFallback) {
        ExpectContains(*fit, owned);
      }
    } else if (fit->outcome != FitOutcome::kFallback) {
      ExpectInFront(*fit, owned);  // A plane's homography can serve rays that no frustum can.
    }
    if (HasFatalFailure()) return;
    if (!owned.problem().samples->hull_rays.empty()) {
      ++with_samples;
      if (fit->outcome == FitOutcome::kFitted) ++fitted;
    }
  }
  // The properties must not hold because every problem is answered with a fallback.
  EXPECT_GT(with_samples, 1500);
  EXPECT_GT(fitted, with_samples / (GetParam() == Method::kPlaneOptimal ? 5 : 3));
  RecordProperty("fitted", fitted);
  RecordProperty("with_samples", with_samples);
}

TEST_P(BaselineProperties, AreDeterministic) {
  const std::unique_ptr<LightMatrixMethod> method = MakeBaseline(GetParam());
  std::mt19937_64 random(5);
  for (int round = 0; round < 50; ++round) {
    const ProblemSetup setup = RandomSetup(random);
    const OwnedProblem first(setup);
    const OwnedProblem second(setup);
    EXPECT_EQ(method->Fit(first.problem())->projection.texel_from_ray,
              method->Fit(second.problem())->projection.texel_from_ray);
  }
}

// The configurations that break light matrices.
TEST_P(BaselineProperties, HoldOnDegenerateConfigurations) {
  struct Case {
    const char* name;
    ProblemSetup setup;
  };
  const ProblemSetup standard;
  std::vector<Case> cases;
  const auto add = [&](const char* name, const ProblemSetup& setup) {
    cases.push_back({name, setup});
    cases.back().setup.scene_bounds = false;
    cases.push_back({name, setup});
    cases.back().setup.scene_bounds = true;
  };
  ProblemSetup setup = standard;
  setup.light = PointLight{{5.0, 0.5, 1.2}};
  add("light inside the view frustum", setup);
  setup.light = PointLight{{-5.0, 0.5, 3.0}};
  add("light behind the camera", setup);
  setup.light = PointLight{{5.0, 0.5, -3.0}};
  add("light below the floor", setup);
  setup.light = PointLight{setup.ws_eye};
  add("light in the eye", setup);
  setup.light = PointLight{{5.0, 0.0, 0.0}};
  add("light in the receiver's plane", setup);
  setup.light = DirectionalLight{setup.ws_target - setup.ws_eye};
  add("sun parallel to the view", setup);
  setup.light = DirectionalLight{setup.ws_eye - setup.ws_target};
  add("sun against the view", setup);
  setup.light = DirectionalLight{{1.0, 0.2, 0.0}};
  add("sun at the horizon", setup);
  setup.light = DirectionalLight{{1.0, 0.2, -1e-4}};
  add("sun just above the horizon", setup);
  setup.light = DirectionalLight{{0.0, 0.0, 1.0}};
  add("sun from below", setup);
  setup.light = SpotLight{{5.0, 0.0, 4.0}, {0.0, 0.0, -1.0}, 1.57079};
  add("spot of almost 180 degrees", setup);
  setup.light = SpotLight{{5.0, 0.0, 4.0}, {0.0, 0.0, -1.0}, 1e-6};
  add("spot of almost no width", setup);
  setup = standard;
  setup.discs.clear();
  for (const Light& light :
       {Light(PointLight{{1, 2, 30}}), Light(SpotLight{{1, 2, 30}}), Light(DirectionalLight{})}) {
    setup.light = light;
    cases.push_back({"empty scene", setup});
    cases.back().setup.scene_bounds = false;
  }
  setup = standard;
  setup.pixels_x = setup.pixels_y = 1;
  for (const Light& light :
       {Light(PointLight{{1, 2, 30}}), Light(SpotLight{{10, 0, 30}}), Light(DirectionalLight{})}) {
    setup.light = light;
    add("one sample", setup);
    setup.pixels_x = 7;
    add("a row of samples", setup);
    setup.pixels_x = 1;
  }
  setup = standard;
  setup.orthographic = true;
  setup.light = DirectionalLight{{0.3, 0.2, -1.0}};
  add("orthographic camera", setup);
  setup.light = DirectionalLight{setup.ws_target - setup.ws_eye};
  add("orthographic camera along the sun", setup);
  setup = standard;
  setup.discs = {{{10.0, 0.0, 0.0}, {-1.0, 0.0, 0.0}, 30.0}};
  setup.ws_target = {10.0, 0.0, 1.7};
  setup.light = DirectionalLight{{1.0, 0.1, -0.2}};
  add("a wall across the view, without depth", setup);
  setup.light = PointLight{{9.99, 0.0, 3.0}};
  add("light grazing a wall", setup);

  const std::unique_ptr<LightMatrixMethod> method = MakeBaseline(GetParam());
  for (const Case& test_case : cases) {
    SCOPED_TRACE(std::string(test_case.name) + (test_case.setup.scene_bounds ? ", with bounds" : ""));
    const OwnedProblem owned(test_case.setup);
    const absl::StatusOr<LightFit> fit = method->Fit(owned.problem());
    ASSERT_TRUE(fit.ok()) << fit.status();
    ExpectWellFormed(*fit, owned);
    if (!FitOneMap(owned) && fit->outcome == FitOutcome::kFallback) continue;
    ExpectInFront(*fit, owned);
    if (GetParam() != Method::kPlaneOptimal || fit->outcome == FitOutcome::kFallback)
      ExpectContains(*fit, owned);
  }
}

INSTANTIATE_TEST_SUITE_P(All, BaselineProperties, ::testing::ValuesIn(kBaselines),
                         [](const auto& info) { return std::string(MethodName(info.param)); });

TEST(MakeBaseline, HasNoOptimizers) {
  EXPECT_EQ(MakeBaseline(Method::kDefault), nullptr);
  EXPECT_EQ(MakeBaseline(Method::kPaper), nullptr);
}

}  // namespace
}  // namespace shadowfit
