#include "core/reference/artefacts.h"

#include <gtest/gtest.h>

#include <vector>

#include "core/baseline/methods.h"
#include "core/bias/safe_bias.h"
#include "core/reference/shadow_map_test.h"
#include "core/resolution/resolution.h"
#include "test_scenes.h"

namespace shadowfit {
namespace {

/// A closed box, corners counter-clockwise as seen from outside.
void AddBox(Scene* scene, glm::vec3 low, glm::vec3 size) {
  const glm::vec3 x(size.x, 0, 0);
  const glm::vec3 y(0, size.y, 0);
  const glm::vec3 z(0, 0, size.z);
  AddQuad(scene, low, y, x);
  AddQuad(scene, low + z, x, y);
  AddQuad(scene, low, x, z);
  AddQuad(scene, low + y, z, x);
  AddQuad(scene, low, z, y);
  AddQuad(scene, low + x, y, z);
}

Scene BoxesOnAFloor() {
  Scene scene = SceneOf({}, {});
  AddQuad(&scene, {-8, -8, 0}, {16, 0, 0}, {0, 16, 0});
  AddBox(&scene, {-1, -1, 0}, {1.5, 2, 1.2});
  AddBox(&scene, {2, 1, 0.5}, {1, 1, 1});
  return scene;
}

class ArtefactsTest : public ::testing::Test {
 protected:
  ArtefactsTest() {
    ray_space_ = RaySpace::Create(DirectionalLight{{0.6, 0.4, -1.0}}).value();
    projection_ = CenteredMap(160, 9.0);
    surface_ = scene_.RenderSurface(camera_, 250, 250);
    truth_ = scene_.TrueShadow(surface_, ray_space_);
  }

  ShadowMask Shown(const StandardMap& map, const StandardTest& test) const {
    return ShadowFromStandardMap(map, test, surface_, truth_, ray_space_);
  }

