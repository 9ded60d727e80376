#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <random>
#include <utility>
#include <vector>

#include "core/math/light.h"
#include "core/scene/scene.h"

namespace shadowfit {

inline Scene OneMeshScene(std::vector<glm::vec3> positions, std::vector<glm::uvec3> triangles) {
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
  /// `huge`: triangles up to a million times as large as the rest. Ray tracers in single precision lose what
  /// is near them; extended precision does not.
  explicit RandomScenes(uint32_t seed, bool huge = true) : random_(seed), huge_(huge) {}

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
      const double size = kind == 3   ? (huge_ ? 1000.0 : 30.0)
                          : kind == 4 ? 1e-3
                          : kind == 5 ? (huge_ ? 1e6 : 5.0)
                                      : 1.0;
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
  bool huge_;
};

}  // namespace shadowfit
