#include "core/reference/shadow_map_test.h"

#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "core/reference/view_study.h"
#include "test_scenes.h"

namespace shadowfit {
namespace {

/// A floor with two boxes and a thin pole.
Scene Courtyard() {
  Scene scene = SceneOf({}, {});
  AddQuad(&scene, {-10, -10, 0}, {20, 0, 0}, {0, 20, 0});
  const auto add_box = [&](glm::vec3 low, glm::vec3 size, float turn) {
    const glm::vec3 x(size.x * std::cos(turn), size.x * std::sin(turn), 0);
    const glm::vec3 y(-size.y * std::sin(turn), size.y * std::cos(turn), 0);
    const glm::vec3 z(0, 0, size.z);
    AddQuad(&scene, low, x, z);
    AddQuad(&scene, low + y, z, x);
    AddQuad(&scene, low, z, y);
    AddQuad(&scene, low + x, y, z);
    AddQuad(&scene, low + z, x, y);
  };
  add_box({-1, 2, 0}, {1.5f, 1, 1.2f}, 0.3f);
  add_box({1.5f, 0.5f, 0}, {0.8f, 0.8f, 2.0f}, -0.5f);
  add_box({0.2f, -1, 0}, {0.1f, 0.1f, 2.5f}, 0.1f);
  return scene;
}

struct Fixture {
  TruthScene scene;
  ViewStudy view;
};

Fixture MakeCourtyard(int screen) {
  TruthScene scene = *TruthScene::Create(Courtyard());
  const Camera camera = *Camera::Create(LookAt({-4, -5, 1.8}, {0, 0, 0.6}));
  ViewStudy view = ViewStudy::Create(scene, camera, {screen, screen}, {64, 64});
  return {std::move(scene), std::move(view)};
}

/// The map of a light that looks along the third ray coordinate.
ShadowProjection MapOf(const LightStudy& light, int size) {
  if (light.ray_space.is_directional()) {
    ShadowProjection projection = CenteredMap(size, 12.0);
    return projection;
  }
  // A perspective map around the direction to the world's origin.
  const glm::dvec3 axis = glm::normalize(light.ray_space.RayFromPoint(glm::dvec3(0.0)));
  const glm::dvec3 b1 = glm::normalize(glm::cross(axis, glm::dvec3(0.1, 1.0, 0.3)));
  const glm::dvec3 b2 = glm::cross(axis, b1);
  const double scale = 0.5 * size / 1.7;
  ShadowProjection projection;
  projection.texel_from_ray =
      glm::transpose(glm::dmat3(scale * b1 + 0.5 * size * axis, scale * b2 + 0.5 * size * axis, axis));
  projection.size = {size, size};
  return projection;
}

TEST(ShadowMapTestTest, ATessellatedTroughDoesNotShadowItself) {
  // A half pipe of 24 flat strips under the sun at noon: its neighbours rise above every strip's plane, and
  // hide nothing of it. A coarse map sees strip and neighbour in one texel.
  Scene scene = SceneOf({}, {});
  constexpr int kStrips = 24;
  const auto rim = [](int i) {
    const double angle = M_PI * (1.0 + static_cast<double>(i) / kStrips);
    return glm::vec3(0.0, 2.0 * std::cos(angle), 2.0 + 2.0 * std::sin(angle));
  };
  for (int i = 0; i < kStrips; ++i)
    AddQuad(&scene, rim(i) - glm::vec3(4, 0, 0), {8, 0, 0}, rim(i + 1) - rim(i));
  const TruthScene truth = *TruthScene::Create(scene);
  const Camera camera = *Camera::Create(LookAt({-6, 0, 5}, {0, 0, 0.5}));
  const ViewStudy view = ViewStudy::Create(truth, camera, {200, 200}, {64, 64});
  const LightStudy study = *LightStudy::Create(truth, view, DirectionalLight{{0.05, 0.02, -1.0}});
  ASSERT_GT(study.concerned_pixels, 3000);
  const ShadowProjection map = CenteredMap(64, 8.0);
  EXPECT_LT(*WrongPixels(truth, view, study, {&map, 1}), study.concerned_pixels / 100);
}

TEST(ShadowMapTestTest, AGrazedWallIsShadowedByWhatIsFar) {
  // A wall that the sun grazes at 1.1 degrees, wholly in the shadow of a roof 14 metres and more above: a
  // texel reaches 10 metres along the wall, over which no facet of a curved wall could hide the sun.
  Scene scene = SceneOf({}, {});
  AddQuad(&scene, {-3, 0, 6}, {6, 0, 0}, {0, 0, -6});
  AddQuad(&scene, {-8, -4, 20}, {16, 0, 0}, {0, 8, 0});
  const TruthScene truth = *TruthScene::Create(scene);
  const Camera camera = *Camera::Create(LookAt({0.5, 8, 3}, {0, 0, 3}));
  const ViewStudy view = ViewStudy::Create(truth, camera, {100, 100}, {64, 64});
  const LightStudy study = *LightStudy::Create(truth, view, DirectionalLight{{0.0, -0.02, -1.0}});
  ASSERT_GT(study.shadowed_pixels, 1000);
  ASSERT_EQ(study.shadowed_pixels, study.concerned_pixels);
  const ShadowProjection map = CenteredMap(40, 8.0);
  EXPECT_EQ(*WrongPixels(truth, view, study, {&map, 1}), 0);
}

TEST(ShadowMapTestTest, WrongPixelsFallWithTheSquareRootOfTheTexels) {
  const Fixture court = MakeCourtyard(300);
  for (const Light& light :
       {Light(PointLight{{3, 4, 7}}), Light(SpotLight{{-5, 3, 6}, {0.5, -0.2, -0.7}, 0.7}),
        Light(DirectionalLight{{0.4, -0.6, -1.0}})}) {
    const LightStudy study = *LightStudy::Create(court.scene, court.view, light);
    ASSERT_GT(study.shadowed_pixels, 500);
    std::vector<double> wrong;
    for (const int size : {128, 512, 2048}) {
      const ShadowProjection map = MapOf(study, size);
      wrong.push_back(*WrongPixels(court.scene, court.view, study, {&map, 1}));
    }
    EXPECT_GT(wrong[0], 200);
    // A quarter a step in theory: the count of a single picture scatters about it.
    EXPECT_LT(wrong[1], 0.36 * wrong[0]);
    EXPECT_LT(wrong[2], 0.36 * wrong[1]);
  }
}

TEST(ShadowMapTestTest, MapOfTheCameraItselfSeesEveryPixel) {
  // Light and camera in one place, one texel for every pixel: each texel's ray is its pixel's ray.
  const Fixture court = MakeCourtyard(150);
  const Camera& camera = court.view.camera;
  const LightStudy study =
      *LightStudy::Create(court.scene, court.view, PointLight{glm::dvec3(camera.ws_eye())});
  ShadowProjection projection;
  ASSERT_TRUE(ProjectionFromClip(study.ray_space, camera.clip_from_world(), {150, 150}, &projection));
  EXPECT_EQ(study.shadowed_pixels, 0);
  EXPECT_EQ(*WrongPixels(court.scene, court.view, study, {&projection, 1}), 0);
}

TEST(ShadowMapTestTest, OutsideAndBehindTheMapIsLit) {
  const Fixture court = MakeCourtyard(100);
  const LightStudy study = *LightStudy::Create(court.scene, court.view, PointLight{{3, 4, 7}});
  ShadowProjection behind = MapOf(study, 256);
  behind.texel_from_ray = -behind.texel_from_ray;
  EXPECT_EQ(*WrongPixels(court.scene, court.view, study, {&behind, 1}), study.shadowed_pixels);
  ShadowProjection beside = MapOf(study, 256);
  for (int column = 0; column < 3; ++column) {
    beside.texel_from_ray[column][0] += 1e6 * beside.texel_from_ray[column][2];
  }
  EXPECT_EQ(*WrongPixels(court.scene, court.view, study, {&beside, 1}), study.shadowed_pixels);
  EXPECT_EQ(*WrongPixels(court.scene, court.view, study, {}), study.shadowed_pixels);
}

TEST(ShadowMapTestTest, FirstMapThatContainsAPixelDecides) {
  const Fixture court = MakeCourtyard(200);
  const LightStudy study = *LightStudy::Create(court.scene, court.view, DirectionalLight{{0.4, -0.6, -1.0}});
  const ShadowProjection whole = MapOf(study, 256);
  // The left half of the same texels as a map of its own, then the whole: nothing changes.
  ShadowProjection left = whole;
  left.size.width = 128;
  const ShadowProjection both[] = {left, whole};
  const int one_map = *WrongPixels(court.scene, court.view, study, {&whole, 1});
  EXPECT_EQ(*WrongPixels(court.scene, court.view, study, both), one_map);
  // A finer left half serves its own pixels better.
  ShadowProjection fine = left;
  for (int column = 0; column < 3; ++column) {
    fine.texel_from_ray[column][0] *= 4.0;
    fine.texel_from_ray[column][1] *= 4.0;
  }
  fine.size = {512, 1024};
  const ShadowProjection fine_first[] = {fine, whole};
  const ShadowProjection fine_last[] = {whole, fine};
  EXPECT_LT(*WrongPixels(court.scene, court.view, study, fine_first), one_map);
  EXPECT_EQ(*WrongPixels(court.scene, court.view, study, fine_last), one_map);
}

/// A half-plane caster parallel to a floor, lit straight down through an orthographic camera looking straight
/// down: the map is an affine grid over the screen, and the shadow's edge a straight line. The mean count
/// over random positions of the grid is l (s/4 + t^2/(12 s)) with s >= t the footprint's extents along the
/// edge's normal.
TEST(ShadowMapTestTest, StraightEdgeMeetsTheExpectedArea) {
  constexpr int kScreen = 256;
  std::mt19937 generator(7);
  const auto uniform = [&](double low, double high) {
    return low + (high - low) * (double(generator()) / 4294967296.0);
  };
  for (int configuration = 0; configuration < 4; ++configuration) {
    const double angle = uniform(0.0, 6.28);
    const glm::dvec2 normal(std::cos(angle), std::sin(angle));
    const glm::dvec2 tangent(-normal.y, normal.x);
    Scene scene = SceneOf({}, {});
    AddQuad(&scene, {-2, -2, 0}, {4, 0, 0}, {0, 4, 0});
    const glm::dvec2 corner = -3.0 * tangent;
    AddQuad(&scene, glm::vec3(corner.x, corner.y, 1.0f), glm::vec3(6.0 * tangent.x, 6.0 * tangent.y, 0.0f),
            glm::vec3(3.0 * normal.x, 3.0 * normal.y, 0.0f));
    const TruthScene truth = *TruthScene::Create(scene);
    CameraMatrices matrices;
    // Looks down from between the floor and the caster; world x and y are NDC.
    matrices.view_from_world = glm::translate(glm::dmat4(1.0), glm::dvec3(0.0, 0.0, -0.5));
    matrices.clip_from_view = glm::orthoRH_NO(-1.0, 1.0, -1.0, 1.0, 0.0, 2.0);
    const Camera camera = *Camera::Create(matrices);
    const ViewStudy view = ViewStudy::Create(truth, camera, {kScreen, kScreen}, {8, 8});
    const LightStudy light = *LightStudy::Create(truth, view, DirectionalLight{{0, 0, -1}});
    ASSERT_NEAR(light.shadowed_pixels, kScreen * kScreen / 2, kScreen);

    // Texel steps of 6 to 16 pixels in two independent directions.
    const double first = uniform(0.0, 6.28);
    const double second = first + uniform(0.6, 2.4);
    const double pixel = 2.0 / kScreen;
    const glm::dmat2 world_from_texel(
        pixel * uniform(6, 16) * glm::dvec2(std::cos(first), std::sin(first)),
        pixel * uniform(6, 16) * glm::dvec2(std::cos(second), std::sin(second)));
    const double e1 = std::abs(glm::dot(normal, world_from_texel[0])) / pixel;
    const double e2 = std::abs(glm::dot(normal, world_from_texel[1])) / pixel;
    const double s = std::max(e1, e2);
    const double t = std::min(e1, e2);
    const double length = kScreen / std::max(std::abs(normal.x), std::abs(normal.y));
    const double expected = length * (0.25 * s + t * t / (12.0 * s));

    // Ray coordinates of this light are world x and y up to a rotation, which G's rows tell.
    const glm::dmat3 linear = light.ray_space.linear();
    const glm::dmat2 ray_from_world(linear[0][0], linear[0][1], linear[1][0], linear[1][1]);
    const glm::dmat2 texel_from_ray = glm::inverse(ray_from_world * world_from_texel);
    double sum = 0.0;
    constexpr int kDraws = 100;
    for (int draw = 0; draw < kDraws; ++draw) {
      ShadowProjection projection;
      projection.size = {128, 128};
      const glm::dvec2 shift(64.0 + uniform(0, 1), 64.0 + uniform(0, 1));
      projection.texel_from_ray = glm::dmat3(glm::dvec3(texel_from_ray[0], 0.0),
                                             glm::dvec3(texel_from_ray[1], 0.0), glm::dvec3(shift, 1.0));
      sum += *WrongPixels(truth, view, light, {&projection, 1});
    }
    EXPECT_NEAR(sum / kDraws, expected, 0.04 * expected) << "s " << s << " t " << t;
  }
}

TEST(ViewStudyTest, BitsAreTheShadowOfTheSmallPicture) {
  const Fixture court = MakeCourtyard(120);
  const LightStudy study = *LightStudy::Create(court.scene, court.view, PointLight{{3, 4, 7}});
  const ShadowMask small = court.scene.TrueShadow(court.view.samples, study.ray_space);
  const BitsView bits = study.Bits(court.view);
  ASSERT_EQ(bits.width, 64);
  ASSERT_EQ(bits.height, 64);
  for (int y = 0; y < 64; ++y) {
    for (int x = 0; x < 64; ++x) {
      EXPECT_EQ(bits.At(x, y), small[size_t(64 * y + x)] == PixelLight::kShadowed ? 1u : 0u);
    }
  }
  std::vector<uint32_t> all(small.size(), 0xffffffffu);
  WriteBit(small, 31, &all);
  EXPECT_EQ(all[0] & 0x7fffffffu, 0x7fffffffu);
  EXPECT_EQ(std::ranges::count_if(all, [](uint32_t b) { return b >> 31 != 0; }),
            std::ranges::count(small, PixelLight::kShadowed));
}

TEST(ViewStudyTest, LightsInAwkwardPlaces) {
  const Fixture court = MakeCourtyard(120);
  // Below the floor: nothing that is seen faces it except the boxes' sides; above all inside a box.
  const LightStudy below = *LightStudy::Create(court.scene, court.view, PointLight{{0, 0, -3}});
  EXPECT_LT(below.concerned_pixels, 120 * 120 / 4);
  EXPECT_EQ(below.shadowed_pixels, below.concerned_pixels);
  const LightStudy inside = *LightStudy::Create(court.scene, court.view, PointLight{{1.8, 0.7, 0.2}});
  EXPECT_GT(inside.concerned_pixels, 0);
  EXPECT_EQ(inside.shadowed_pixels, inside.concerned_pixels);
  // In the eye: sees what the camera sees.
  const LightStudy eye =
      *LightStudy::Create(court.scene, court.view, PointLight{glm::dvec3(court.view.camera.ws_eye())});
  EXPECT_EQ(eye.shadowed_pixels, 0);
  EXPECT_GT(eye.concerned_pixels, 120 * 120 / 3);
  EXPECT_FALSE(LightStudy::Create(court.scene, court.view, DirectionalLight{{0, 0, 0}}).ok());
}

}  // namespace
}  // namespace shadowfit
