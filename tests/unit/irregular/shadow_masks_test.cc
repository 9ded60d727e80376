#include "core/irregular/shadow_masks.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>

#include "tests/unit/irregular/mask_oracle.h"

namespace shadowfit {
namespace {

using oracle::Answer;
using ::testing::HasSubstr;

Scene OneMeshScene(std::vector<glm::vec3> positions, std::vector<glm::uvec3> triangles) {
  Scene scene;
  scene.materials.emplace_back();
  Mesh& mesh = scene.meshes.emplace_back();
  mesh.positions = std::move(positions);
  mesh.triangles = std::move(triangles);
  scene.instances.emplace_back();
  return scene;
}

/// Tiny scenes of every awkward kind: near and across the light, huge, tiny, thin, duplicated, connected.
class RandomScenes {
 public:
  explicit RandomScenes(uint32_t seed) : random_(seed) {}

  double Uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random_);
  }
  int Int(int low, int high) { return std::uniform_int_distribution<int>(low, high)(random_); }
  glm::vec3 Point(double size) { return {Uniform(-size, size), Uniform(-size, size), Uniform(-size, size)}; }

  Scene Next() {
    std::vector<glm::vec3> positions;
    std::vector<glm::uvec3> triangles;
    const int count = Int(1, 24);
    for (int i = 0; i < count; ++i) {
      const auto base = static_cast<uint32_t>(positions.size());
      const int kind = Int(0, 7);
      if (kind == 1 && base >= 3) {
        triangles.push_back(triangles[static_cast<size_t>(Int(0, static_cast<int>(triangles.size()) - 1))]);
        continue;
      }
      if (kind == 2 && base >= 3) {  // Shares an edge.
        const glm::uvec3 t = triangles.back();
        positions.push_back(Point(2.0));
        triangles.emplace_back(t.y, t.x, base);
        continue;
      }
      const double size = kind == 3 ? 1000.0 : kind == 4 ? 1e-3 : kind == 5 ? 1e6 : 1.0;
      const glm::vec3 centre = Point(2.0);
      for (int corner = 0; corner < 3; ++corner) {
        glm::vec3 p = centre + Point(size);
        if (kind == 6) p.y = centre.y;  // Axis-aligned plane.
        if (kind == 7 && corner == 2) p = 0.5f * (positions[base] + positions[base + 1]) + Point(1e-5);
        positions.push_back(p);
      }
      triangles.emplace_back(base, base + 1, base + 2);
    }
    return OneMeshScene(std::move(positions), std::move(triangles));
  }

  Light NextLight() {
    switch (Int(0, 3)) {
      case 0:
        return SpotLight{glm::dvec3(Point(2.0)), glm::dvec3(Point(1.0)), Uniform(0.1, 1.5)};
      case 1:
        return DirectionalLight{Int(0, 3) == 0 ? glm::dvec3(0, -1, 0) : glm::dvec3(Point(1.0))};
      default:
        return PointLight{Int(0, 3) == 0 ? glm::dvec3(Point(8.0)) : glm::dvec3(Point(2.0))};
    }
  }

  /// Points in space, some of them on triangles.
  std::vector<glm::vec3> Receivers(const Scene& scene, size_t count) {
    std::vector<glm::vec3> points;
    const Mesh& mesh = scene.meshes[0];
    const int spread = Int(0, 3);
    while (points.size() < count) {
      if (Int(0, 2) != 0) {
        points.push_back(spread == 0 ? glm::vec3(5, -1, 4) + Point(0.3) : Point(3.0));
        continue;
      }
      const glm::uvec3& t =
          mesh.triangles[static_cast<size_t>(Int(0, static_cast<int>(mesh.triangles.size()) - 1))];
      float a = static_cast<float>(Uniform(0, 1)), b = static_cast<float>(Uniform(0, 1));
      if (a + b > 1) a = 1 - a, b = 1 - b;
      const glm::vec3 p = mesh.positions[t.x] + a * (mesh.positions[t.y] - mesh.positions[t.x]) +
                          b * (mesh.positions[t.z] - mesh.positions[t.x]);
      points.push_back(glm::length(p) < 100.0f ? p : Point(3.0));
    }
    return points;
  }

 private:
  std::mt19937 random_;
};

constexpr int kWidth = 24;
constexpr int kHeight = 8;

struct Rendered {
  std::vector<uint8_t> bits;
  size_t undecided = 0;
  size_t shadowed = 0;
};

