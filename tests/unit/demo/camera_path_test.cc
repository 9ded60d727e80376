#include "client/demo/camera_path.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <numbers>
#include <string>

#include "core/frame/camera.h"

namespace shadowfit {
namespace {

using ::testing::HasSubstr;

TEST(CameraPathTest, ReadsCamerasAndLights) {
  const absl::StatusOr<CameraPath> path = ParseCameraPath(R"({
    "width": 400, "height": 200, "verticalFovDegrees": 90, "near": 0.5, "far": 50,
    "shadowMap": {"width": 256, "height": 128},
    "frames": [{"eye": [0, -5, 1], "target": [0, 0, 1]}, {"eye": [1, -5, 1], "target": [0, 0, 1]}],
    "lights": [{"directional": {"direction": [0, 1, -1]}, "power": [3, 2, 1]},
               {"point": {"position": [1, 2, 3]}},
               {"spot": {"position": [1, 2, 3], "direction": [0, 0, -2], "outerHalfAngleDegrees": 30}}]})");
  ASSERT_TRUE(path.ok()) << path.status();
  EXPECT_EQ(path->screen, (MapSize{400, 200}));
  EXPECT_EQ(path->map_size, (MapSize{256, 128}));
  ASSERT_EQ(path->walk.cameras.size(), 2u);
  const Camera camera = *Camera::Create(path->walk.cameras[0]);
  // 90 degrees upwards and an aspect of 2: a point one ahead is on the rim one above or two beside the
  // middle.
  const glm::dvec4 clip = camera.clip_from_world() * glm::dvec4(2.0, -4.0, 2.0, 1.0);
  EXPECT_NEAR(clip.x / clip.w, 1.0, 1e-12);
  EXPECT_NEAR(clip.y / clip.w, 1.0, 1e-12);
  const glm::dvec4 near = camera.clip_from_world() * glm::dvec4(0.0, -4.5, 1.0, 1.0);
  EXPECT_NEAR(near.z / near.w, -1.0, 1e-12);

  ASSERT_EQ(path->walk.lights.size(), 3u);
  EXPECT_EQ(std::get<DirectionalLight>(path->walk.lights[0].light).ws_direction, glm::dvec3(0, 1, -1));
  EXPECT_EQ(path->walk.lights[0].power, glm::dvec3(3, 2, 1));
  EXPECT_EQ(std::get<PointLight>(path->walk.lights[1].light).ws_position, glm::dvec3(1, 2, 3));
  EXPECT_NEAR(std::get<SpotLight>(path->walk.lights[2].light).outer_half_angle, std::numbers::pi / 6, 1e-12);
}

TEST(CameraPathTest, NamesWhatIsWrong) {
  const std::string frame = R"("frames": [{"eye": [0, -5, 1], "target": [0, 0, 1]}])";
  const std::pair<std::string, std::string> cases[] = {
      {"", "not a JSON document"},
      {"{", "not a JSON document"},
      {"[]", "path: must be an object"},
      {"{}", "frames: an array"},
      {R"({"frames": []})", "frames: an array"},
      {R"({"frames": [7]})", "frames[0]: must be an object"},
      {R"({"frames": [{"eye": [0, 0, 0]}]})", "frames[0].target: missing"},
      {R"({"frames": [{"eye": [0, 0], "target": [0, 1, 0]}]})", "frames[0].eye: [0,0]"},
      {R"({"frames": [{"eye": [0, 0, "1"], "target": [0, 1, 0]}]})", "frames[0].eye"},
      {R"({"frames": [{"eye": [0, 0, 1e999], "target": [0, 1, 0]}]})", "not a JSON document"},
      {R"({"frames": [{"eye": [0, 0, 1], "target": [0, 0, 1]}]})", "frames[0]: the camera looks along"},
      {R"({"frames": [{"eye": [0, 0, 1], "target": [0, 0, 5]}]})", "frames[0]: the camera looks along"},
      {"{" + frame + R"(, "up": [0, 0, 0]})", "frames[0]: the camera looks along"},
      {"{" + frame + R"(, "widht": 3})", "widht: unknown member"},
      {"{" + frame + R"(, "width": 0})", "width: 0"},
      {"{" + frame + R"(, "height": 2147483648})", "height: 2147483648"},
      {"{" + frame + R"(, "width": 12.5})", "width: 12.5 is not whole"},
      {"{" + frame + R"(, "verticalFovDegrees": 180})", "verticalFovDegrees: 180"},
      {"{" + frame + R"(, "near": -1})", "near: -1"},
      {"{" + frame + R"(, "near": 5, "far": 4})", "far: 4"},
      {"{" + frame + R"(, "shadowMap": 512})", "shadowMap: must be an object"},
      {"{" + frame + R"(, "shadowMap": {"width": "big"}})", "shadowMap.width: \"big\""},
      {"{" + frame + R"(, "lights": {}})", "lights: an array"},
      {"{" + frame + R"(, "lights": [{}]})", "lights[0]: exactly one of"},
      {"{" + frame + R"(, "lights": [{"point": {"position": [0, 0, 1]}, "spot": {}}]})",
       "lights[0]: exactly one of"},
      {"{" + frame + R"(, "lights": [{"directional": {"direction": [0, 0, 0]}}]})",
       "lights[0].directional: direction"},
      {"{" + frame + R"(, "lights": [{"spot": {"position": [0, 0, 1], "direction": [0, 0, 1],
         "outerHalfAngleDegrees": 95}}]})",
       "lights[0].spot.outerHalfAngleDegrees: 95"},
  };
  for (const auto& [text, message] : cases) {
    SCOPED_TRACE(text);
    const absl::Status status = ParseCameraPath(text).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
    EXPECT_THAT(std::string(status.message()), HasSubstr(message));
  }
  std::string many = "{" + frame + ", \"lights\": [";
  for (int i = 0; i < 33; ++i)
    many += std::string(i > 0 ? "," : "") + R"({"point": {"position": [0, 0, 1]}})";
  EXPECT_THAT(std::string(ParseCameraPath(many + "]}").status().message()), HasSubstr("at most 32 lights"));
}

}  // namespace
}  // namespace shadowfit
