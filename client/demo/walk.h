#pragma once

#include <glm/glm.hpp>
#include <string>
#include <vector>

#include "core/frame/camera.h"
#include "core/math/light.h"
#include "core/scene/scene.h"

namespace shadowfit {

/// A light as a scene is lit by it.
struct SceneLight {
  std::string name;
  Light light;
  glm::dvec3 power{1.0};  ///< RGB: irradiance of a directional light, intensity of others.
};

/// A camera's way through a lit scene.
struct Walk {
  std::vector<CameraMatrices> cameras;  ///< One a frame, OpenGL depth.
  std::vector<SceneLight> lights;
  double vertical_fov = 1.0471975511965976;  ///< Radians.
  double near = 0.2;                         ///< Metres.
  double far = 300.0;
};

/// A walk of `frames` >= 1 frames under `lights` lights, 1 to 32: the sun, then lamps, spot and point by
/// turns. The Sterngarten and the plaza have a way of their own; in other scenes the camera goes around the
/// middle.
Walk PlanWalk(const Scene& scene, int frames, int lights, double aspect);

}  // namespace shadowfit
