#include "core/scene/procedural.h"

#include <gmock/gmock.h>

#include <bit>

namespace shadowfit {
namespace {

/// FNV-1a over the bits of every position and index.
uint64_t Fingerprint(const Scene& scene) {
  uint64_t hash = 0xcbf29ce484222325u;
  const auto mix = [&](uint32_t word) { hash = (hash ^ word) * 0x100000001b3u; };
  for (const Mesh& mesh : scene.meshes) {
    for (const glm::vec3& p : mesh.positions) {
      for (int k = 0; k < 3; ++k) mix(std::bit_cast<uint32_t>(p[k]));
    }
    for (const glm::uvec3& t : mesh.triangles) {
      for (int k = 0; k < 3; ++k) mix(t[k]);
    }
  }
  return hash;
}

int DegenerateTriangles(const Scene& scene) {
  int count = 0;
  for (const Mesh& mesh : scene.meshes) {
    for (const glm::uvec3& t : mesh.triangles) {
      const glm::dvec3 a(mesh.positions[t.x]);
      const glm::dvec3 normal =
          glm::cross(glm::dvec3(mesh.positions[t.y]) - a, glm::dvec3(mesh.positions[t.z]) - a);
      count += glm::length(normal) < 1e-12 ? 1 : 0;
    }
  }
  return count;
}

TEST(ProceduralTest, PlazaHasExactlyTheTrianglesAskedFor) {
  for (const size_t triangles : {size_t{20'000}, size_t{99'999}, kPaperTriangles}) {
    const absl::StatusOr<Scene> plaza = MakePlaza(triangles);
    ASSERT_TRUE(plaza.ok()) << plaza.status();
    EXPECT_EQ(plaza->TriangleCount(), triangles);
    EXPECT_TRUE(Validate(*plaza).ok());
    EXPECT_EQ(DegenerateTriangles(*plaza), 0);
    const Bounds bounds = plaza->WsBounds();
    EXPECT_EQ(glm::dvec2(bounds.min), glm::dvec2(-30.0, -30.0));
    EXPECT_NEAR(bounds.min.z, 0.0, 0.05);  // Leaning trunks dip into the floor.
    EXPECT_GT(bounds.max.z, 5.0);
    EXPECT_LT(bounds.max.z, 9.0);
  }
  EXPECT_EQ(MakePlaza(100).status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(ProceduralTest, SeedsDecideAndNothingElse) {
  EXPECT_EQ(Fingerprint(*MakePlaza(30'000, 5)), Fingerprint(*MakePlaza(30'000, 5)));
  EXPECT_NE(Fingerprint(*MakePlaza(30'000, 5)), Fingerprint(*MakePlaza(30'000, 6)));
  EXPECT_EQ(Fingerprint(*MakeHall(60'000, 5)), Fingerprint(*MakeHall(60'000, 5)));
  EXPECT_NE(Fingerprint(*MakeHall(60'000, 5)), Fingerprint(*MakeHall(60'000, 6)));
  EXPECT_EQ(Fingerprint(*MakeCity(100'000, 5)), Fingerprint(*MakeCity(100'000, 5)));
  EXPECT_NE(Fingerprint(*MakeCity(100'000, 5)), Fingerprint(*MakeCity(100'000, 6)));
  EXPECT_EQ(Fingerprint(*MakeWarehouse(100'000, 5)), Fingerprint(*MakeWarehouse(100'000, 5)));
  EXPECT_NE(Fingerprint(*MakeWarehouse(100'000, 5)), Fingerprint(*MakeWarehouse(100'000, 6)));
  EXPECT_EQ(Fingerprint(MakeRandomTriangles(1000, 5)), Fingerprint(MakeRandomTriangles(1000, 5)));
  EXPECT_NE(Fingerprint(MakeRandomTriangles(1000, 5)), Fingerprint(MakeRandomTriangles(1000, 6)));
}

TEST(ProceduralTest, RandomTrianglesKeepTheirTotalArea) {
  for (const size_t triangles : {size_t{1}, size_t{10}, size_t{5000}}) {
    const Scene scene = MakeRandomTriangles(triangles, 3);
    ASSERT_TRUE(Validate(scene).ok());
    ASSERT_EQ(scene.TriangleCount(), triangles + 2);
    double area = 0.0;
    for (const glm::uvec3& t : scene.meshes[1].triangles) {
      const auto& p = scene.meshes[1].positions;
      area += 0.5 * glm::length(glm::cross(glm::dvec3(p[t.y] - p[t.x]), glm::dvec3(p[t.z] - p[t.x])));
    }
    EXPECT_NEAR(area, 40.0, 0.01);
  }
}

TEST(ProceduralTest, EveryNamedSceneIsValid) {
  for (const char* name : {"plaza:30000", "hall:50000", "city:100000", "warehouse:100000", "random:500",
                           "terrain:20000", "hairball:3200"}) {
    const absl::StatusOr<Scene> scene = MakeProceduralScene(name);
    ASSERT_TRUE(scene.ok()) << scene.status();
    EXPECT_TRUE(Validate(*scene).ok());
    EXPECT_EQ(DegenerateTriangles(*scene), 0) << name;
    const auto wanted = double(std::stoi(std::string(name).substr(std::string(name).find(':') + 1)));
    EXPECT_NEAR(double(scene->TriangleCount()), wanted, 0.05 * wanted) << name;
    const std::string_view base = std::string_view(name).substr(0, std::string_view(name).find(':'));
    EXPECT_EQ(scene->name, base);
    if (const auto stand = ProceduralStandPoint(base)) {
      EXPECT_TRUE(glm::all(glm::greaterThan(stand->ws_eye, scene->WsBounds().min)));
      EXPECT_TRUE(glm::all(glm::lessThan(stand->ws_eye, scene->WsBounds().max)));
    }
  }
  const Scene hairball = *MakeProceduralScene("hairball:1600");
  EXPECT_NEAR(hairball.materials[1].transmittance.g, 0.9f, 1e-6f);
  EXPECT_TRUE(Validate(MakeDuelingFrusta().scene).ok());
  EXPECT_EQ(MakeProceduralScene("nowhere").status().code(), absl::StatusCode::kNotFound);
  for (const char* bad : {"plaza:", "plaza:x", "plaza:0", "plaza:-5", "hall:10"}) {
    EXPECT_EQ(MakeProceduralScene(bad).status().code(), absl::StatusCode::kInvalidArgument) << bad;
  }
}

}  // namespace
}  // namespace shadowfit
