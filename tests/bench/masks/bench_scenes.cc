#include "tests/bench/masks/bench_scenes.h"

#include <cmath>
#include <glm/gtc/matrix_transform.hpp>
#include <numbers>
#include <random>
#include <string>
#include <utility>

#include "core/scene/procedural.h"

namespace shadowfit::bench {
namespace {

using std::numbers::pi;

CameraMatrices LookAt(const glm::dvec3& eye, const glm::dvec3& target, double vertical_degrees, double aspect,
                      const glm::dvec3& up = glm::dvec3(0, 1, 0)) {
  CameraMatrices camera;
  camera.view_from_world = glm::lookAt(eye, target, up);
  camera.clip_from_view = glm::perspective(glm::radians(vertical_degrees), aspect, 0.1, 100.0);
  return camera;
}

void AddMesh(Mesh mesh, Scene* scene) {
  Instance& instance = scene->instances.emplace_back();
  instance.mesh = static_cast<int>(scene->meshes.size());
  scene->meshes.push_back(std::move(mesh));
}

Mesh Floor(float size) {
  Mesh mesh;
  mesh.positions = {{-size, 0, -size}, {size, 0, -size}, {size, 0, size}, {-size, 0, size}};
  mesh.triangles = {{0, 2, 1}, {0, 3, 2}};
  return mesh;
}

BenchScene GeneratedScene(const std::string& name, Scene scene, const StandPoint& stand,
                          double vertical_degrees, const glm::dvec3& ws_light) {
  BenchScene bench;
  bench.name = name;
  bench.scene = std::move(scene);
  bench.camera = LookAt(stand.ws_eye, stand.ws_target, vertical_degrees, 1024.0 / 768.0, glm::dvec3(0, 0, 1));
  bench.light.ws_position = ws_light;
  return bench;
}

}  // namespace

BenchScene RandomTriangles(size_t count, int width, int height) {
  BenchScene bench;
  bench.name =
      count % 1000000 == 0 ? std::to_string(count / 1000000) + " M" : std::to_string(count / 1000) + " K";
  bench.width = width;
  bench.height = height;
  bench.scene.materials.emplace_back();
  AddMesh(Floor(20.0f), &bench.scene);
  std::mt19937 random(42);
  std::uniform_real_distribution<float> unit(0.0f, 1.0f);
  std::normal_distribution<float> normal;
  constexpr double kTotalArea = 100.0;
  // A random triangle with corners on a sphere of radius s has a mean area of about 0.72 s^2.
  const auto size = static_cast<float>(std::sqrt(kTotalArea / (0.72 * static_cast<double>(count))));
  Mesh mesh;
  for (size_t i = 0; i < count; ++i) {
    const glm::vec3 centre(10.0f * unit(random) - 5.0f, 0.5f + 4.5f * unit(random),
                           10.0f * unit(random) - 5.0f);
    const auto base = static_cast<uint32_t>(mesh.positions.size());
    for (int corner = 0; corner < 3; ++corner) {
      const glm::vec3 direction = glm::normalize(glm::vec3(normal(random), normal(random), normal(random)));
      mesh.positions.push_back(centre + size * direction);
    }
    mesh.triangles.emplace_back(base, base + 1, base + 2);
  }
  AddMesh(std::move(mesh), &bench.scene);
  bench.camera = LookAt({0, 7, 13}, {0, 1, 0}, 45.0, double(width) / height);
  bench.light.ws_position = {3, 14, 2};
  return bench;
}

BenchScene Terrain(int cells) {
  BenchScene bench;
  bench.name = "terrain";
  bench.scene.materials.emplace_back();
  Mesh mesh;
  const auto height = [](double x, double z) {
    double h = 0.0, amplitude = 0.8, frequency = 0.5;
    for (int octave = 0; octave < 7; ++octave) {
      h += amplitude * std::sin(frequency * x + 1.3 * octave) *
           std::cos(frequency * z + 2.1 * octave + 0.5 * x);
      amplitude *= 0.5;
      frequency *= 2.03;
    }
    return h;
  };
  for (int j = 0; j <= cells; ++j) {
    for (int i = 0; i <= cells; ++i) {
      const double x = 20.0 * i / cells - 10.0, z = 20.0 * j / cells - 10.0;
      mesh.positions.emplace_back(x, height(x, z), z);
    }
  }
  const auto index = [cells](int i, int j) { return static_cast<uint32_t>(j * (cells + 1) + i); };
  for (int j = 0; j < cells; ++j) {
    for (int i = 0; i < cells; ++i) {
      mesh.triangles.emplace_back(index(i, j), index(i, j + 1), index(i + 1, j));
      mesh.triangles.emplace_back(index(i + 1, j), index(i, j + 1), index(i + 1, j + 1));
    }
  }
  AddMesh(std::move(mesh), &bench.scene);
  bench.camera = LookAt({0, 6, 13}, {0, 0, 0}, 45.0, 1024.0 / 768.0);
  bench.light.ws_position = {-14, 7, -4};
  return bench;
}

BenchScene HairBall(int hairs) {
  BenchScene bench;
  bench.name = "hair ball";
  bench.width = 1536;
  bench.height = 1088;
  bench.scene.materials.emplace_back();
  Material& hair = bench.scene.materials.emplace_back();
  hair.name = "hair";
  hair.transmittance = glm::vec3(0.9f);
  AddMesh(Floor(20.0f), &bench.scene);
  std::mt19937 random(4242);
  std::normal_distribution<double> normal;
  Mesh mesh;
  mesh.material = 1;
  constexpr int kSegments = 96;  // Three sides of two triangles each: 576 a hair.
  for (int h = 0; h < hairs; ++h) {
    glm::dvec3 direction = glm::normalize(glm::dvec3(normal(random), normal(random), normal(random)));
    const glm::dvec3 bend = 0.35 * glm::dvec3(normal(random), normal(random), normal(random));
    const glm::dvec3 curl =
        glm::normalize(glm::cross(direction, glm::dvec3(normal(random), normal(random), normal(random))));
    glm::dvec3 p = glm::dvec3(0, 3.2, 0) + 0.8 * direction;
    const double step = 2.0 / kSegments, radius = 0.004;
    const auto base = static_cast<uint32_t>(mesh.positions.size());
    for (int s = 0; s <= kSegments; ++s) {
      const double t = double(s) / kSegments;
      const glm::dvec3 tangent = glm::normalize(direction + t * bend + 0.4 * std::sin(9.0 * t) * curl);
      const glm::dvec3 side = glm::normalize(glm::cross(tangent, curl + glm::dvec3(0.01, 0.02, 0.03)));
      const glm::dvec3 up = glm::cross(side, tangent);
      for (int k = 0; k < 3; ++k) {
        const double angle = 2.0 * pi * k / 3.0;
        mesh.positions.emplace_back(p + radius * (1.0 - 0.7 * t) *
                                            (std::cos(angle) * side + std::sin(angle) * up));
      }
      p += step * tangent;
    }
    for (uint32_t s = 0; s < kSegments; ++s) {
      for (uint32_t k = 0; k < 3; ++k) {
        const uint32_t a = base + 3 * s + k, b = base + 3 * s + (k + 1) % 3;
        mesh.triangles.emplace_back(a, b, a + 3);
        mesh.triangles.emplace_back(b, b + 3, a + 3);
      }
    }
  }
  AddMesh(std::move(mesh), &bench.scene);
  bench.camera = LookAt({0, 4.5, 8.5}, {0, 2.6, 0}, 45.0, 1536.0 / 1088.0);
  bench.light.ws_position = {4, 12, 5};
  return bench;
}

BenchScene Plaza() {
  return GeneratedScene("plaza", MakePlaza().value(), PlazaStandPoint(), 45.0, {5, -4, 14});
}

BenchScene Hall() { return GeneratedScene("hall", MakeHall().value(), HallStandPoint(), 60.0, {2, 1, 6}); }

}  // namespace shadowfit::bench
