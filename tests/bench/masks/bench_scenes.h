#pragma once

#include <string>
#include <vector>

#include "core/frame/camera.h"
#include "core/math/light.h"
#include "core/scene/scene.h"

namespace shadowfit::bench {

struct BenchScene {
  std::string name;
  Scene scene;
  CameraMatrices camera;
  PointLight light;
  int width = 1024;
  int height = 768;
};

/// `count` random triangles of constant total area above a floor, as in Aila and Laine's Table 1.
BenchScene RandomTriangles(size_t count, int width = 1024, int height = 768);
/// A connected height field of 2 * cells^2 triangles.
BenchScene Terrain(int cells);
/// Hairs of 576 triangles each, at 10 % opacity, over a floor.
BenchScene HairBall(int hairs);

/// The built-in plaza of TR-07-07's size under a lamp above its middle, and the built-in hall, lit from
/// inside.
BenchScene Plaza();
BenchScene Hall();

}  // namespace shadowfit::bench
