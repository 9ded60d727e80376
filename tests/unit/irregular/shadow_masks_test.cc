#include "core/irregular/shadow_masks.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <hwy/targets.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <chrono>
#include <glm/gtc/matrix_transform.hpp>
#include <limits>
#include <random>
#include <span>
#include <thread>

#include "absl/strings/str_format.h"
#include "core/scene/procedural.h"
#include "tests/unit/irregular/mask_oracle.h"
#include "tests/unit/irregular/random_scenes.h"

namespace shadowfit {
namespace {

using oracle::Answer;
using ::testing::HasSubstr;

constexpr int kWidth = 24;
constexpr int kHeight = 8;

MaskRequest RequestFor(const MaskScene& scene, const ReceiverLayer& layer, const Light& light) {
  MaskRequest request;
  request.scene = &scene;
  request.layers = {&layer, 1};
  request.lights = {&light, 1};
  return request;
}

MaskRequest RequestFor(const MaskScene& scene, const ReceiverLayer& layer, const Camera& camera,
                       std::span<const Light> lights) {
  MaskRequest request = RequestFor(scene, layer, lights[0]);
  request.camera = &camera;
  request.lights = lights;
  return request;
}

bool Bit(const LightMask& mask, int width, size_t i) {
  return mask.InShadow(0, std::numeric_limits<int>::max(), static_cast<int>(i) % width,
                       static_cast<int>(i) / width);
}

struct Rendered {
  std::vector<bool> in_shadow;
  size_t undecided = 0;

  bool operator==(const Rendered&) const = default;
};

/// Rows of `width` points each.
Rendered RenderPoints(MaskRenderer* renderer, const MaskScene& scene, const std::vector<glm::vec3>& points,
                      int width, const Light& light, MaskMethod method,
                      MaskPieces pieces = MaskPieces::kAuto) {
  const int height = static_cast<int>(points.size()) / width;
  ReceiverLayer layer;
  layer.ws_positions = BottomFirst(points.data(), width, height);
  MaskRequest request = RequestFor(scene, layer, light);
  request.method = method;
  request.pieces = pieces;
  const auto masks = renderer->Render(request);
  EXPECT_TRUE(masks.ok()) << masks.status();
  Rendered rendered;
  rendered.undecided = (*masks)[0].undecided_samples;
  for (size_t i = 0; i < points.size(); ++i) rendered.in_shadow.push_back(Bit((*masks)[0], width, i));
  return rendered;
}

/// Compares masks with brute force in extended precision, and counts.
class BruteForce {
 public:
  /// Every `step`-th of the points.
  void Compare(const Scene& scene, const Light& light, const std::vector<glm::vec3>& points,
               const std::vector<bool>& in_shadow, size_t step) {
    const auto ray_space = RaySpace::Create(light);
    ASSERT_TRUE(ray_space.ok()) << ray_space.status();
    const std::vector<oracle::Triangle> triangles = oracle::Flatten(scene);
    oracle::Real reach = 0;  // Of the points, from their centre or the world's.
    for (const glm::vec3& p : points) reach = std::max<oracle::Real>(reach, 2 * glm::length(p));
    for (size_t i = 0; i < points.size(); i += step) {
      const glm::dvec3 point(points[i]);
      if (!ray_space->Illuminates(point)) {
        EXPECT_FALSE(in_shadow[i]);
        continue;
      }
      // Directional lights measure from the points' centre, wherever that is.
      const bool directional = ray_space->is_directional();
      const oracle::Real light_distance = glm::length(point - ray_space->ws_position());
      const oracle::Real most =
          directional ? oracle::kRoundoff * 20 * reach
                      : oracle::kRoundoff * (16 * light_distance + 4 * glm::length(ray_space->ws_position()));
      const oracle::Real least = directional ? oracle::kRoundoff * 4 * glm::length(point) / 2 : most / 2;
      Answer answer = Answer::kClear;
      for (const oracle::Triangle& triangle : triangles) {
        const Answer one = oracle::Blocks(triangle, light, point, least, 1.5L * most, reach);
        if (one == Answer::kBlocked) answer = one;
        if (one == Answer::kUnsure && answer != Answer::kBlocked) answer = one;
      }
      ++compared_;
      if (answer == Answer::kUnsure) {
        ++unsure_;
        continue;
      }
      shadowed_ += answer == Answer::kBlocked;
      ASSERT_EQ(in_shadow[i], answer == Answer::kBlocked)
          << "light kind " << light.index() << " sample " << i;
    }
  }

  void ExpectManyDecided() const {
    std::cout << compared_ << " compared, " << shadowed_ << " in shadow, " << unsure_
              << " within the bound\n";
    EXPECT_GT(shadowed_, compared_ / 20);
    EXPECT_LT(unsure_, compared_ / 10);
  }

