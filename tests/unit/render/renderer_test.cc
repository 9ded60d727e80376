#include "client/render/renderer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <glm/gtc/matrix_transform.hpp>
#include <limits>
#include <numbers>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/fit/frame_optimizer.h"
#include "core/reference/artefacts.h"
#include "core/reference/shadow_map_test.h"
#include "core/reference/truth_scene.h"

namespace shadowfit {
namespace {

using ::testing::HasSubstr;

constexpr MapSize kScreen{320, 240};

void AddBox(Scene* scene, int material, const glm::vec3& low, const glm::vec3& high) {
  Mesh mesh;
  mesh.material = material;
  for (uint32_t i = 0; i < 8; ++i) {
    mesh.positions.emplace_back((i & 1) != 0 ? high.x : low.x, (i & 2) != 0 ? high.y : low.y,
                                (i & 4) != 0 ? high.z : low.z);
  }
  for (const glm::uvec4& q : {glm::uvec4{0, 2, 3, 1}, glm::uvec4{4, 5, 7, 6}, glm::uvec4{0, 1, 5, 4},
                              glm::uvec4{2, 6, 7, 3}, glm::uvec4{0, 4, 6, 2}, glm::uvec4{1, 3, 7, 5}}) {
    mesh.triangles.emplace_back(q.x, q.y, q.z);
    mesh.triangles.emplace_back(q.x, q.z, q.w);
  }
  scene->instances.push_back({static_cast<int>(scene->meshes.size()), glm::mat4x3(1.0f)});
  scene->meshes.push_back(std::move(mesh));
}

/// An upright card in the plane y = `y`, whose texture repeats twice in each direction.
void AddCard(Scene* scene, int material, float x, float y, float size) {
  Mesh mesh;
  mesh.material = material;
  mesh.positions = {
      {x, y, 0.2f}, {x + size, y, 0.2f}, {x + size, y + 0.3f, 0.2f + size}, {x, y + 0.3f, 0.2f + size}};
  mesh.uvs = {{0, 0}, {2, 0}, {2, 2}, {0, 2}};
  mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
  scene->instances.push_back({static_cast<int>(scene->meshes.size()), glm::mat4x3(1.0f)});
  scene->meshes.push_back(std::move(mesh));
}

/// A floor with posts, blocks and two foliage cards of ragged holes.
Scene Courtyard() {
  Scene scene;
  scene.name = "courtyard";
  scene.materials.resize(3);
  scene.materials[1].alpha_texture = 0;
  scene.materials[2].transmittance = glm::vec3(0.9f);  // Glass: seen, but it casts no shadow.
  AlphaTexture holes{12, 10, {}};
  for (int y = 0; y < holes.height; ++y) {
    for (int x = 0; x < holes.width; ++x) {
      holes.alpha.push_back(static_cast<uint8_t>((x * x * 31 + y * y * 17 + x * y * 7) % 256));
    }
  }
  scene.alpha_textures.push_back(holes);
  AddBox(&scene, 0, {-12, -12, -0.5f}, {12, 12, 0});
  for (int i = 0; i < 7; ++i) {
    const float x = -6.0f + 2.0f * static_cast<float>(i);
    AddBox(&scene, 0, {x, 3, 0}, {x + 0.12f, 3.12f, 2.5f});
  }
  AddBox(&scene, 0, {-4, -1, 0}, {-2.5f, 0.5f, 1.5f});
  AddBox(&scene, 0, {1, 1, 1.2f}, {4, 1.3f, 1.3f});
  AddBox(&scene, 2, {-1, -4, 0}, {0, -3.9f, 2});
  AddCard(&scene, 1, -1.5f, -1.0f, 2.0f);
  AddCard(&scene, 1, 3.0f, -2.0f, 1.5f);
  return scene;
}

Camera TestCamera(const glm::dvec3& ws_eye = {7, -9, 3.2}) {
  CameraMatrices matrices;
  matrices.view_from_world = glm::lookAt(ws_eye, glm::dvec3(0, 1, 0.6), glm::dvec3(0, 0, 1));
  matrices.clip_from_view =
      glm::perspective(glm::radians(60.0), double(kScreen.width) / kScreen.height, 0.2, 100.0);
  return *Camera::Create(matrices);
}

std::vector<Light> TestLights() {
  return {DirectionalLight{{0.7, 0.9, -0.8}}, PointLight{{-6, -4.7, 4.5}},
          SpotLight{{2, -6, 5}, {-0.3, 0.9, -0.7}, 0.8}};
}

/// Matrices for these samples, as a client with its service would get them.
FrameSummary Fit(const Camera& camera, const SampleBuffers& samples, const std::vector<Light>& lights,
                 MapSize size, bool with_bits) {
  FrameRequest request;
  request.camera = {camera.view_from_world(), camera.clip_from_view(), camera.clip_depth()};
  request.depth = samples.Depth();
  if (with_bits) request.bits = samples.Bits();
  request.screen = kScreen;
  for (size_t i = 0; i < lights.size(); ++i) {
    request.lights.push_back({static_cast<uint32_t>(i), lights[i], size, std::nullopt});
  }
  Options options;
  options.method = Method::kPaper;
  FrameSummary summary;
  FrameOptimizer optimizer;
  EXPECT_TRUE(optimizer.Optimize(request, options, Cancellation(), &summary).ok());
  return summary;
}

class RendererTest : public ::testing::Test {
 protected:
  void SetUp() override {
    scene_ = Courtyard();
    absl::StatusOr<std::unique_ptr<Renderer>> renderer = Renderer::Create(scene_, {kScreen, {160, 120}});
    ASSERT_TRUE(renderer.ok()) << renderer.status();
    renderer_ = *std::move(renderer);
    lights_ = TestLights();
  }

