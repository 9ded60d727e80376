#include "client/demo/walk.h"

#include <gtest/gtest.h>

#include <cmath>

#include "core/math/ray_space.h"
#include "core/scene/procedural.h"

namespace shadowfit {
namespace {

TEST(WalkTest, CamerasMoveSmoothlyAndLightsAreValid) {
  Scene unknown = MakeRandomTriangles(50, 1);
  unknown.name = "some file";
  Scene sterngarten = unknown;
  sterngarten.name = "sterngarten";
  const absl::StatusOr<Scene> plaza = MakePlaza(20000);
  ASSERT_TRUE(plaza.ok());
  for (const Scene& scene : {unknown, sterngarten, *plaza, Scene()}) {
    for (const int lights : {1, 4, 32}) {
      SCOPED_TRACE(scene.name);
      const Walk walk = PlanWalk(scene, 48, lights, 4.0 / 3.0);
      ASSERT_EQ(walk.cameras.size(), 48u);
      ASSERT_EQ(walk.lights.size(), static_cast<size_t>(lights));
      for (const SceneLight& light : walk.lights)
        EXPECT_TRUE(RaySpace::Create(light.light).ok()) << light.name;
      EXPECT_TRUE(std::holds_alternative<DirectionalLight>(walk.lights[0].light));
      double longest = 0.0;
      double way = 0.0;
      for (size_t i = 1; i < walk.cameras.size(); ++i) {
        const glm::dvec3 a(Camera::Create(walk.cameras[i - 1])->ws_eye());
        const glm::dvec3 b(Camera::Create(walk.cameras[i])->ws_eye());
        longest = std::max(longest, glm::distance(a, b));
        way += glm::distance(a, b);
      }
      EXPECT_GT(way, 0.0);
      EXPECT_LT(longest, 3.0 * way / 47.0) << "no step is much longer than the others";
    }
  }
}

TEST(WalkTest, OneFrameStandsStill) {
  const absl::StatusOr<Scene> plaza = MakePlaza(20000);
  ASSERT_TRUE(plaza.ok());
  const Walk walk = PlanWalk(*plaza, 1, 2, 1.0);
  ASSERT_EQ(walk.cameras.size(), 1u);
  EXPECT_TRUE(Camera::Create(walk.cameras[0]).ok());
}

}  // namespace
}  // namespace shadowfit
