#include <gtest/gtest.h>

#include "core/scene/procedural.h"
#include "tests/unit/irregular/against_rays.h"

namespace shadowfit {
namespace {

using oracle::ExpectEqualToRays;

TEST(MasksAgainstRays, Plaza) {
  const auto scene = MakePlaza(60000);
  ASSERT_TRUE(scene.ok()) << scene.status();
  ExpectEqualToRays("plaza, point", *scene, PlazaStandPoint(), PointLight{{5, -4, 14}});
  ExpectEqualToRays("plaza, sun", *scene, PlazaStandPoint(), DirectionalLight{{0.5, 0.3, -0.8}});
  ExpectEqualToRays("plaza, spot", *scene, PlazaStandPoint(), SpotLight{{-6, -6, 12}, {0.5, 0.5, -1}, 0.7});
}

TEST(MasksAgainstRays, RandomTriangles) {
  ExpectEqualToRays("random triangles", MakeRandomTriangles(50000, 3), {{0, -9, 6}, {0, 0, 1}},
                    PointLight{{2, 1, 9}});
}

TEST(MasksAgainstRays, Terrain) {
  ExpectEqualToRays("terrain", MakeTerrain(150, 3), {{0, -60, 30}, {0, 0, 0}}, PointLight{{-60, 10, 40}});
}

TEST(MasksAgainstRays, HairBall) {
  ExpectEqualToRays("hair ball", MakeHairBall(2000, 1.0f, 3), {{0, -8, 5}, {0, 0, 2.5}},
                    PointLight{{3, -4, 12}});
}

}  // namespace
}  // namespace shadowfit
