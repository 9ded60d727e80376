#include "core/irregular/clustered_mesh.h"

#include <gtest/gtest.h>
#include <hwy/highway.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <iostream>
#include <random>
#include <string>
#include <vector>

#include "core/irregular/shadow_masks.h"
#include "core/scene/procedural.h"
#include "tests/unit/irregular/random_scenes.h"

namespace shadowfit {
namespace {

using irregular::ClusteredMesh;

/// Who has a vertex of one's own?
enum class Owner { kNobody, kQuad, kTriangle };

/// A wavy sheet of n * n quads, with texture coordinates.
Mesh Sheet(int n, Owner owner) {
  Mesh mesh;
  const auto vertex = [&](int i, int j) {
    const float x = 2.0f * static_cast<float>(i) / static_cast<float>(n) - 1.0f;
    const float y = 2.0f * static_cast<float>(j) / static_cast<float>(n) - 1.0f;
    mesh.positions.emplace_back(x, y, 0.3f * std::sin(4.0f * x) * std::cos(5.0f * y));
    mesh.uvs.emplace_back(3.0f * x, 2.0f * y);
    return static_cast<uint32_t>(mesh.positions.size() - 1);
  };
  if (owner == Owner::kNobody) {
    for (int j = 0; j <= n; ++j) {
      for (int i = 0; i <= n; ++i) vertex(i, j);
    }
  }
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < n; ++i) {
      if (owner == Owner::kTriangle) {
        const uint32_t a = vertex(i, j), b = vertex(i + 1, j), c = vertex(i + 1, j + 1);
        mesh.triangles.emplace_back(a, b, c);
        const uint32_t d = vertex(i, j), e = vertex(i + 1, j + 1), f = vertex(i, j + 1);
        mesh.triangles.emplace_back(d, e, f);
        continue;
      }
      const auto at = [&](int x, int y) {
        return owner == Owner::kQuad ? vertex(x, y) : static_cast<uint32_t>(y * (n + 1) + x);
      };
      const uint32_t a = at(i, j), b = at(i + 1, j), c = at(i + 1, j + 1), d = at(i, j + 1);
      mesh.triangles.emplace_back(a, b, c);
      mesh.triangles.emplace_back(a, c, d);
    }
  }
  return mesh;
}

using Corner = std::array<float, 5>;  ///< x, y, z, u, v
using Triangle = std::array<Corner, 3>;

std::vector<Triangle> TrianglesOf(const Mesh& mesh) {
  std::vector<Triangle> triangles;
  for (const glm::uvec3& t : mesh.triangles) {
    Triangle& triangle = triangles.emplace_back();
    for (int i = 0; i < 3; ++i) {
      const glm::vec3& p = mesh.positions[t[i]];
      const glm::vec2& uv = mesh.uvs[t[i]];
      triangle[static_cast<size_t>(i)] = {p.x, p.y, p.z, uv.x, uv.y};
    }
  }
  std::sort(triangles.begin(), triangles.end());
  return triangles;
}

/// As the header describes the lines.
std::vector<Triangle> TrianglesOf(const ClusteredMesh& mesh) {
  constexpr size_t kBlock = irregular::kBlock;
  std::vector<Triangle> triangles;
  for (const ClusteredMesh::Cluster& cluster : mesh.clusters()) {
    const float* const lines = mesh.LinesOf(cluster);
    const float* const uvs = mesh.UvsOf(cluster);
    const auto* const numbers = reinterpret_cast<const uint8_t*>(lines);
    for (size_t i = 0; i < cluster.block_count * kBlock; ++i) {
      Triangle triangle;
      for (size_t corner = 0; corner < 3; ++corner) {
        const size_t place = (i / kBlock * 3 + corner) * kBlock + i % kBlock;
        size_t vertex = place;
        if (cluster.vertex_count != 0) {
          vertex = numbers[place];
          EXPECT_LT(vertex, cluster.vertex_count);
          const float* p = lines + cluster.block_count * ClusteredMesh::kNumberFloats + 4 * vertex;
          triangle[corner] = {p[0], p[1], p[2]};
        } else {
          const float* p = lines + (i / kBlock * 9 + corner * 3) * kBlock + i % kBlock;
          triangle[corner] = {p[0], p[kBlock], p[2 * kBlock]};
        }
        triangle[corner][3] = uvs[2 * vertex];
        triangle[corner][4] = uvs[2 * vertex + 1];
      }
      if (!std::isnan(triangle[0][0])) triangles.push_back(triangle);
    }
  }
  std::sort(triangles.begin(), triangles.end());
  return triangles;
}

TEST(ClusteredMesh, HoldsEveryTriangleOnce) {
  for (const Owner owner : {Owner::kNobody, Owner::kQuad, Owner::kTriangle}) {
    for (const int n : {1, 2, 3, 6, 7, 20, 33}) {
      const Mesh mesh = Sheet(n, owner);
      ClusteredMesh clustered;
      ASSERT_TRUE(clustered.Create(mesh, true));
      EXPECT_EQ(TrianglesOf(clustered), TrianglesOf(mesh)) << n;
      EXPECT_LE(clustered.MemoryBytes(), ClusteredMesh::MostBytes(mesh, true)) << n;
    }
  }
}

TEST(ClusteredMesh, AnEmptyMeshHasNoClusters) {
  ClusteredMesh clustered;
  ASSERT_TRUE(clustered.Create(Mesh{}, false));
  EXPECT_TRUE(clustered.clusters().empty());
  EXPECT_LE(clustered.MemoryBytes(), ClusteredMesh::MostBytes(Mesh{}, false));
}