  ShadowMaps DrawMaps(const FrameSummary& fit, MapSize size) {
    std::vector<LightView> views;
    for (size_t i = 0; i < lights_.size(); ++i) {
      views.push_back({lights_[i], glm::dvec3(1.0), fit.lights[i].clip_from_world, size});
    }
    absl::StatusOr<ShadowMaps> maps = renderer_->CreateShadowMaps(std::vector<MapSize>(lights_.size(), size));
    EXPECT_TRUE(maps.ok()) << maps.status();
    EXPECT_TRUE(renderer_->DrawShadowMaps(views, &*maps).ok());
    return *std::move(maps);
  }

  /// Maps fitted to all that the camera sees.
  ShadowMaps DrawFittedMaps(const Camera& camera, MapSize size, FrameSummary* fit) {
    absl::StatusOr<ShadowMaps> none = renderer_->CreateShadowMaps(std::vector<MapSize>(1, MapSize{1, 1}));
    EXPECT_TRUE(none.ok());
    SampleBuffers samples;
    EXPECT_TRUE(renderer_->DrawSamples(camera, *none, &samples).ok());
    *fit = Fit(camera, samples, lights_, size, false);
    return DrawMaps(*fit, size);
  }

  Scene scene_;
  std::unique_ptr<Renderer> renderer_;
  std::vector<Light> lights_;
};

TEST_F(RendererTest, DepthAndHolesAgreeWithRays) {
  const absl::StatusOr<TruthScene> truth = TruthScene::Create(scene_);
  ASSERT_TRUE(truth.ok());
  FrameSummary fit;
  const Camera camera = TestCamera();
  const ShadowMaps maps = DrawFittedMaps(camera, {64, 64}, &fit);
  SampleBuffers buffers;
  ASSERT_TRUE(renderer_->DrawShadowBits(camera, maps, &buffers).ok());
  const VisibleSurface surface = truth->RenderSurface(camera, kScreen.width, kScreen.height);
  ASSERT_EQ(buffers.depth.size(), surface.size());
  int seen = 0;
  int different = 0;
  for (size_t i = 0; i < surface.size(); ++i) {
    const bool visible = surface.primitive[i] != kNoPrimitive;
    seen += visible ? 1 : 0;
    const bool same =
        visible ? std::abs(buffers.depth[i] - surface.depth[i]) < 1e-5f : buffers.depth[i] == 1.0f;
    different += same ? 0 : 1;
  }
  EXPECT_GT(seen, 30000);
  // Rasterisers place vertices on a grid of 1/256 pixel, so pixel centres on silhouettes may fall to the
  // other side.
  EXPECT_LE(different, 60) << "of " << surface.size() << " pixels";
}

TEST_F(RendererTest, ShadowMapsHoldTheFirstCasterOfEachRay) {
  const absl::StatusOr<TruthScene> truth = TruthScene::Create(scene_);
  ASSERT_TRUE(truth.ok());
  constexpr MapSize kMap{128, 96};
  FrameSummary fit;
  const ShadowMaps maps = DrawFittedMaps(TestCamera(), kMap, &fit);
  for (size_t light = 0; light < lights_.size(); ++light) {
    SCOPED_TRACE(light);
    const RaySpace space = *RaySpace::Create(lights_[light]);
    const absl::StatusOr<CasterMap> expected = truth->RenderCasters(space, fit.lights[light].projection);
    ASSERT_TRUE(expected.ok());
    const std::vector<float> depth = maps.ReadDepth(static_cast<int>(light));
    const glm::dmat4& clip_from_world = fit.lights[light].clip_from_world;
    int different = 0;
    for (int y = 0; y < kMap.height; ++y) {
      for (int x = 0; x < kMap.width; ++x) {
        const auto i = static_cast<size_t>(y * kMap.width + x);
        double window_depth = 1.0;
        if (expected->primitive[i] != kNoPrimitive) {
          const RaySpace::WsRay ray = expected->TexelRay(space, x, y);
          const glm::dvec4 clip =
              clip_from_world * glm::dvec4(ray.origin + expected->along_ray[i] * ray.direction, 1.0);
          window_depth = glm::clamp(0.5 * clip.z / clip.w + 0.5, 0.0, 1.0);  // Pressed onto the near plane.
        }
        different += std::abs(depth[i] - window_depth) < 2e-5 ? 0 : 1;
      }
    }
    EXPECT_LE(different, kMap.width * kMap.height / 100);
  }
}

TEST_F(RendererTest, ShadowBitsAgreeWithTheReferenceMapTest) {
  const absl::StatusOr<TruthScene> truth = TruthScene::Create(scene_);
  ASSERT_TRUE(truth.ok());
  const Camera camera = TestCamera();
  FrameSummary fit;
  const ShadowMaps maps = DrawFittedMaps(camera, {96, 128}, &fit);
  SampleBuffers buffers;
  ASSERT_TRUE(renderer_->DrawShadowBits(camera, maps, &buffers).ok());
  const VisibleSurface surface = truth->RenderSurface(camera, kScreen.width, kScreen.height);
  for (size_t light = 0; light < lights_.size(); ++light) {
    SCOPED_TRACE(light);
    const RaySpace space = *RaySpace::Create(lights_[light]);
    const ShadowMask mask = truth->TrueShadow(surface, space);
    const ShadowProjection projection = fit.lights[light].projection;
    const absl::StatusOr<ShadowMask> expected =
        ShadowFromMaps(*truth, surface, mask, space, std::span(&projection, 1));
    ASSERT_TRUE(expected.ok());
    int shadowed = 0;
    int different = 0;
    for (size_t i = 0; i < surface.size(); ++i) {
      const bool bit = (buffers.bits[i] >> light & 1u) != 0;
      shadowed += bit ? 1 : 0;
      different += bit != ((*expected)[i] == PixelLight::kShadowed) ? 1 : 0;
    }
    EXPECT_GT(shadowed, 500) << "the scene must have shadows for the comparison to mean anything";
    const int wrong = CountWrongPixels(mask, *expected);
    EXPECT_GT(wrong, 200) << "the map must be coarse enough to be wrong somewhere";
    RecordProperty("light" + std::to_string(light),
                   std::to_string(different) + " different, " + std::to_string(wrong) + " wrong");
    // Where the rasteriser and rays disagree is a small part of what aliasing gets wrong.
    EXPECT_LE(different, wrong / 20) << wrong << " wrong pixels";
  }
}

/// The renderer and the reference make and compare standard maps by the same options.
TEST_F(RendererTest, StandardTestsAgreeWithTheReference) {
  const absl::StatusOr<TruthScene> truth = TruthScene::Create(scene_);
  ASSERT_TRUE(truth.ok());
  const Camera camera = TestCamera();
  constexpr MapSize kMap{160, 128};
  FrameSummary fit;
  const ShadowMaps exact = DrawFittedMaps(camera, kMap, &fit);
  const VisibleSurface surface = truth->RenderSurface(camera, kScreen.width, kScreen.height);
  std::vector<ShadowMask> lit_by;
  for (const Light& light : lights_) lit_by.push_back(truth->TrueShadow(surface, *RaySpace::Create(light)));

  const auto compare = [&](const StandardTest& test, bool mirrored) {
    std::vector<LightView> views(exact.lights().begin(), exact.lights().end());
    absl::StatusOr<ShadowMaps> maps =
        renderer_->CreateShadowMaps(std::vector<MapSize>(lights_.size(), kMap), test.format);
    ASSERT_TRUE(maps.ok()) << maps.status();
    for (LightView& view : views) {
      view.test = test;
      if (mirrored)
        view.clip_from_world = glm::dmat4(glm::dvec4(-1, 0, 0, 0), glm::dvec4(0, 1, 0, 0),
                                          glm::dvec4(0, 0, 1, 0), glm::dvec4(0, 0, 0, 1)) *
                               view.clip_from_world;
    }
    ASSERT_TRUE(renderer_->DrawShadowMaps(views, &*maps).ok());
    SampleBuffers buffers;
    ASSERT_TRUE(renderer_->DrawShadowBits(camera, *maps, &buffers).ok());
    for (size_t light = 0; light < lights_.size(); ++light) {
      SCOPED_TRACE(light);
      const RaySpace space = *RaySpace::Create(lights_[light]);
      ShadowProjection projection;
      ASSERT_TRUE(ProjectionFromClip(space, views[light].clip_from_world, kMap, &projection));
      const absl::StatusOr<StandardMap> map =
          RenderStandardMap(*truth, space, projection, fit.lights[light].depth_range, test.casters);
      ASSERT_TRUE(map.ok());
      const ShadowMask expected = ShadowFromStandardMap(*map, test, surface, lit_by[light], space);
      int shadowed = 0;
      int different = 0;
      for (size_t i = 0; i < surface.size(); ++i) {
        if (expected[i] == PixelLight::kNotConcerned) continue;
        const bool bit = (buffers.bits[i] >> light & 1u) != 0;
        shadowed += bit ? 1 : 0;
        different += bit != (expected[i] == PixelLight::kShadowed) ? 1 : 0;
      }
      EXPECT_GT(shadowed, 100);
      EXPECT_LE(different, 150 + shadowed / 50) << shadowed << " shadowed";
    }
  };
  using enum BiasKind;
  for (const CasterFaces faces : {CasterFaces::kBoth, CasterFaces::kFront, CasterFaces::kBack}) {
    for (const bool mirrored : {false, true}) {
      SCOPED_TRACE(absl::StrCat("faces ", static_cast<int>(faces), mirrored ? " mirrored" : ""));
      compare({DepthFormat::kFloat32, kSlopeScaled, 1e-4, 1.0, 0, faces}, mirrored);
    }
  }
  for (const int radius : {0, 1, 3}) {
    SCOPED_TRACE(absl::StrCat("radius ", radius));
    compare({DepthFormat::kFloat32, kConstant, 0.004, 0.0, radius}, false);
    compare({DepthFormat::kFloat32, kSlopeScaled, 1e-4, 0.5 + 0.5 * radius, radius}, false);
    compare({DepthFormat::kFloat32, kReceiverPlane, 1e-5, 0.0, radius}, false);
  }
  StandardTest tent{DepthFormat::kFloat32, kSlopeScaled, 1e-4, 1.5, 2};
  tent.kernel = PcfKernel::kTent;
  tent.clamp = 0.02;
  compare(tent, false);
  compare({DepthFormat::kUnorm24, kReceiverPlane, 1e-5, 0.0, 0}, false);
  compare({DepthFormat::kUnorm16, kConstant, 0.004, 0.0, 0}, false);
}

TEST_F(RendererTest, FineMapsApproachTheTruth) {
  const absl::StatusOr<TruthScene> truth = TruthScene::Create(scene_);
  ASSERT_TRUE(truth.ok());
  const Camera camera = TestCamera();
  const VisibleSurface surface = truth->RenderSurface(camera, kScreen.width, kScreen.height);
  std::vector<int> wrong_of_size;
  for (const int side : {64, 256, 1024}) {
    FrameSummary fit;
    const ShadowMaps maps = DrawFittedMaps(camera, {side, side}, &fit);
    SampleBuffers buffers;
    ASSERT_TRUE(renderer_->DrawShadowBits(camera, maps, &buffers).ok());
    int wrong = 0;
    for (size_t light = 0; light < lights_.size(); ++light) {
      const ShadowMask mask = truth->TrueShadow(surface, *RaySpace::Create(lights_[light]));
      for (size_t i = 0; i < surface.size(); ++i) {
        const bool bit = (buffers.bits[i] >> light & 1u) != 0;
        wrong += bit != (mask[i] == PixelLight::kShadowed) ? 1 : 0;
      }
    }
    wrong_of_size.push_back(wrong);
  }
  EXPECT_LT(wrong_of_size[1] * 2, wrong_of_size[0]);
  EXPECT_LT(wrong_of_size[2] * 2, wrong_of_size[1]);
}

TEST_F(RendererTest, CastersBeforeTheNearPlaneAreNotClipped) {
  const Camera camera = TestCamera();
  FrameSummary fit;
  ShadowMaps maps = DrawFittedMaps(camera, {128, 128}, &fit);
  SampleBuffers expected;
  ASSERT_TRUE(renderer_->DrawShadowBits(camera, maps, &expected).ok());
  // A depth range that starts at the floor puts every caster before the near plane.
  const RaySpace space = *RaySpace::Create(lights_[0]);
  const double w = fit.lights[0].projection.TexelFromRay(space.RayFromPoint({0, 0, 0})).z;
  DepthRange range = fit.lights[0].depth_range;
  range.near_q_over_w = range.far_q_over_w - 1e-6 * std::abs(w);
  std::vector<LightView> views(maps.lights().begin(), maps.lights().end());
  views[0].clip_from_world =
      ClipFromWorld(space, fit.lights[0].projection, range, ClipDepth::kNegativeOneToOne);
  ASSERT_TRUE(renderer_->DrawShadowMaps(views, &maps).ok());
  const std::vector<float> depth = maps.ReadDepth(0);
  int blocked = 0;
  for (const float d : depth) blocked += d == 0.0f ? 1 : 0;
  EXPECT_GT(blocked, 1000) << "casters are pressed onto the near plane";
}

TEST_F(RendererTest, BitsMarkOnlySurfacesThatTheLightConcerns) {
  const absl::StatusOr<TruthScene> truth = TruthScene::Create(scene_);
  ASSERT_TRUE(truth.ok());
  const Camera camera = TestCamera();
  FrameSummary fit;
  const ShadowMaps maps = DrawFittedMaps(camera, {64, 64}, &fit);
  SampleBuffers buffers;
  ASSERT_TRUE(renderer_->DrawShadowBits(camera, maps, &buffers).ok());
  const VisibleSurface surface = truth->RenderSurface(camera, kScreen.width, kScreen.height);
  for (size_t light = 0; light < lights_.size(); ++light) {
    const ShadowMask mask = truth->TrueShadow(surface, *RaySpace::Create(lights_[light]));
    int unconcerned = 0;
    int bits = 0;
    for (size_t i = 0; i < surface.size(); ++i) {
      if (mask[i] != PixelLight::kNotConcerned) continue;
      ++unconcerned;
      bits += static_cast<int>(buffers.bits[i] >> light & 1u);
    }
    EXPECT_GT(unconcerned, 500);
    EXPECT_LE(bits, unconcerned / 100);
  }
}

TEST_F(RendererTest, PicturesShowShadowsAndSky) {
  const Camera camera = TestCamera();
  FrameSummary fit;
  const ShadowMaps maps = DrawFittedMaps(camera, {512, 512}, &fit);
  const absl::StatusOr<Picture> picture = renderer_->DrawPicture(camera, maps);
  ASSERT_TRUE(picture.ok()) << picture.status();
  SampleBuffers buffers;
  ASSERT_TRUE(renderer_->DrawShadowBits(camera, maps, &buffers).ok());
  double brightness[2] = {0, 0};
  int count[2] = {0, 0};
  for (size_t i = 0; i < buffers.bits.size(); ++i) {
    if (buffers.depth[i] == 1.0f) continue;
    const bool shadowed = (buffers.bits[i] & 1u) != 0;
    brightness[shadowed] += picture->rgb[3 * i] + picture->rgb[3 * i + 1] + picture->rgb[3 * i + 2];
    ++count[shadowed];
  }
  EXPECT_LT(brightness[1] / count[1] * 1.2, brightness[0] / count[0]);
  const uint8_t* top_left = &picture->rgb[3 * static_cast<size_t>(kScreen.width * (kScreen.height - 1))];
  EXPECT_GT(top_left[2], top_left[0]) << "the sky is blue";

  const absl::StatusOr<Picture> again = renderer_->DrawPicture(camera, maps);
  ASSERT_TRUE(again.ok());
  EXPECT_EQ(picture->rgb, again->rgb);
}

TEST_F(RendererTest, RefusesBadInput) {
  EXPECT_EQ(Renderer::Create(scene_, {{0, 240}, {160, 120}}).status().code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(Renderer::Create(scene_, {{320, 240}, {160, 1 << 24}}).status().message(),
              HasSubstr("samples"));
  Scene broken = scene_;
  broken.meshes[0].triangles[0].x = 1000;
  EXPECT_THAT(Renderer::Create(broken, {kScreen, {160, 120}}).status().message(), HasSubstr("meshes[0]"));

  ASSERT_TRUE(Renderer::Create(Scene(), {kScreen, {160, 120}}).ok()) << "an empty scene is a scene";
  SetUp();  // The renderer that was made last owns the thread's context.
  EXPECT_THAT(renderer_->CreateShadowMaps({}).status().message(), HasSubstr("lights: 0"));
  EXPECT_EQ(renderer_->CreateShadowMaps(std::vector<MapSize>(33, MapSize{8, 8})).status().code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(renderer_->CreateShadowMaps(std::vector<MapSize>{{8, 8}, {8, -1}}).status().message(),
              HasSubstr("lights[1].map_size"));
  absl::StatusOr<ShadowMaps> maps = renderer_->CreateShadowMaps(std::vector<MapSize>{{8, 8}});
  ASSERT_TRUE(maps.ok());
  LightView view{PointLight{{0, 0, 3}}, glm::dvec3(1.0), glm::dmat4(1.0), {8, 8}};
  EXPECT_TRUE(renderer_->DrawShadowMaps(std::vector<LightView>{view}, &*maps).ok());
  EXPECT_FALSE(renderer_->DrawShadowMaps(std::vector<LightView>{view, view}, &*maps).ok());
  view.clip_from_world[2][3] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(renderer_->DrawShadowMaps(std::vector<LightView>{view}, &*maps).message(),
              HasSubstr("lights[0].clip_from_world[11]"));
  view.clip_from_world = glm::dmat4(1.0);
  view.light = SpotLight{{0, 0, 3}, {0, 0, 0}, 0.5};
  EXPECT_THAT(renderer_->DrawShadowMaps(std::vector<LightView>{view}, &*maps).message(),
              HasSubstr("lights[0].direction"));
  view.light = PointLight{{0, 0, 3}};
  view.test = StandardTest{.format = DepthFormat::kUnorm16};
  EXPECT_THAT(renderer_->DrawShadowMaps(std::vector<LightView>{view}, &*maps).message(),
              HasSubstr("lights[0].test.format"));
  view.test = StandardTest{.pcf_radius = 17};
  EXPECT_THAT(renderer_->DrawShadowMaps(std::vector<LightView>{view}, &*maps).message(),
              HasSubstr("lights[0].test.pcf_radius: 17"));
  view.test = StandardTest{.constant = std::numeric_limits<double>::infinity()};
  EXPECT_THAT(renderer_->DrawShadowMaps(std::vector<LightView>{view}, &*maps).message(),
              HasSubstr("lights[0].test.constant"));
  view.test.reset();
  view.map_size = {8, 16};
  EXPECT_THAT(renderer_->DrawShadowMaps(std::vector<LightView>{view}, &*maps).message(), HasSubstr("8x16"));
}

}  // namespace
}  // namespace shadowfit