 private:
  size_t compared_ = 0, unsure_ = 0, shadowed_ = 0;
};

TEST(ShadowMasks, AgreeWithBruteForceOnRandomScenes) {
  RandomScenes scenes(7);
  MaskRenderer renderer;
  BruteForce brute_force;
  for (int n = 0; n < 1500 && !HasFatalFailure(); ++n) {
    SCOPED_TRACE(n);
    const Scene scene = scenes.Next();
    const Light light = scenes.NextLight();
    const std::vector<glm::vec3> points = scenes.Receivers(scene, kWidth * kHeight);
    const auto mask_scene = MaskScene::Create(scene);
    ASSERT_TRUE(mask_scene.ok()) << mask_scene.status();
    const Rendered rendered = RenderPoints(&renderer, *mask_scene, points, kWidth, light, MaskMethod::kGrid);
    brute_force.Compare(scene, light, points, rendered.in_shadow, 1);
  }
  brute_force.ExpectManyDecided();
}

/// So many samples that the rows of cells of one face are cut into bands, which awkward triangles cross: huge
/// and tiny ones, slivers, duplicates, some without any area, some with the light in them or at a corner.
TEST(ShadowMasks, AwkwardTrianglesCrossBands) {
  constexpr int kSide = 200;
  RandomScenes scenes(17);
  MaskRenderer frame, exhaustive;
  BruteForce brute_force;
  for (int n = 0; n < 60 && !HasFatalFailure(); ++n) {
    SCOPED_TRACE(n);
    Scene scene = scenes.Next();
    const Light light = scenes.NextLight();
    const std::vector<glm::vec3> points = scenes.Receivers(scene, size_t{kSide} * kSide);
    Mesh& mesh = scene.meshes[0];
    const glm::uvec3 first = mesh.triangles[0];
    mesh.triangles.emplace_back(first.x, first.x, first.y);
    mesh.triangles.emplace_back(first.z, first.z, first.z);
    const auto ray_space = RaySpace::Create(light);
    ASSERT_TRUE(ray_space.ok()) << ray_space.status();
    if (!ray_space->is_directional()) {
      const glm::vec3 at(ray_space->ws_position());
      const glm::vec3 a = scenes.Point(1.0), b = scenes.Point(1.0);
      const auto base = static_cast<uint32_t>(mesh.positions.size());
      for (const glm::vec3& p : {at, at + a, at + b, at - a - b}) mesh.positions.push_back(p);
      mesh.triangles.emplace_back(base, base + 1, base + 2);
      mesh.triangles.emplace_back(base + 1, base + 2, base + 3);
    }
    const auto mask_scene = MaskScene::Create(scene);
    ASSERT_TRUE(mask_scene.ok()) << mask_scene.status();
    const Rendered a =
        RenderPoints(&frame, *mask_scene, points, kSide, light, MaskMethod::kGrid, MaskPieces::kFrame);
    const Rendered b = RenderPoints(&exhaustive, *mask_scene, points, kSide, light, MaskMethod::kExhaustive);
    ASSERT_EQ(a, b);
    brute_force.Compare(scene, light, points, a.in_shadow, 53);
  }
  brute_force.ExpectManyDecided();
}

/// More runs of large triangles than are collected at a time, in a cluster that ends with small ones.
TEST(ShadowMasks, LargeTrianglesDoNotKeepSmallOnesFromTheirSamples) {
  constexpr int kPieceWidth = 256, kPieceHeight = 128;
  constexpr uint32_t kLarge = 40, kSmall = 24;
  std::mt19937 random(5);
  std::uniform_real_distribution<float> unit(0.0f, 1.0f);
  std::vector<glm::vec3> positions, points;
  std::vector<glm::uvec3> triangles;
  const auto add = [&](const glm::vec3& at, float size) {
    const auto base = static_cast<uint32_t>(positions.size());
    positions.insert(positions.end(), {at + glm::vec3(-size, -size, 0), at + glm::vec3(size, -size, 0),
                                       at + glm::vec3(0, size, 0)});
    triangles.emplace_back(base, base + 1, base + 2);
  };
  // Clusters are in Morton order: the lower ones come first.
  for (uint32_t i = 0; i < kLarge; ++i) add({unit(random), unit(random), 0.2f * unit(random)}, 8.0f);
  for (uint32_t i = 0; i < kSmall; ++i)
    add({8.0f * unit(random) - 4.0f, 8.0f * unit(random) - 4.0f, 6.0f}, 0.2f);
  for (int i = 0; i < kPieceWidth * kPieceHeight; ++i) {
    points.emplace_back(16.0f * unit(random) - 8.0f, 16.0f * unit(random) - 8.0f, 0.1f + unit(random));
  }
  const auto mask_scene = MaskScene::Create(OneMeshScene(std::move(positions), std::move(triangles)));
  ASSERT_TRUE(mask_scene.ok()) << mask_scene.status();
  const Light light = PointLight{{0.0, 0.0, 20.0}};
  MaskRenderer renderer;
  const Rendered grid =
      RenderPoints(&renderer, *mask_scene, points, kPieceWidth, light, MaskMethod::kGrid, MaskPieces::kSmall);
  EXPECT_EQ(grid, RenderPoints(&renderer, *mask_scene, points, kPieceWidth, light, MaskMethod::kExhaustive));
  EXPECT_GT(std::count(grid.in_shadow.begin(), grid.in_shadow.end(), true), 100);
}

TEST(ShadowMasks, OneSampleUnderATriangleAllAroundTheLight) {
  // No extent to cut rows of, and a caster that the light's plane of every face crosses.
  Scene scene;
  scene.materials.emplace_back();
  Mesh& mesh = scene.meshes.emplace_back();
  mesh.positions = {{-50, -40, 1}, {60, -40, 1}, {0, 70, 1}};
  mesh.triangles = {{0, 1, 2}};
  scene.instances.emplace_back().mesh = 0;
  const auto mask_scene = MaskScene::Create(scene);
  ASSERT_TRUE(mask_scene.ok()) << mask_scene.status();
  MaskRenderer renderer;
  for (const double light_z : {1.0 + 1e-7, 1.5, 30.0}) {
    for (const glm::vec3& point : {glm::vec3(0, 0, 0), glm::vec3(3, -2, 0.5f)}) {
      const Light light = PointLight{{0.5, 0.25, light_z}};
      for (const MaskPieces pieces : {MaskPieces::kSmall, MaskPieces::kFrame}) {
        const Rendered rendered =
            RenderPoints(&renderer, *mask_scene, {point}, 1, light, MaskMethod::kGrid, pieces);
        EXPECT_EQ(rendered.in_shadow, std::vector<bool>{true}) << light_z;
      }
    }
  }
}

TEST(ShadowMasks, EveryMethodGivesTheSameBits) {
  RandomScenes scenes(11);
  MaskRenderer grid, bsp, exhaustive;
  for (int n = 0; n < 1000; ++n) {
    const Scene scene = scenes.Next();
    const Light light = scenes.NextLight();
    const std::vector<glm::vec3> points = scenes.Receivers(scene, kWidth * kHeight);
    const auto mask_scene = MaskScene::Create(scene);
    ASSERT_TRUE(mask_scene.ok()) << mask_scene.status();
    const Rendered a = RenderPoints(&grid, *mask_scene, points, kWidth, light, MaskMethod::kGrid);
    const Rendered b = RenderPoints(&bsp, *mask_scene, points, kWidth, light, MaskMethod::kBsp);
    const Rendered c = RenderPoints(&exhaustive, *mask_scene, points, kWidth, light, MaskMethod::kExhaustive);
    ASSERT_EQ(a, c) << "scene " << n << " light kind " << light.index();
    ASSERT_EQ(b, c) << "scene " << n << " light kind " << light.index();
  }
}

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

/// Exact products, where no caster is within the bound.
TEST(ShadowMasks, TransmittanceIsTheProductOverBlockers) {
  RandomScenes scenes(23);
  MaskRenderer renderer;
  size_t compared = 0, partial = 0;
  for (int n = 0; n < 250; ++n) {
    Scene scene = scenes.Next();
    const Light light = PointLight{glm::dvec3(scenes.Point(2.0))};
    const std::vector<glm::vec3> points = scenes.Receivers(scene, kWidth * kHeight);
    scene.materials.resize(4);
    scene.materials[1].transmittance = {0.5f, 0.25f, 0.9f};
    scene.materials[2].transmittance = {0.0f, 1.0f, 0.7f};
    scene.materials[3].transmittance = {1.0f, 1.0f, 1.0f};
    // One mesh a triangle, of any material.
    const Mesh all = scene.meshes[0];
    scene.meshes.clear();
    scene.instances.clear();
    for (const glm::uvec3& t : all.triangles) {
      Mesh& mesh = scene.meshes.emplace_back();
      mesh.positions = all.positions;
      mesh.triangles = {t};
      mesh.material = scenes.Int(0, 9) == 0 ? 0 : scenes.Int(1, 3);
      scene.instances.emplace_back().mesh = static_cast<int>(scene.meshes.size()) - 1;
    }
    const auto mask_scene = MaskScene::Create(scene);
    ASSERT_TRUE(mask_scene.ok()) << mask_scene.status();
    EXPECT_EQ(mask_scene->HasTransmittance(), std::any_of(scene.meshes.begin(), scene.meshes.end(),
                                                          [](const Mesh& m) { return m.material != 0; }));
    ReceiverLayer layer;
    layer.ws_positions = BottomFirst(points.data(), kWidth, kHeight);
    MaskRequest request = RequestFor(*mask_scene, layer, light);
    request.output = MaskOutput::kTransmittance;
    std::vector<uint8_t> first;
    for (const MaskMethod method : {MaskMethod::kGrid, MaskMethod::kBsp}) {
      request.method = method;
      const auto masks = renderer.Render(request);
      ASSERT_TRUE(masks.ok()) << masks.status();
      const LightMask& mask = (*masks)[0];
      ASSERT_EQ(mask.rgb.size(), points.size() * 3);
      if (method == MaskMethod::kGrid) {
        first.assign(mask.rgb.begin(), mask.rgb.end());
      } else {
        ASSERT_TRUE(std::equal(first.begin(), first.end(), mask.rgb.begin()));
      }
      const std::vector<oracle::Triangle> triangles = oracle::Flatten(scene);
      const glm::dvec3 position = std::get<PointLight>(light).ws_position;
      for (size_t i = 0; i < points.size(); ++i) {
        const glm::dvec3 point(points[i]);
        const oracle::Real bound =
            oracle::kRoundoff * (16 * glm::length(point - position) + 4 * glm::length(position));
        glm::dvec3 product(1.0);
        bool sure = true;
        for (const oracle::Triangle& triangle : triangles) {
          const Answer answer = oracle::Blocks(triangle, light, point, bound / 2, 1.5L * bound, 0);
          sure = sure && answer != Answer::kUnsure;
          if (answer == Answer::kBlocked) {
            product *= glm::dvec3(scene.materials[static_cast<size_t>(triangle.material)].transmittance);
          }
        }
        if (!sure) continue;
        ++compared;
        partial += product.x > 0.0 && product.x < 1.0;
        for (int channel = 0; channel < 3; ++channel) {
          // Half a step of RGB8, and what the fixed-point logarithms round away.
          ASSERT_NEAR(mask.rgb[3 * i + static_cast<size_t>(channel)], 255.0 * product[channel], 0.55)
              << "scene " << n << " sample " << i << " channel " << channel;
        }
      }
    }
  }
  EXPECT_GT(partial, compared / 50);
}

/// A closed half-transparent sphere around the light: every ray must meet it exactly once, those through its
/// edges and corners too.
TEST(ShadowMasks, SharedEdgesCountExactlyOnce) {
  for (const bool axis_aligned : {false, true}) {
    Scene scene;
    scene.materials.emplace_back().transmittance = glm::vec3(0.5f);
    Mesh& mesh = scene.meshes.emplace_back();
    scene.instances.emplace_back();
    constexpr int kCells = 16;
    // A cube of quads, blown up to a sphere or left with its planes, so that edge functions are exactly zero.
    for (int side = 0; side < 6; ++side) {
      for (int j = 0; j < kCells; ++j) {
        for (int i = 0; i < kCells; ++i) {
          glm::vec3 corner[4];
          for (int k = 0; k < 4; ++k) {
            const float a = 2.0f * static_cast<float>(i + (k == 1 || k == 2)) / kCells - 1.0f;
            const float b = 2.0f * static_cast<float>(j + (k >= 2)) / kCells - 1.0f;
            glm::vec3 p(0.0f);
            p[side / 2] = side % 2 == 0 ? 1.0f : -1.0f;
            p[(side / 2 + 1) % 3] = a;
            p[(side / 2 + 2) % 3] = b;
            corner[k] = axis_aligned ? p : glm::normalize(p);
          }
          const auto base = static_cast<uint32_t>(mesh.positions.size());
          mesh.positions.insert(mesh.positions.end(), corner, corner + 4);
          mesh.triangles.emplace_back(base, base + 1, base + 2);
          mesh.triangles.emplace_back(base, base + 2, base + 3);
        }
      }
    }
    // Behind edge midpoints and random places; behind corners where their edge functions are exactly zero.
    std::vector<glm::vec3> points;
    std::mt19937 random(5);
    std::normal_distribution<float> normal;
    for (const glm::uvec3& t : mesh.triangles) {
      points.push_back(mesh.positions[t.x] + mesh.positions[t.y]);
      points.push_back(mesh.positions[t.x] + mesh.positions[t.z]);
      points.emplace_back(normal(random), normal(random), normal(random));
      points.push_back(axis_aligned ? mesh.positions[t.x]
                                    : glm::vec3(normal(random), normal(random), normal(random)));
    }
    const int width = 64;
    const int height = static_cast<int>(points.size()) / width;
    // The caster ends at sqrt(3) from its centre.
    for (glm::vec3& p : points)
      p *= axis_aligned ? 4.0f / std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)})
                        : 4.0f / glm::length(p);
    const auto mask_scene = MaskScene::Create(scene);
    ASSERT_TRUE(mask_scene.ok()) << mask_scene.status();
    for (const Light& light : {Light(PointLight{}), Light(PointLight{{0.01, 0.02, -0.03}})}) {
      // Seen from aside, the points behind corners are nothing special, but their edge functions are rounded.
      if (axis_aligned && std::get<PointLight>(light).ws_position != glm::dvec3(0.0)) continue;
      ReceiverLayer layer;
      layer.ws_positions = BottomFirst(points.data(), width, height);
      MaskRequest request = RequestFor(*mask_scene, layer, light);
      request.output = MaskOutput::kTransmittance;
      MaskRenderer renderer;
      const auto masks = renderer.Render(request);
      ASSERT_TRUE(masks.ok()) << masks.status();
      EXPECT_EQ((*masks)[0].faces, 6);
      for (int i = 0; i < width * height; ++i) {
        ASSERT_EQ((*masks)[0].rgb[static_cast<size_t>(3 * i)], 128)
            << "sample " << i << " aligned " << axis_aligned;
      }
    }
  }
}

