#include <gtest/gtest.h>

#include "client/scene_io/load_scene.h"
#include "tests/unit/irregular/against_rays.h"

namespace shadowfit {
namespace {

/// A real scene, whose trees are cutouts.
TEST(SterngartenMasksAgainstRays, PointSunAndSpot) {
  const auto scene = LoadScene("sterngarten");
  if (absl::IsNotFound(scene.status())) GTEST_SKIP() << scene.status();
  ASSERT_TRUE(scene.ok()) << scene.status();
  EXPECT_FALSE(scene->alpha_textures.empty());
  const Bounds bounds = scene->WsBounds();
  const glm::dvec3 centre = 0.5 * (bounds.min + bounds.max);
  const glm::dvec3 extent = bounds.max - bounds.min;
  const StandPoint from{centre + extent * glm::dvec3(0.02, -0.2, 0.15), centre};
  const glm::dvec3 above = centre + extent * glm::dvec3(0.1, 0.05, 0.6);
  oracle::ExpectEqualToRays("sterngarten, point", *scene, from, PointLight{above}, 640, 400);
  oracle::ExpectEqualToRays("sterngarten, sun", *scene, from, DirectionalLight{{0.4, 0.5, -0.6}}, 640, 400);
  oracle::ExpectEqualToRays("sterngarten, spot", *scene, from, SpotLight{above, centre - above, 0.6}, 640,
                            400);
}

}  // namespace
}  // namespace shadowfit