Rendered RenderPoints(MaskRenderer* renderer, const MaskScene& scene, const std::vector<glm::vec3>& points,
                      const Light& light, MaskMethod method) {
  ReceiverLayer layer;
  layer.ws_positions = BottomFirst(points.data(), kWidth, kHeight);
  MaskRequest request;
  request.scene = &scene;
  request.layers = {&layer, 1};
  request.lights = {&light, 1};
  request.method = method;
  const auto masks = renderer->Render(request);
  EXPECT_TRUE(masks.ok()) << masks.status();
  const LightMask& mask = (*masks)[0];
  return {std::vector<uint8_t>(mask.bits.begin(), mask.bits.end()), mask.undecided_samples,
          mask.shadowed_samples};
}

TEST(ShadowMasks, AgreeWithBruteForceOnRandomScenes) {
  RandomScenes scenes(7);
  MaskRenderer renderer;
  size_t compared = 0, unsure = 0, shadowed = 0;
  for (int n = 0; n < 3000; ++n) {
    const Scene scene = scenes.Next();
    const Light light = scenes.NextLight();
    const std::vector<glm::vec3> points = scenes.Receivers(scene, kWidth * kHeight);
    const auto mask_scene = MaskScene::Create(scene);
    ASSERT_TRUE(mask_scene.ok()) << mask_scene.status();
    const Rendered rendered = RenderPoints(&renderer, *mask_scene, points, light, MaskMethod::kGrid);
    const auto ray_space = RaySpace::Create(light);
    ASSERT_TRUE(ray_space.ok()) << ray_space.status();
    const std::vector<oracle::Triangle> triangles = oracle::Flatten(scene);
    oracle::Real reach = 0;  // Of the points, from their centre or the world's.
    for (const glm::vec3& p : points) reach = std::max<oracle::Real>(reach, 2 * glm::length(p));
    for (int i = 0; i < kWidth * kHeight; ++i) {
      const glm::dvec3 point(points[static_cast<size_t>(i)]);
      const size_t bytes_per_row = 4;
      const int x = i % kWidth, y = i / kWidth;
      const bool in_shadow =
          (rendered.bits[static_cast<size_t>(y) * bytes_per_row + static_cast<size_t>(x) / 8] >> (x % 8) &
           1) != 0;
      if (!ray_space->Illuminates(point)) {
        EXPECT_FALSE(in_shadow);
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
        if (one == Answer::kUnsure && answer == Answer::kClear) answer = one;
      }
      ++compared;
      if (answer == Answer::kUnsure) {
        ++unsure;
        continue;
      }
      shadowed += answer == Answer::kBlocked;
      ASSERT_EQ(in_shadow, answer == Answer::kBlocked)
          << "scene " << n << " light kind " << light.index() << " sample " << i;
    }
  }
  RecordProperty("compared", static_cast<int>(compared));
  RecordProperty("unsure", static_cast<int>(unsure));
  std::cout << compared << " compared, " << shadowed << " in shadow, " << unsure << " within the bound\n";
  EXPECT_GT(shadowed, compared / 20);
  EXPECT_LT(unsure, compared / 10);
}

TEST(ShadowMasks, EveryMethodGivesTheSameBits) {
  RandomScenes scenes(11);
  MaskRenderer grid, bsp, exhaustive;
  for (int n = 0; n < 2000; ++n) {
    const Scene scene = scenes.Next();
    const Light light = scenes.NextLight();
    const std::vector<glm::vec3> points = scenes.Receivers(scene, kWidth * kHeight);
    const auto mask_scene = MaskScene::Create(scene);
    ASSERT_TRUE(mask_scene.ok()) << mask_scene.status();
    const Rendered a = RenderPoints(&grid, *mask_scene, points, light, MaskMethod::kGrid);
    const Rendered b = RenderPoints(&bsp, *mask_scene, points, light, MaskMethod::kBsp);
    const Rendered c = RenderPoints(&exhaustive, *mask_scene, points, light, MaskMethod::kExhaustive);
    ASSERT_EQ(a.bits, c.bits) << "scene " << n << " light kind " << light.index();
    ASSERT_EQ(b.bits, c.bits) << "scene " << n << " light kind " << light.index();
    ASSERT_EQ(a.undecided, c.undecided) << "scene " << n << " light kind " << light.index();
    ASSERT_EQ(b.undecided, c.undecided) << "scene " << n << " light kind " << light.index();
  }
}

}  // namespace
}  // namespace shadowfit