  const TruthScene scene_ = TruthScene::Create(BoxesOnAFloor()).value();
  const Camera camera_ = Camera::Create(LookAt({-3, -8, 5}, {0, 0, 0.5})).value();
  RaySpace ray_space_ = RaySpace::Create(DirectionalLight{}).value();
  ShadowProjection projection_;
  const DepthRange range_{0.0, -12.0, 12.0};
  VisibleSurface surface_;
  ShadowMask truth_;
};

TEST_F(ArtefactsTest, WithoutDepthErrorsItIsTheExactMapTest) {
  const StandardMap map = RenderStandardMap(scene_, ray_space_, projection_, range_).value();
  const ShadowMask ideal = ShadowWithoutDepthErrors(map, 0, surface_, truth_, ray_space_);
  const ShadowMask exact =
      ShadowFromMaps(scene_, surface_, truth_, ray_space_, std::vector<ShadowProjection>{projection_})
          .value();
  // But for the feet of casters: the exact test lets what rises less than a fifth of a texel's way above the
  // plane shadow nothing (core/reference/shadow_map_test.h).
  for (size_t i = 0; i < exact.size(); ++i) {
    if (exact[i] == ideal[i]) continue;
    EXPECT_EQ(exact[i], PixelLight::kLit) << "pixel " << i;
  }
  EXPECT_LT(CountWrongPixels(exact, ideal), static_cast<int>(exact.size()) / 1000);
  EXPECT_GT(CountWrongPixels(truth_, exact), 50);  // The map is coarse enough to matter.
}

TEST_F(ArtefactsTest, EveryWrongPixelHasOneCause) {
  const StandardMap map = RenderStandardMap(scene_, ray_space_, projection_, range_).value();
  for (const int radius : {0, 1}) {
    const ShadowMask ideal = ShadowWithoutDepthErrors(map, radius, surface_, truth_, ray_space_);
    int last_acne = 1 << 30;
    int last_detached = -1;
    for (const double constant : {0.0, 0.003, 0.01, 0.05, 0.2}) {
      const ShadowMask shown =
          Shown(map, {DepthFormat::kUnorm24, BiasKind::kConstant, constant, 0.0, radius});
      const ArtefactCounts counts = CountArtefacts(truth_, ideal, shown);
      EXPECT_EQ(counts.wrong(), CountWrongPixels(truth_, shown));
      // More bias, less acne and more detachment.
      EXPECT_LE(counts.acne, last_acne);
      EXPECT_GE(counts.peter_panning, last_detached);
      last_acne = counts.acne;
      last_detached = counts.peter_panning;
    }
    EXPECT_EQ(last_acne, 0);
    EXPECT_GT(last_detached, 100);
  }
}

TEST_F(ArtefactsTest, ReceiverPlaneBiasDetachesLeast) {
  const StandardMap map = RenderStandardMap(scene_, ray_space_, projection_, range_).value();
  const ShadowMask ideal = ShadowWithoutDepthErrors(map, 0, surface_, truth_, ray_space_);
  const SafeBias bias = FindSafeBias(camera_, surface_.ws_point, surface_.ws_normal, ray_space_, projection_,
                                     range_, {DepthFormat::kUnorm24, 0, {250, 250}}, surface_.Depth())
                            .value();
  const auto count = [&](BiasKind kind, double constant, double slope) {
    StandardTest test{DepthFormat::kUnorm24, kind, constant, slope, 0};
    test.clamp = bias.clamp;
    return CountArtefacts(truth_, ideal, Shown(map, test));
  };
  const ArtefactCounts plane = count(BiasKind::kReceiverPlane, bias.receiver_plane_constant, 0.0);
  const ArtefactCounts slope = count(BiasKind::kSlopeScaled, bias.constant, bias.slope);
  const ArtefactCounts constant = count(BiasKind::kConstant, bias.clamp, 0.0);
  EXPECT_EQ(plane.acne, 0);
  EXPECT_EQ(slope.acne, 0);
  EXPECT_EQ(constant.acne, 0);
  EXPECT_LE(plane.peter_panning, slope.peter_panning);
  EXPECT_LE(slope.peter_panning, constant.peter_panning);
}

TEST_F(ArtefactsTest, FacesAreToldApart) {
  const auto render = [&](CasterFaces faces) {
    return RenderStandardMap(scene_, ray_space_, projection_, range_, faces).value();
  };
  const StandardMap both = render(CasterFaces::kBoth);
  const StandardMap front = render(CasterFaces::kFront);
  const StandardMap back = render(CasterFaces::kBack);
  int boxes_seen = 0;
  for (size_t i = 0; i < both.depth.size(); ++i) {
    if (both.casters.primitive[i] == kNoPrimitive) continue;
    // The nearest of the two kinds is the nearest of all.
    EXPECT_NEAR(both.depth[i], std::min(front.depth[i], back.depth[i]), 1e-5);
    for (const StandardMap* map : {&front, &back}) {
      if (map->casters.primitive[i] == kNoPrimitive) continue;
      const double facing =
          glm::dot(scene_.WindingNormal(map->casters.primitive[i]), ray_space_.ws_direction());
      EXPECT_EQ(facing < 0.0, map == &front);
    }
    boxes_seen += back.casters.primitive[i] != kNoPrimitive ? 1 : 0;
  }
  EXPECT_GT(boxes_seen, 100);
  // Lit fronts cannot shadow themselves where only backs are drawn: no bias, and hardly any acne.
  const ShadowMask ideal = ShadowWithoutDepthErrors(both, 0, surface_, truth_, ray_space_);
  const StandardTest bare{DepthFormat::kUnorm24, BiasKind::kConstant, 0.0, 0.0, 0};
  EXPECT_LT(CountArtefacts(truth_, ideal, Shown(back, bare)).acne,
            CountArtefacts(truth_, ideal, Shown(both, bare)).acne / 20);
}

TEST_F(ArtefactsTest, SphereStableDoesNotFlickerAsTheCameraTurns) {
  const Light light = DirectionalLight{{0.6, 0.4, -1.0}};
  const LightSamples no_samples;
  const auto flicker = [&](absl::StatusOr<LightFit> (*fit)(const LightProblem&)) {
    ShadowMask before;
    int total = 0;
    for (int turn = 0; turn < 6; ++turn) {
      const double angle = 0.05 * turn;
      const glm::dvec3 eye(-3, -8, 5);
      const Camera camera =
          Camera::Create(LookAt(eye, eye + glm::dvec3(3.0 + 8.0 * angle, 8.0 - 3.0 * angle, -4.5))).value();
      LightProblem problem;
      problem.camera = &camera;
      problem.light = &light;
      problem.ray_space = &ray_space_;
      problem.samples = &no_samples;
      problem.map_size = {256, 256};
      problem.nearest_ndc_depth = 0.5;
      problem.farthest_ndc_depth = 0.995;
      problem.ws_scene_bounds = scene_.ws_bounds();
      const LightFit made = fit(problem).value();
      const StandardMap map = RenderStandardMap(scene_, ray_space_, made.projection, range_).value();
      const ShadowMask mask = ShadowWithoutDepthErrors(map, 0, surface_, truth_, ray_space_);
      if (turn > 0) total += CountFlicker(truth_, before, truth_, mask);
      before = mask;
    }
    return total;
  };
  const int stable = flicker(&FitSphereStable);
  const int focused = flicker(&FitFocused);
  RecordProperty("sphere_stable", stable);
  RecordProperty("focused", focused);
  EXPECT_EQ(stable, 0);
  EXPECT_GT(focused, 100);
}

TEST(CountFlickerTest, CountsChangesThatTheTruthDoesNotMake) {
  using enum PixelLight;
  const ShadowMask truth = {kLit, kLit, kShadowed, kNotConcerned};
  const ShadowMask moved = {kLit, kShadowed, kShadowed, kNotConcerned};
  const ShadowMask before = {kLit, kLit, kShadowed, kNotConcerned};
  const ShadowMask after = {kShadowed, kShadowed, kLit, kNotConcerned};
  EXPECT_EQ(CountFlicker(truth, before, truth, after), 3);
  EXPECT_EQ(CountFlicker(truth, before, moved, after), 2);
}

}  // namespace
}  // namespace shadowfit