/// Cutouts: the alpha texture decides at the hit.
TEST(ShadowMasks, CutoutsHaveHoles) {
  Scene scene = OneMeshScene({{-1, 2, -1}, {1, 2, -1}, {1, 2, 1}, {-1, 2, 1}}, {{0, 1, 2}, {0, 2, 3}});
  scene.meshes[0].uvs = {{0, 0}, {2, 0}, {2, 2}, {0, 2}};
  AlphaTexture& texture = scene.alpha_textures.emplace_back();
  texture.width = 4;
  texture.height = 4;
  std::mt19937 random(3);
  for (int i = 0; i < 16; ++i) texture.alpha.push_back(static_cast<uint8_t>(random() % 256));
  scene.materials[0].alpha_texture = 0;
  const auto mask_scene = MaskScene::Create(scene);
  ASSERT_TRUE(mask_scene.ok()) << mask_scene.status();
  const Light light = PointLight{{0.1, 5, 0.2}};
  constexpr int kSize = 96;
  std::vector<glm::vec3> points;
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) points.emplace_back(6.1f * x / kSize - 3, 0, 6.1f * y / kSize - 3);
  }
  ReceiverLayer layer;
  layer.ws_positions = BottomFirst(points.data(), kSize, kSize);
  MaskRenderer renderer;
  const auto masks = renderer.Render(RequestFor(*mask_scene, layer, light));
  ASSERT_TRUE(masks.ok()) << masks.status();
  int holes = 0;
  for (size_t i = 0; i < points.size(); ++i) {
    const glm::dvec3 from(0.1, 5, 0.2);
    const glm::dvec3 hit = from + (glm::dvec3(points[i]) - from) * (3.0 / 5.0);
    const glm::dvec2 uv(hit.x + 1.0, hit.z + 1.0);
    const bool inside = std::abs(hit.x) < 1.0 && std::abs(hit.z) < 1.0;
    // Not within rounding of a texel's border.
    const glm::dvec2 texel = 4.0 * uv;
    if (std::abs(texel.x - std::round(texel.x)) < 1e-4 || std::abs(texel.y - std::round(texel.y)) < 1e-4)
      continue;
    const bool opaque = inside && texture.AlphaAt(glm::vec2(uv)) >= 128;
    holes += inside && !opaque;
    ASSERT_EQ(Bit((*masks)[0], kSize, i), opaque) << i;
  }
  EXPECT_GT(holes, 100);
}

