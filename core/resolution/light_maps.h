#pragma once

#include <glm/glm.hpp>
#include <optional>
#include <vector>

#include "absl/status/statusor.h"
#include "core/frame/camera.h"
#include "core/math/light.h"
#include "core/math/ray_space.h"

namespace shadowfit::resolution {

/// One picture that a light's shadow map could be cut from: p = picture_from_ray * r is (x w, y w, w), and
/// the light or its frustum fills -1 <= x, y <= 1.
struct LightMap {
  glm::dmat3 picture_from_ray{1.0};  ///< Its third row has unit length.
  bool bounded = true;               ///< False: the light has no frustum; x and y are lengths in the world.
  bool inscribed_cone = false;  ///< The light's own cone lies inside the square, so the square needs no test.
};

/// The maps of a light: those of the matrix where one is given; otherwise a spot's square around its cone, a
/// directional light's plane, or six faces of a cube around a point light. The axes of all of these are
/// turned towards the camera's, so that a light in the camera's place sees the camera's own pixel grid. Fails
/// where the matrix is not this light's.
absl::StatusOr<std::vector<LightMap>> MapsOfLight(const Light& light, const RaySpace& ray_space,
                                                  const Camera& camera,
                                                  const std::optional<glm::dmat4>& clip_from_world);

}  // namespace shadowfit::resolution
