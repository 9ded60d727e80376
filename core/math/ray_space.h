#pragma once

#include <glm/glm.hpp>
#include <optional>

#include "absl/status/statusor.h"
#include "core/math/light.h"

namespace shadowfit {

/// A light's ray coordinates: a linear map G that gives every world point X a 3-vector r = G [X; 1] which is
/// constant along a light ray up to scale. A light matrix acts on r as a 3x3 homography, so that point, spot
/// and directional lights are one case from here on.
///
///   light            G                                   r
///   point, spot      [ R | -R L ], R a rotation          R (X - L)
///   directional      rows a1, a2 (orthonormal to d), 0   (a1.X, a2.X, 1)
///
/// Beside r there is q, the coordinate along the ray: 1 for a point light, whose r already grows along the
/// ray, and the distance d.X along the light's direction for a directional one. Receivers at ray coordinates
/// r and along-ray coordinate q have depth alpha q / (h3.r) + beta in a light matrix with last row h3 G.
class RaySpace {
 public:
  /// Fails with InvalidArgument where a position or direction is not finite, a direction has zero length, or
  /// a spot's angle is outside (0, pi/2). The message names the member and its value.
  static absl::StatusOr<RaySpace> Create(const Light& light);

  bool is_directional() const { return directional_; }

  /// Ray coordinates of a world point. For a directional light r.z = 1.
  glm::dvec3 RayFromPoint(const glm::dvec3& ws_point) const { return linear_ * ws_point + offset_; }

  /// Derivative of the ray coordinates along a world vector: G [v; 0].
  glm::dvec3 RayFromVector(const glm::dvec3& ws_vector) const { return linear_ * ws_vector; }

  /// Along-ray coordinate q of a world point; see the class comment.
  double AlongRay(const glm::dvec3& ws_point) const {
    return directional_ ? glm::dot(ws_direction_, ws_point) : 1.0;
  }

  /// The world point of ray coordinates and along-ray coordinate: undoes RayFromPoint with AlongRay.
  glm::dvec3 PointFromRay(const glm::dvec3& r, double q) const;

  /// From a surface point towards the light, not normalised.
  glm::dvec3 TowardsLight(const glm::dvec3& ws_point) const {
    return directional_ ? -ws_direction_ : ws_position_ - ws_point;
  }

  /// True where the light shines at all: everywhere but outside a spot's cone.
  bool Illuminates(const glm::dvec3& ws_point) const;

  /// The world-space ray of ray coordinates r: every X(t) = origin + t * direction with t > 0 (point, spot)
  /// or any t (directional) has ray coordinates proportional to r.
  struct WsRay {
    glm::dvec3 origin;
    glm::dvec3 direction;
  };
  WsRay WorldRay(const glm::dvec3& r) const;

  const glm::dmat3& linear() const { return linear_; }
  const glm::dvec3& offset() const { return offset_; }
  /// Unit direction of travel (directional) or of the axis (spot); zero for a point light.
  const glm::dvec3& ws_direction() const { return ws_direction_; }
  /// Position of a point or spot light; zero for a directional one.
  const glm::dvec3& ws_position() const { return ws_position_; }
  /// Cosine of a spot's outer half angle; none for other lights.
  std::optional<double> cos_outer() const { return cos_outer_; }

 private:
  bool directional_ = false;
  glm::dmat3 linear_{1.0};
  glm::dvec3 offset_{0.0};
  glm::dvec3 ws_position_{0.0};
  glm::dvec3 ws_direction_{0.0};
  std::optional<double> cos_outer_;
};

}  // namespace shadowfit