/// A point light amid boxes, seen in all directions: the sides of the cube that sort the samples leave no
/// trace.
TEST(ShadowMasks, RoomHasNoSeam) {
  std::mt19937 random(17);
  std::uniform_real_distribution<float> unit(-1.0f, 1.0f);
  Scene scene;
  scene.materials.emplace_back();
  Mesh& mesh = scene.meshes.emplace_back();
  scene.instances.emplace_back();
  for (int i = 0; i < 150; ++i) {
    const auto base = static_cast<uint32_t>(mesh.positions.size());
    const glm::vec3 centre = 2.0f * glm::vec3(unit(random), unit(random), unit(random));
    for (int k = 0; k < 3; ++k) {
      mesh.positions.push_back(centre + 0.8f * glm::vec3(unit(random), unit(random), unit(random)));
    }
    mesh.triangles.emplace_back(base, base + 1, base + 2);
  }
  std::vector<glm::vec3> points;
  constexpr int kSize = 48;
  for (int side = 0; side < 6; ++side) {
    for (int i = 0; i < kSize * kSize; ++i) {
      glm::vec3 p(0.0f);
      p[side / 2] = side % 2 == 0 ? 3.0f : -3.0f;
      p[(side / 2 + 1) % 3] = 6.0f * static_cast<float>(i % kSize) / (kSize - 1) - 3.0f;
      p[(side / 2 + 2) % 3] = 6.0f * static_cast<float>(i / kSize) / (kSize - 1) - 3.0f;
      points.push_back(p);
    }
  }
  const Light light = PointLight{};
  const auto mask_scene = MaskScene::Create(scene);
  ASSERT_TRUE(mask_scene.ok()) << mask_scene.status();
  ReceiverLayer layer;
  layer.ws_positions = BottomFirst(points.data(), kSize, 6 * kSize);
  MaskRenderer renderer;
  const auto masks = renderer.Render(RequestFor(*mask_scene, layer, light));
  ASSERT_TRUE(masks.ok()) << masks.status();
  EXPECT_EQ((*masks)[0].faces, 6);
  const std::vector<oracle::Triangle> triangles = oracle::Flatten(scene);
  size_t shadowed = 0, unsure = 0;
  for (size_t i = 0; i < points.size(); ++i) {
    const glm::dvec3 point(points[i]);
    const oracle::Real bound = oracle::kRoundoff * 16 * glm::length(point);
    Answer answer = Answer::kClear;
    for (const oracle::Triangle& triangle : triangles) {
      const Answer one = oracle::Blocks(triangle, light, point, bound / 2, 1.5L * bound, 0);
      if (one == Answer::kBlocked || (one == Answer::kUnsure && answer != Answer::kBlocked)) answer = one;
    }
    unsure += answer == Answer::kUnsure;
    shadowed += answer == Answer::kBlocked;
    if (answer != Answer::kUnsure) {
      ASSERT_EQ(Bit((*masks)[0], kSize, i), answer == Answer::kBlocked) << i;
    }
  }
  EXPECT_GT(shadowed, points.size() / 10);
  EXPECT_LT(unsure, 10u);
}

struct View {
  Scene scene;
  Camera camera;
  std::vector<float> depth;
  int width = 320, height = 200;
};

