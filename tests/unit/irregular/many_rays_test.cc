#include <gtest/gtest.h>

#include "core/scene/procedural.h"
#include "tests/unit/irregular/against_rays.h"
#include "tests/unit/irregular/random_scenes.h"

namespace shadowfit {
namespace {

using oracle::ExpectEqualToRays;
using oracle::RayComparison;

TEST(ManyMasksAgainstRays, TenThousandTinyScenes) {
  RandomScenes scenes(41, /*huge=*/false);
  RayComparison all;
  for (int n = 0; n < 10000; ++n) {
    const Scene scene = scenes.Next();
    const Light light = scenes.NextLight();
    const StandPoint from{glm::dvec3(scenes.Point(6.0)), glm::dvec3(scenes.Point(1.0))};
    const RayComparison one = oracle::CompareWithRays(scene, from, light, 24, 16);
    EXPECT_EQ(one.differing, 0u) << "scene " << n << " light kind " << light.index();
    all.Add(one);
  }
  all.Print("10,000 tiny scenes");
  EXPECT_GT(all.shadowed, all.samples / 100);
}

TEST(ManyMasksAgainstRays, LargeFrames) {
  const auto plaza = MakePlaza(200000);
  ASSERT_TRUE(plaza.ok()) << plaza.status();
  ExpectEqualToRays("plaza, point", *plaza, PlazaStandPoint(), PointLight{{5, -4, 14}}, 1280, 800);
  ExpectEqualToRays("plaza, sun", *plaza, PlazaStandPoint(), DirectionalLight{{0.5, 0.3, -0.8}}, 1280, 800);
  ExpectEqualToRays("random triangles", MakeRandomTriangles(300000, 3), {{0, -9, 6}, {0, 0, 1}},
                    PointLight{{2, 1, 9}}, 1280, 800);
  ExpectEqualToRays("hair ball", MakeHairBall(5000, 1.0f, 3), {{0, -8, 5}, {0, 0, 2.5}},
                    PointLight{{3, -4, 12}}, 1280, 800);
}

}  // namespace
}  // namespace shadowfit
