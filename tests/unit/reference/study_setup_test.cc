#include "core/reference/study_setup.h"

#include <gmock/gmock.h>

#include <cmath>
#include <numbers>

#include "core/math/ray_space.h"
#include "core/scene/procedural.h"

namespace shadowfit {
namespace {

const Bounds kBounds{{-3.0, -4.0, 1.0}, {3.0, 4.0, 9.0}};  // R = 5.

TEST(StudySetupTest, LightsLieWhereTheirPlacementSays) {
  for (const glm::dvec3 up : {glm::dvec3(0, 0, 1), glm::dvec3(0, 1, 0)}) {
    const double radius = 5.0;  // The extents across the vertical are 6 and 8 both times.
    const glm::dvec3 foot = up.z > 0.0 ? glm::dvec3(0, 0, 1) : glm::dvec3(0, -4, 5);
    double height_sum = 0.0;
    constexpr int kLights = 2000;
    for (const Light& light : PlaceLights(LightPlacement::kNear, kLights, 7, kBounds, up)) {
      const glm::dvec3 offset = std::get<PointLight>(light).ws_position - foot;
      EXPECT_NEAR(glm::length(offset), 1.2 * radius, 1e-12);
      EXPECT_GE(glm::dot(offset, up), 1.2 * radius * std::sin(std::numbers::pi / 180.0) - 1e-12);
      height_sum += glm::dot(offset, up) / (1.2 * radius);
    }
    EXPECT_NEAR(height_sum / kLights, 0.51, 0.02);  // Heights are uniform on a uniform hemisphere.
    for (const Light& light : PlaceLights(LightPlacement::kDistant, 50, 7, kBounds, up)) {
      EXPECT_NEAR(glm::length(std::get<PointLight>(light).ws_position - foot), 5.0 * radius, 1e-11);
    }
    for (const Light& light : PlaceLights(LightPlacement::kDirectional, 50, 7, kBounds, up)) {
      EXPECT_LT(glm::dot(std::get<DirectionalLight>(light).ws_direction, up), 0.0);
    }
    for (const Light& light : PlaceLights(LightPlacement::kInside, 50, 7, kBounds, up)) {
      const glm::dvec3 p = std::get<PointLight>(light).ws_position;
      EXPECT_TRUE(glm::all(glm::greaterThan(p, kBounds.min)) && glm::all(glm::lessThan(p, kBounds.max)));
      EXPECT_GE(glm::dot(p - kBounds.Center(), up), 0.0);
    }
  }
}

TEST(StudySetupTest, ALightDependsOnSeedAndIndexAlone) {
  const auto few = PlaceLights(LightPlacement::kNear, 3, 11, kBounds);
  const auto many = PlaceLights(LightPlacement::kNear, 30, 11, kBounds);
  const auto other = PlaceLights(LightPlacement::kNear, 3, 12, kBounds);
  for (size_t i = 0; i < few.size(); ++i) {
    const glm::dvec3 p = std::get<PointLight>(few[i]).ws_position;
    EXPECT_EQ(p, std::get<PointLight>(many[i]).ws_position);
    EXPECT_NE(p, std::get<PointLight>(other[i]).ws_position);
  }
}

TEST(StudySetupTest, NamesRoundTrip) {
  for (const char* name : {"near", "distant", "directional", "inside"}) {
    ASSERT_TRUE(LightPlacementFromName(name).has_value());
    EXPECT_EQ(LightPlacementName(*LightPlacementFromName(name)), name);
  }
  EXPECT_FALSE(LightPlacementFromName("far").has_value());
}

TEST(StudySetupTest, StandPointsStandOnAFloorAndSeeSomething) {
  for (const char* name : {"plaza:30000", "hall:50000"}) {
    const TruthScene scene = *TruthScene::Create(*MakeProceduralScene(name));
    const ViewOptions options;
    const std::vector<StandPoint> found = FindStandPoints(scene, 3, 5, options);
    ASSERT_EQ(found.size(), 3u);
    for (const StandPoint& stand_point : found) {
      const auto floor = scene.FirstHit(stand_point.ws_eye, {0, 0, -1});
      ASSERT_TRUE(floor.has_value());
      EXPECT_NEAR(floor->distance, 1.7, 1e-4);
      EXPECT_NEAR(floor->ws_normal.z, 1.0, 0.2);
      const Camera camera = *Camera::Create(CameraAt(stand_point, scene.ws_bounds(), options));
      const VisibleSurface surface = scene.RenderSurface(camera, 50, 50);
      EXPECT_GT(std::ranges::count_if(surface.primitive, [](uint32_t p) { return p != kNoPrimitive; }), 1000);
    }
    EXPECT_EQ(FindStandPoints(scene, 1, 5, options)[0].ws_eye, found[0].ws_eye);
  }
  EXPECT_TRUE(FindStandPoints(*TruthScene::Create(Scene{}), 2, 1, ViewOptions{}).empty());
}

}  // namespace
}  // namespace shadowfit