/// Random triangles, which the camera does not see, over the floor z = 0, which it does.
View FloorView(size_t triangles) {
  CameraMatrices matrices;
  matrices.view_from_world = glm::lookAt(glm::dvec3(0, -9, 6), glm::dvec3(0, 0, 1), glm::dvec3(0, 0, 1));
  matrices.clip_from_view = glm::perspective(0.9, 1.6, 0.1, 200.0);
  View view{MakeRandomTriangles(triangles, 9), *Camera::Create(matrices), {}};
  view.depth.assign(static_cast<size_t>(view.width) * static_cast<size_t>(view.height), 1.0f);
  for (int y = 0; y < view.height; ++y) {
    for (int x = 0; x < view.width; ++x) {
      const double ndc_x = (x + 0.5) * 2.0 / view.width - 1.0, ndc_y = (y + 0.5) * 2.0 / view.height - 1.0;
      const glm::dvec4 a4 = view.camera.WsFromNdc({ndc_x, ndc_y, -1.0}),
                       b4 = view.camera.WsFromNdc({ndc_x, ndc_y, 1.0});
      const glm::dvec3 a = glm::dvec3(a4) / a4.w, b = glm::dvec3(b4) / b4.w;
      const double t = a.z / (a.z - b.z);
      if (!(t > 0.0 && t < 1.0)) continue;
      const glm::dvec4 clip = view.camera.clip_from_world() * glm::dvec4(a + t * (b - a), 1.0);
      view.depth[static_cast<size_t>(y * view.width + x)] = static_cast<float>(0.5 * clip.z / clip.w + 0.5);
    }
  }
  return view;
}

TEST(ShadowMasks, AnyNumberOfThreadsGivesTheSameBits) {
  const View view = FloorView(30000);
  const auto scene = MaskScene::Create(view.scene);
  ASSERT_TRUE(scene.ok()) << scene.status();
  ReceiverLayer layer;
  layer.depth = BottomFirst(view.depth.data(), view.width, view.height);
  const std::vector<Light> lights = {PointLight{{2, 1, 8}}, SpotLight{{-3, -3, 9}, {0.3, 0.3, -1}, 0.5},
                                     DirectionalLight{{0.3, 0.2, -1}}};
  std::vector<std::vector<uint8_t>> expected(lights.size());
  for (const auto& run : std::vector<std::pair<int, MaskPieces>>{{1, MaskPieces::kSmall},
                                                                 {2, MaskPieces::kSmall},
                                                                 {7, MaskPieces::kSmall},
                                                                 {1, MaskPieces::kFrame},
                                                                 {3, MaskPieces::kFrame},
                                                                 {7, MaskPieces::kFrame}}) {
    const int threads = run.first;
    const MaskPieces pieces = run.second;
    const bool first = threads == 1 && pieces == MaskPieces::kSmall;
    tbb::task_arena arena(threads);
    arena.execute([&] {
      MaskRenderer renderer;
      MaskRequest request = RequestFor(*scene, layer, view.camera, lights);
      request.pieces = pieces;
      const auto masks = renderer.Render(request);
      ASSERT_TRUE(masks.ok()) << masks.status();
      ASSERT_EQ(masks->size(), lights.size());
      for (size_t i = 0; i < lights.size(); ++i) {
        const LightMask& mask = (*masks)[i];
        if (first) expected[i].assign(mask.bits.begin(), mask.bits.end());
        EXPECT_TRUE(std::equal(expected[i].begin(), expected[i].end(), mask.bits.begin())) << threads;
        EXPECT_GT(mask.shadowed_samples, mask.samples / 50);
        EXPECT_LT(mask.shadowed_samples, mask.samples);
      }
    });
  }
}

TEST(ShadowMasks, EveryInstructionSetGivesTheBitsOfTheExhaustiveTest) {
  const View view = FloorView(1500);
  const auto scene = MaskScene::Create(view.scene);
  ASSERT_TRUE(scene.ok()) << scene.status();
  ReceiverLayer layer;
  layer.depth = BottomFirst(view.depth.data(), view.width, view.height);
  const std::vector<Light> lights = {PointLight{{2, 1, 8}}, PointLight{{1, -2, 0.3}},
                                     DirectionalLight{{0.3, 0.2, -1}}};
  for (int64_t targets = hwy::SupportedTargets(); targets != 0; targets &= targets - 1) {
    // Lower bits are better targets.
    hwy::SetSupportedTargetsForTest(targets);
    std::vector<std::vector<uint8_t>> expected;
    for (const MaskMethod method : {MaskMethod::kExhaustive, MaskMethod::kGrid, MaskMethod::kBsp}) {
      for (const MaskPieces pieces : {MaskPieces::kSmall, MaskPieces::kFrame}) {
        MaskRenderer renderer;
        MaskRequest request = RequestFor(*scene, layer, view.camera, lights);
        request.method = method;
        request.pieces = pieces;
        const auto masks = renderer.Render(request);
        ASSERT_TRUE(masks.ok()) << masks.status();
        std::vector<std::vector<uint8_t>> bits;
        for (const LightMask& mask : *masks) bits.emplace_back(mask.bits.begin(), mask.bits.end());
        if (expected.empty()) expected = bits;
        EXPECT_EQ(bits, expected) << "targets " << targets << ", " << MaskMethodName(method);
        EXPECT_EQ((*masks)[1].faces, 6);
      }
    }
  }
  hwy::SetSupportedTargetsForTest(0);
}

TEST(ShadowMasks, LayersAndStridesAddressTheSamePixels) {
  const View view = FloorView(3000);
  const auto scene = MaskScene::Create(view.scene);
  ASSERT_TRUE(scene.ok()) << scene.status();
  const auto width = static_cast<size_t>(view.width), height = static_cast<size_t>(view.height);
  std::vector<float> flipped(view.depth.size());
  for (size_t y = 0; y < height; ++y) {
    std::copy_n(&view.depth[y * width], width, &flipped[(height - 1 - y) * width]);
  }
  const std::vector<float> nothing(view.depth.size(), kNan);
  ReceiverLayer layers[3];
  layers[0].depth = BottomFirst(view.depth.data(), view.width, view.height);
  layers[1].depth = TopFirst(flipped.data(), view.width, view.height);
  layers[2].depth = BottomFirst(nothing.data(), view.width, view.height);
  const Light light = PointLight{{2, 1, 8}};
  MaskRequest request = RequestFor(*scene, layers[0], light);
  request.layers = layers;
  request.camera = &view.camera;
  MaskRenderer renderer;
  const auto masks = renderer.Render(request);
  ASSERT_TRUE(masks.ok()) << masks.status();
  const LightMask& mask = (*masks)[0];
  size_t set = 0;
  for (int y = 0; y < view.height; ++y) {
    for (int x = 0; x < view.width; ++x) {
      ASSERT_EQ(mask.InShadow(0, view.height, x, y), mask.InShadow(1, view.height, x, y)) << x << ' ' << y;
      ASSERT_FALSE(mask.InShadow(2, view.height, x, y));
      set += mask.InShadow(0, view.height, x, y);
    }
  }
  EXPECT_EQ(mask.shadowed_samples, 2 * set);
  EXPECT_GT(set, 0u);
  // A frame of the same size needs no more memory.
  const size_t bytes = renderer.MemoryBytes();
  ASSERT_TRUE(renderer.Render(request).ok());
  EXPECT_EQ(renderer.MemoryBytes(), bytes);
}

