#include "core/frame/camera.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <glm/gtc/matrix_transform.hpp>
#include <limits>

#include "tests/support/analytic_scene.h"

namespace shadowfit {
namespace {

using ::testing::StartsWith;

TEST(Camera, FindsTheEyeOfAPerspectiveCameraInEveryConvention) {
  std::mt19937 random(1);
  for (int trial = 0; trial < 300; ++trial) {
    const auto convention = static_cast<ClipDepth>(trial % 3);
    const CameraMatrices matrices = testing::WalkThroughCamera(random, convention);
    const Camera camera = *Camera::Create(matrices);
    const glm::dvec3 eye(glm::inverse(matrices.view_from_world)[3]);
    EXPECT_EQ(camera.ws_eye().w, 1.0);
    EXPECT_LT(glm::length(glm::dvec3(camera.ws_eye()) - eye), 1e-6 * (1.0 + glm::length(eye)));
  }
}

TEST(Camera, FindsTheDirectionToAnOrthographicViewer) {
  const glm::dvec3 eye(1, -5, 3);
  const glm::dvec3 target(0, 0, 0);
  CameraMatrices matrices;
  matrices.view_from_world = glm::lookAtRH(eye, target, glm::dvec3(0, 0, 1));
  matrices.clip_from_view = glm::orthoRH_NO(-4.0, 4.0, -3.0, 3.0, 0.1, 50.0);
  const Camera camera = *Camera::Create(matrices);
  EXPECT_EQ(camera.ws_eye().w, 0.0);
  EXPECT_LT(glm::length(camera.TowardsViewer(target) - glm::normalize(eye - target)), 1e-9);
}

TEST(Camera, NamesBadMatrices) {
  CameraMatrices matrices;
  matrices.view_from_world[2][1] = std::numeric_limits<double>::infinity();
  EXPECT_THAT(std::string(Camera::Create(matrices).status().message()), StartsWith("view.m[9]: inf"));
  matrices = {};
  matrices.clip_from_view[3] = matrices.clip_from_view[2];
  EXPECT_THAT(std::string(Camera::Create(matrices).status().message()), StartsWith("projection: singular"));
  // Small is not singular: units do not matter.
  matrices = {};
  matrices.view_from_world *= 1e-6;
  EXPECT_TRUE(Camera::Create(matrices).ok());
}

}  // namespace
}  // namespace shadowfit