TEST(ClusteredMesh, MovesItsVertices) {
  for (const Owner owner : {Owner::kNobody, Owner::kQuad, Owner::kTriangle}) {
    Mesh mesh = Sheet(21, owner);
    ClusteredMesh clustered;
    ASSERT_TRUE(clustered.Create(mesh, true));
    for (glm::vec3& p : mesh.positions) p += glm::vec3(0.5f * p.z, -1.0f, 0.25f * p.x * p.y);
    clustered.SetPositions(mesh.positions);
    EXPECT_EQ(TrianglesOf(clustered), TrianglesOf(mesh));
  }
}

/// Nothing a triangle beyond the mesh, but for vertices that two clusters share, what a cluster takes by
/// itself, and what is left of its last line.
TEST(ClusteredMesh, TakesNoMoreMemoryThanTheMesh) {
  for (const Owner owner : {Owner::kNobody, Owner::kQuad, Owner::kTriangle}) {
    const Mesh mesh = Sheet(200, owner);
    ClusteredMesh clustered;
    ASSERT_TRUE(clustered.Create(mesh, false));
    const size_t bytes =
        mesh.positions.size() * sizeof(glm::vec3) + mesh.triangles.size() * sizeof(glm::uvec3);
    const auto a_triangle = [&mesh](size_t all) {
      return static_cast<double>(all) / static_cast<double>(mesh.triangles.size());
    };
    std::cout << a_triangle(clustered.MemoryBytes()) << " bytes a triangle, as a mesh " << a_triangle(bytes)
              << '\n';
    EXPECT_LE(static_cast<double>(clustered.MemoryBytes()), 1.08 * static_cast<double>(bytes));
  }
}

/// Few vertices are looked up in registers, many in memory, and separate corners are read as they are; in
/// each case an instance elsewhere is the same as a mesh with its positions there, holes and all.
TEST(ClusteredMesh, MasksDoNotDependOnItsForm) {
  glm::mat4x3 transform(1.0f);
  transform[0] = {0.8f, 0.3f, 0.1f};
  transform[1] = {-0.25f, 0.9f, -0.2f};
  transform[2] = {0.1f, 0.05f, 1.1f};
  transform[3] = {0.3f, -0.2f, 1.5f};
  constexpr int kSize = 128;
  std::vector<glm::vec3> points;
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) points.emplace_back(4.0f * x / kSize - 2, 4.0f * y / kSize - 2, 0);
  }
  ReceiverLayer layer;
  layer.ws_positions = BottomFirst(points.data(), kSize, kSize);
  const std::vector<Light> lights = {PointLight{{0.4, 0.3, 6}}, DirectionalLight{{0.2, -0.1, -1}}};
  std::vector<std::vector<uint8_t>> expected;
  for (int64_t targets = hwy::SupportedTargets(); targets != 0; targets &= targets - 1) {
    hwy::SetSupportedTargetsForTest(targets);
    for (const Owner owner : {Owner::kNobody, Owner::kQuad, Owner::kTriangle}) {
      for (const bool placed_before : {false, true}) {
        Scene scene = OneMeshScene({}, {});
        Mesh& mesh = scene.meshes[0];
        mesh = Sheet(21, owner);
        ClusteredMesh clustered;
        ASSERT_TRUE(clustered.Create(mesh, true));
        const uint16_t vertices = clustered.clusters()[0].vertex_count;
        switch (owner) {
          case Owner::kNobody:
            ASSERT_TRUE(vertices > 0 && vertices <= 64) << vertices;
            break;
          case Owner::kQuad:
            ASSERT_GT(vertices, 64);
            break;
          case Owner::kTriangle:
            ASSERT_EQ(vertices, 0);
            break;
        }
        if (placed_before) {
          for (glm::vec3& p : mesh.positions) p = transform * glm::vec4(p, 1.0f);
        } else {
          scene.instances[0].world_from_object = transform;
        }
        scene.materials[0].alpha_texture = 0;
        AlphaTexture& texture = scene.alpha_textures.emplace_back();
        texture.width = texture.height = 8;
        std::mt19937 random(3);
        for (int i = 0; i < 64; ++i) texture.alpha.push_back(static_cast<uint8_t>(random() % 256));
        const auto mask_scene = MaskScene::Create(scene);
        ASSERT_TRUE(mask_scene.ok()) << mask_scene.status();
        EXPECT_LE(mask_scene->MemoryBytes(), MaskScene::MostBytes(scene));
        MaskRequest request;
        request.scene = &*mask_scene;
        request.layers = {&layer, 1};
        request.lights = lights;
        MaskRenderer renderer;
        const auto masks = renderer.Render(request);
        ASSERT_TRUE(masks.ok()) << masks.status();
        std::vector<std::vector<uint8_t>> bits;
        for (const LightMask& mask : *masks) {
          bits.emplace_back(mask.bits.begin(), mask.bits.end());
          EXPECT_GT(mask.shadowed_samples, 1000u);
          EXPECT_LT(mask.shadowed_samples, points.size() / 2);
        }
        if (expected.empty()) expected = bits;
        EXPECT_EQ(bits, expected) << "targets " << targets << ", vertices " << vertices << ", placed before "
                                  << placed_before;
      }
    }
  }
  hwy::SetSupportedTargetsForTest(0);
}

}  // namespace
}  // namespace shadowfit