TEST(ShadowMasks, ReceiversFacingAwayAreInShadowUntested) {
  const auto scene = MaskScene::Create(Scene{});
  ASSERT_TRUE(scene.ok()) << scene.status();
  const std::vector<glm::vec3> points = {{0, 0, 0}, {1, 0, 0}, {kNan, 0, 0}, {0, 0, 20}};
  const std::vector<glm::vec3> normals = {{0, 0, 1}, {0, 0, -1}, {0, 0, 1}, {0, 0, 1}};
  ReceiverLayer layer;
  layer.ws_positions = BottomFirst(points.data(), 4, 1);
  layer.ws_normals = BottomFirst(normals.data(), 4, 1);
  MaskRenderer renderer;
  const Light point = PointLight{{0, 0, 10}};
  auto masks = renderer.Render(RequestFor(*scene, layer, point));
  ASSERT_TRUE(masks.ok()) << masks.status();
  EXPECT_EQ((*masks)[0].bits[0], 0b1010);
  EXPECT_EQ((*masks)[0].samples, 3u);
  EXPECT_EQ((*masks)[0].facing_away_samples, 2u);
  const Light sun = DirectionalLight{{0, 0, -1}};
  masks = renderer.Render(RequestFor(*scene, layer, sun));
  ASSERT_TRUE(masks.ok()) << masks.status();
  EXPECT_EQ((*masks)[0].bits[0], 0b0010);
  const Light spot = SpotLight{{0, 0, 10}, {0, 0, -1}, 0.05};
  masks = renderer.Render(RequestFor(*scene, layer, spot));
  ASSERT_TRUE(masks.ok()) << masks.status();
  EXPECT_EQ((*masks)[0].bits[0], 0b0000);
  EXPECT_EQ((*masks)[0].outside_cone_samples, 2u);
}

TEST(ShadowMasks, MovedInstancesAndDeformedMeshesEqualANewScene) {
  View view = FloorView(2000);
  auto moved = MaskScene::Create(view.scene);
  ASSERT_TRUE(moved.ok()) << moved.status();
  const size_t mesh = 0, instance = view.scene.instances.size() - 1;
  glm::mat4x3 transform(1.0f);
  transform[0] = {0.6f, 0.8f, 0};
  transform[1] = {-0.8f, 0.6f, 0};
  transform[3] = {0.5f, -0.25f, 0.125f};
  ASSERT_TRUE(moved->SetInstanceTransform(instance, transform).ok());
  view.scene.instances[instance].world_from_object = transform;
  for (glm::vec3& p : view.scene.meshes[mesh].positions) p.z += 0.1f * std::sin(p.x);
  ASSERT_TRUE(moved->SetMeshPositions(mesh, view.scene.meshes[mesh].positions).ok());
  const auto fresh = MaskScene::Create(view.scene);
  ASSERT_TRUE(fresh.ok()) << fresh.status();
  ReceiverLayer layer;
  layer.depth = BottomFirst(view.depth.data(), view.width, view.height);
  const Light light = PointLight{{2, 1, 8}};
  MaskRenderer a, b;
  MaskRequest request = RequestFor(*moved, layer, light);
  request.camera = &view.camera;
  const auto first = a.Render(request);
  request.scene = &*fresh;
  const auto second = b.Render(request);
  ASSERT_TRUE(first.ok() && second.ok());
  EXPECT_TRUE(std::equal((*first)[0].bits.begin(), (*first)[0].bits.end(), (*second)[0].bits.begin()));
  EXPECT_GT((*first)[0].shadowed_samples, 0u);

  EXPECT_THAT(moved->SetInstanceTransform(99, transform).message(), HasSubstr("instance: 99"));
  transform[2].y = kNan;
  EXPECT_THAT(moved->SetInstanceTransform(0, transform).message(), HasSubstr("not finite"));
  EXPECT_THAT(moved->SetMeshPositions(mesh, {}).message(), HasSubstr("positions of mesh 0: 0"));
}

/// What a frame says of instances counts for that frame, and leaves the shared scene alone.
TEST(ShadowMasks, InstancesMovedByAFrameEqualAMovedScene) {
  View view = FloorView(3000);
  const Instance original = view.scene.instances[0];
  for (int i = 1; i < 5; ++i) {
    Instance copy = original;
    copy.world_from_object[3] += glm::vec3(0.3f * static_cast<float>(i), -0.2f, 0.1f);
    view.scene.instances.push_back(copy);
  }
  const auto scene = MaskScene::Create(view.scene);
  ASSERT_TRUE(scene.ok()) << scene.status();
  const size_t where[] = {3, 1};
  std::vector<MovedInstance> moved;
  for (const size_t i : where) {
    glm::mat4x3 transform(1.0f);
    transform[0] = {0.6f, 0.8f, 0};
    transform[1] = {-0.8f, 0.6f, 0};
    transform[3] = {0.5f, -0.25f, 0.125f * static_cast<float>(i)};
    moved.push_back({i, transform});
    view.scene.instances[i].world_from_object = transform;
  }
  const auto fresh = MaskScene::Create(view.scene);
  ASSERT_TRUE(fresh.ok()) << fresh.status();
  ReceiverLayer layer;
  layer.depth = BottomFirst(view.depth.data(), view.width, view.height);
  const Light light = PointLight{{2, 1, 8}};
  MaskRenderer a, b;
  MaskRequest request = RequestFor(*scene, layer, light);
  request.camera = &view.camera;
  const auto unmoved = a.Render(request);
  ASSERT_TRUE(unmoved.ok()) << unmoved.status();
  const std::vector<uint8_t> before((*unmoved)[0].bits.begin(), (*unmoved)[0].bits.end());
  request.moved_instances = moved;
  const auto first = a.Render(request);
  ASSERT_TRUE(first.ok()) << first.status();
  MaskRequest fresh_request = RequestFor(*fresh, layer, light);
  fresh_request.camera = &view.camera;
  const auto second = b.Render(fresh_request);
  ASSERT_TRUE(second.ok()) << second.status();
  EXPECT_TRUE(std::equal((*first)[0].bits.begin(), (*first)[0].bits.end(), (*second)[0].bits.begin()));
  EXPECT_FALSE(std::equal((*first)[0].bits.begin(), (*first)[0].bits.end(), before.begin()));
  request.moved_instances = {};
  const auto again = a.Render(request);
  ASSERT_TRUE(again.ok()) << again.status();
  EXPECT_TRUE(std::equal((*again)[0].bits.begin(), (*again)[0].bits.end(), before.begin()));

  request.moved_instances = moved;
  moved[1].instance = 3;
  EXPECT_EQ(a.Render(request).status().message(), "moved_instances: instance 3 is there twice");
  moved[1].instance = 99;
  EXPECT_EQ(a.Render(request).status().message(),
            absl::StrFormat("moved_instances[1].instance: 99, but there are %d", scene->InstanceCount()));
  moved[1].instance = 1;
  moved[1].world_from_object[3].y = kNan;
  EXPECT_EQ(a.Render(request).status().message(), "moved_instances[1].world_from_object[10]: not finite");
}

