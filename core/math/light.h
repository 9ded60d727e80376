#pragma once

#include <glm/glm.hpp>
#include <variant>

namespace shadowfit {

/// Shines in all directions from a point.
struct PointLight {
  glm::dvec3 ws_position{0.0};  ///< World space, finite.
};

/// Shines from a point into a cone.
struct SpotLight {
  glm::dvec3 ws_position{0.0};                   ///< World space, finite.
  glm::dvec3 ws_direction{0.0, 0.0, -1.0};       ///< Axis of the cone, any length but zero.
  double outer_half_angle = 0.7853981633974483;  ///< From axis to rim, radians, in (0, pi/2).
};

/// Shines along one direction from infinitely far away.
struct DirectionalLight {
  glm::dvec3 ws_direction{0.0, 0.0, -1.0};  ///< The way light travels, any length but zero.
};

using Light = std::variant<PointLight, SpotLight, DirectionalLight>;

}  // namespace shadowfit
