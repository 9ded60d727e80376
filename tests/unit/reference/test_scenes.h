#pragma once

#include <cmath>
#include <glm/ext/matrix_clip_space.hpp>
#include <glm/ext/matrix_transform.hpp>
#include <glm/glm.hpp>
#include <random>
#include <utility>
#include <vector>

#include "core/frame/camera.h"
#include "core/math/shadow_projection.h"
#include "core/scene/scene.h"

namespace shadowfit {

inline Scene SceneOf(std::vector<glm::vec3> positions, std::vector<glm::uvec3> triangles) {
  Scene scene;
  scene.materials.emplace_back();
  Mesh& mesh = scene.meshes.emplace_back();
  mesh.positions = std::move(positions);
  mesh.triangles = std::move(triangles);
  scene.instances.push_back({.mesh = 0});
  return scene;
}

/// Adds the parallelogram a, a+u, a+u+v, a+v to the scene's first mesh.
inline void AddQuad(Scene* scene, glm::vec3 a, glm::vec3 u, glm::vec3 v) {
  Mesh& mesh = scene->meshes[0];
  const auto base = uint32_t(mesh.positions.size());
  mesh.positions.insert(mesh.positions.end(), {a, a + u, a + u + v, a + v});
  mesh.triangles.emplace_back(base, base + 1, base + 2);
  mesh.triangles.emplace_back(base, base + 2, base + 3);
}

inline CameraMatrices LookAt(glm::dvec3 eye, glm::dvec3 target, double fov = 1.0, double near = 0.1,
                             double far = 100.0) {
  CameraMatrices matrices;
  matrices.view_from_world = glm::lookAt(eye, target, glm::dvec3(0.0, 0.0, 1.0));
  matrices.clip_from_view = glm::perspectiveRH_NO(fov, 1.0, near, far);
  return matrices;
}

/// A square map over the box [-half, half]^2 of the first two ray coordinates, divided by the third.
inline ShadowProjection CenteredMap(int size, double half) {
  const double scale = 0.5 * size / half;
  ShadowProjection projection;
  projection.texel_from_ray = glm::transpose(glm::dmat3(
      glm::dvec3(scale, 0.0, 0.5 * size), glm::dvec3(0.0, scale, 0.5 * size), glm::dvec3(0.0, 0.0, 1.0)));
  projection.size = {size, size};
  return projection;
}

}  // namespace shadowfit