/// Few bytes describe very many instances, and each light would keep a box for each of them.
TEST(ShadowMasks, ManyLightsAmidManyInstancesTakeTurns) {
  Scene scene = OneMeshScene({{-0.05f, 0, 0}, {0.05f, 0, 0}, {0, 0.1f, 0.02f}}, {{0, 1, 2}});
  scene.instances.clear();
  RandomScenes random(5);
  for (int i = 0; i < 25'000; ++i) {
    Instance& instance = scene.instances.emplace_back();
    instance.world_from_object[3] = random.Point(2.0);
  }
  const auto mask_scene = MaskScene::Create(scene);
  ASSERT_TRUE(mask_scene.ok()) << mask_scene.status();
  std::vector<glm::vec3> points;
  for (int i = 0; i < kWidth * kHeight; ++i) points.push_back(random.Point(3.0));
  std::vector<Light> lights;
  for (int i = 0; i < 32; ++i) lights.emplace_back(PointLight{glm::dvec3(random.Point(0.5))});
  ReceiverLayer layer;
  layer.ws_positions = BottomFirst(points.data(), kWidth, kHeight);
  MaskRenderer renderer;
  MaskRequest request = RequestFor(*mask_scene, layer, lights[0]);
  request.lights = lights;
  const auto masks = renderer.Render(request);
  ASSERT_TRUE(masks.ok()) << masks.status();
  ASSERT_EQ(masks->size(), lights.size());
  EXPECT_LT(renderer.MemoryBytes(), size_t{72} << 20);
  for (size_t i = 0; i < lights.size(); ++i) {
    const LightMask& mask = (*masks)[i];
    EXPECT_EQ(mask.faces, 6);
    EXPECT_GT(mask.shadowed_samples, 5u);
    MaskRenderer alone;
    const auto expected = alone.Render(RequestFor(*mask_scene, layer, lights[i]));
    ASSERT_TRUE(expected.ok()) << expected.status();
    EXPECT_TRUE(std::equal(mask.bits.begin(), mask.bits.end(), (*expected)[0].bits.begin())) << i;
  }
}

