#include "core/scene/patches.h"

#include <gmock/gmock.h>

#include <cmath>
#include <functional>
#include <numbers>

namespace shadowfit {
namespace {

constexpr double kPi = std::numbers::pi;

/// Six times the signed volume of a closed surface is the sum of a . (b x c): positive where triangles wind
/// counter-clockwise as seen from outside, and independent of the origin only where nothing is open.
double Volume(const Scene& scene, const glm::dvec3& origin) {
  double sum = 0.0;
  for (const Mesh& mesh : scene.meshes) {
    for (const glm::uvec3& t : mesh.triangles) {
      const glm::dvec3 a = glm::dvec3(mesh.positions[t.x]) - origin;
      const glm::dvec3 b = glm::dvec3(mesh.positions[t.y]) - origin;
      const glm::dvec3 c = glm::dvec3(mesh.positions[t.z]) - origin;
      sum += glm::dot(a, glm::cross(b, c));
    }
  }
  return sum / 6.0;
}

TEST(PatchesTest, ShapesAreClosedAndFaceOutwards) {
  const Patches::Frame frame = Patches::Standing({3.0, -2.0, 1.0}, 0.7);
  const struct {
    const char* name;
    std::function<void(Patches*)> add;
    double volume;
  } shapes[] = {
      {"box",
       [&](Patches* p) {
         p->AddBox(frame, {1.0, 2.0, 3.0});
       },
       6.0},
      {"sphere",
       [&](Patches* p) {
         p->AddSphere({1, 2, 3}, 1.5);
       },
       4.0 / 3.0 * kPi * 3.375},
      {"rod",
       [&](Patches* p) {
         p->AddRod({1, 2, 3}, {2, 4, 5}, 0.5, 0.5);
       },
       0.75 * kPi},
      {"cone",
       [&](Patches* p) {
         p->AddRod({1, 2, 3}, {2, 4, 5}, 0.5, 0.0);
       },
       0.25 * kPi},
      {"upright rod",
       [&](Patches* p) {
         p->AddRod({1, 2, 3}, {1, 2, 5}, 0.4, 0.4);
       },
       0.32 * kPi},
      {"torus", [&](Patches* p) { p->AddTorus(frame, 2.0, 0.5); }, 2.0 * kPi * kPi * 2.0 * 0.25},
      {"arch", [&](Patches* p) { p->AddArch(frame, 1.0, 0.5, 2.0); }, 0.5 * kPi * (2.25 - 1.0) * 2.0},
  };
  for (const auto& shape : shapes) {
    Patches patches;
    shape.add(&patches);
    Scene scene;
    scene.materials.emplace_back();
    const size_t count = patches.Tessellate(20000, &scene);
    EXPECT_EQ(count, scene.TriangleCount());
    EXPECT_LE(count, 20000u);
    EXPECT_GT(count, 15000u) << shape.name;
    ASSERT_TRUE(Validate(scene).ok());
    EXPECT_NEAR(Volume(scene, {0, 0, 0}), shape.volume, 3e-3 * shape.volume) << shape.name;
    EXPECT_NEAR(Volume(scene, {50, -70, 90}), shape.volume, 3e-3 * shape.volume) << shape.name;
  }
}

TEST(PatchesTest, DetailAndLengthSetTheCells) {
  Patches patches;
  patches.AddQuad({0, 0, 0}, {4, 0, 0}, {0, 1, 0});
  patches.SetMaterial(1);
  patches.SetDetail(0.5);
  patches.AddQuad({0, 0, 1}, {4, 0, 0}, {0, 4, 0});
  EXPECT_EQ(patches.LeastTriangles(), 4u);
  Scene scene;
  scene.materials.resize(2);
  patches.Tessellate(2 * (400 * 100 + 200 * 200), &scene);
  ASSERT_EQ(scene.meshes.size(), 2u);
  EXPECT_EQ(scene.meshes[0].triangles.size(), 2u * 400 * 100);
  EXPECT_EQ(scene.meshes[1].triangles.size(), 2u * 200 * 200);
}

}  // namespace
}  // namespace shadowfit