TEST(ShadowMasks, ASceneOfTooManyClustersIsRefused) {
  Scene scene = OneMeshScene({{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, {});
  scene.meshes[0].triangles.assign((MaskScene::kMaxClusters >> 12) * 64, {0, 1, 2});
  scene.instances.resize(4096);
  EXPECT_LE(MaskScene::MostBytes(scene), size_t{200} << 20);
  scene.instances.emplace_back();
  EXPECT_EQ(MaskScene::Create(scene).status().message(),
            "instances: 4097 with 268500992 triangles in total make 4195328 clusters, at most 4194304");
}

/// Four samples a pixel, each a layer; one of them without a sample here and there.
TEST(ShadowMasks, CoverageIsTheShareOfSamplesThatLightReaches) {
  View view = FloorView(3000);
  const auto scene = MaskScene::Create(view.scene);
  ASSERT_TRUE(scene.ok()) << scene.status();
  std::vector<float> holes = view.depth;
  for (size_t i = 0; i < holes.size(); i += 3) holes[i] = 1.0f;
  ReceiverLayer layers[4];
  for (size_t i = 0; i < 4; ++i) {
    layers[i].depth = BottomFirst(i == 3 ? holes.data() : view.depth.data(), view.width, view.height);
    layers[i].pixel_offset = {i % 2 == 0 ? 0.25 : 0.75, i / 2 == 0 ? 0.25 : 0.75};
  }
  const Light light = PointLight{{2, 1, 8}};
  MaskRequest request = RequestFor(*scene, layers[0], light);
  request.layers = layers;
  request.camera = &view.camera;
  request.output = MaskOutput::kCoverage;
  MaskRenderer renderer;
  const auto masks = renderer.Render(request);
  ASSERT_TRUE(masks.ok()) << masks.status();
  const LightMask& mask = (*masks)[0];
  ASSERT_EQ(mask.coverage.size(), view.depth.size());
  size_t partial = 0;
  for (int y = 0; y < view.height; ++y) {
    for (int x = 0; x < view.width; ++x) {
      const size_t i = static_cast<size_t>(y * view.width + x);
      int samples = 0, lit = 0;
      for (size_t layer = 0; layer < 4; ++layer) {
        if (layers[layer].depth.At(x, y) >= 1.0f) continue;
        ++samples;
        lit += !mask.InShadow(layer, view.height, x, y);
      }
      const int expected = samples == 0 ? 255 : static_cast<int>(std::lround(255.0 * lit / samples));
      ASSERT_EQ(mask.coverage[i], expected) << x << ' ' << y;
      partial += lit > 0 && lit < samples;
    }
  }
  EXPECT_GT(partial, 100u);
}

TEST(ShadowMasks, BadInputIsNamed) {
  Scene broken = OneMeshScene({{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, {{0, 1, 3}});
  EXPECT_THAT(MaskScene::Create(broken).status().message(), HasSubstr("index 3"));
  broken.meshes[0].triangles = {{0, 1, 2}};
  broken.meshes[0].positions[1].y = kNan;
  EXPECT_THAT(MaskScene::Create(broken).status().message(), HasSubstr("not finite"));
  broken.meshes[0].positions[1].y = 0;
  broken.materials[0].alpha_texture = 2;
  EXPECT_THAT(MaskScene::Create(broken).status().message(), HasSubstr("alpha_texture: 2"));

  const auto scene = MaskScene::Create(Scene{});
  ASSERT_TRUE(scene.ok());
  const View view = FloorView(10);
  ReceiverLayer layer;
  layer.depth = BottomFirst(view.depth.data(), view.width, view.height);
  const Light light = PointLight{};
  MaskRenderer renderer;
  const auto message = [&](const MaskRequest& request) {
    return std::string(renderer.Render(request).status().message());
  };
  MaskRequest request = RequestFor(*scene, layer, light);
  EXPECT_THAT(message(request), HasSubstr("camera: none"));
  request.camera = &view.camera;
  EXPECT_TRUE(renderer.Render(request).ok());
  request.scene = nullptr;
  EXPECT_THAT(message(request), HasSubstr("scene: none"));
  request.scene = &*scene;
  request.layers = {};
  EXPECT_THAT(message(request), HasSubstr("layers: empty"));
  request.layers = {&layer, 1};
  layer.depth.height = 0;
  EXPECT_THAT(message(request), HasSubstr("layers[0]: size 320x0"));
  layer.depth.height = 1 << 20;
  EXPECT_THAT(message(request), HasSubstr("must be in [1, 32768]"));
  layer.depth.height = view.height;
  layer.pixel_offset.x = kNan;
  EXPECT_THAT(message(request), HasSubstr("pixel_offset"));
  layer.pixel_offset.x = 0.5;
  const Light lights[] = {light, DirectionalLight{{0, 0, 0}}};
  request.lights = lights;
  EXPECT_THAT(message(request), HasSubstr("lights[1].directional.direction: zero-length"));
  EXPECT_THAT(ParseMaskMethod("quadtree").status().message(), HasSubstr("quadtree"));
  EXPECT_EQ(*ParseMaskMethod("bsp"), MaskMethod::kBsp);
}

TEST(ShadowMasks, CancellationStopsThePreparationOfAScene) {
  const Scene scene = MakeRandomTriangles(400000, 9);
  Cancellation gone;
  gone.Cancel();
  EXPECT_EQ(MaskScene::Create(scene, &gone).status().code(), absl::StatusCode::kCancelled);
  const Cancellation late(Cancellation::Clock::now());
  EXPECT_EQ(MaskScene::Create(scene, &late).status().code(), absl::StatusCode::kDeadlineExceeded);
  const auto start = Cancellation::Clock::now();
  ASSERT_TRUE(MaskScene::Create(scene).ok());
  const auto whole = Cancellation::Clock::now() - start;
  int stopped = 0;
  for (int i = 0; i < 8; ++i) {
    const Cancellation soon(Cancellation::Clock::now() + i * whole / 16);
    const auto created = MaskScene::Create(scene, &soon);
    stopped += created.status().code() == absl::StatusCode::kDeadlineExceeded;
    EXPECT_TRUE(created.ok() || absl::IsDeadlineExceeded(created.status())) << created.status();
  }
  EXPECT_GE(stopped, 4);
}

TEST(ShadowMasks, CancellationStopsTheWork) {
  const View view = FloorView(200000);
  const auto scene = MaskScene::Create(view.scene);
  ASSERT_TRUE(scene.ok());
  // Very many samples, so that the work would take long.
  constexpr int kSide = 2000;
  std::vector<glm::vec3> points(static_cast<size_t>(kSide) * kSide);
  for (size_t i = 0; i < points.size(); ++i) {
    points[i] = {6e-3f * static_cast<float>(i % kSide) - 6, 6e-3f * static_cast<float>(i / kSide) - 6, 0};
  }
  ReceiverLayer layer;
  layer.ws_positions = BottomFirst(points.data(), kSide, kSide);
  const Light light = PointLight{{2, 1, 8}};
  MaskRequest request = RequestFor(*scene, layer, light);
  MaskRenderer renderer;
  Cancellation gone;
  gone.Cancel();
  request.cancellation = &gone;
  EXPECT_EQ(renderer.Render(request).status().code(), absl::StatusCode::kCancelled);
  Cancellation late(Cancellation::Clock::now());
  request.cancellation = &late;
  EXPECT_EQ(renderer.Render(request).status().code(), absl::StatusCode::kDeadlineExceeded);

  // At points all over a frame, and amid triangles that each meet every sample.
  const auto full = std::chrono::steady_clock::now();
  request.cancellation = nullptr;
  ASSERT_TRUE(renderer.Render(request).ok());
  const std::chrono::duration<double, std::milli> frame = std::chrono::steady_clock::now() - full;
  std::vector<double> waits;
  for (int i = 0; i < 15; ++i) {
    request.method = i < 10 ? MaskMethod::kGrid : MaskMethod::kExhaustive;
    const std::chrono::duration<double, std::milli> delay =
        i < 10 ? (0.05 + 0.08 * i) * frame : 0.1 * i * frame;
    Cancellation soon;
    request.cancellation = &soon;
    std::chrono::steady_clock::time_point asked;
    std::thread canceller([&] {
      std::this_thread::sleep_for(delay);
      asked = std::chrono::steady_clock::now();
      soon.Cancel();
    });
    const absl::Status status = renderer.Render(request).status();
    const auto answered = std::chrono::steady_clock::now();
    canceller.join();
    if (status.ok()) continue;  // A busy machine: the canceller came late.
    EXPECT_EQ(status.code(), absl::StatusCode::kCancelled);
    waits.push_back(std::chrono::duration<double, std::milli>(answered - asked).count());
  }
  ASSERT_GE(waits.size(), 5u);
  std::sort(waits.begin(), waits.end());
  const double median = waits[waits.size() / 2];
  std::cout << "cancelled " << waits.size() << " times, median " << median << " ms, most " << waits.back()
            << " ms later\n";
  // The most is printed, not judged: on a busy machine a thread may wait that long for a processor.
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  EXPECT_LT(median, 500.0);  // What lies between two polls is slower.
#else
  EXPECT_LT(median, 20.0);
#endif
}

}  // namespace
}  // namespace shadowfit
