#include "core/resolution/light_maps.h"

#include <cmath>

#include "absl/status/status.h"
#include "core/math/shadow_projection.h"

namespace shadowfit::resolution {
namespace {

/// The world direction in which a point at the middle of the near plane moves as NDC coordinate `axis` grows.
glm::dvec3 CameraAxis(const Camera& camera, int axis) {
  const double near_ndc = NearNdc(camera.clip_depth());
  glm::dvec3 forward(0.0, 0.0, near_ndc);
  glm::dvec3 backward(0.0, 0.0, near_ndc);
  forward[axis] = 0.5;
  backward[axis] = -0.5;
  const glm::dvec4 a = camera.WsFromNdc(forward);
  const glm::dvec4 b = camera.WsFromNdc(backward);
  return glm::normalize(glm::dvec3(a) / a.w - glm::dvec3(b) / b.w);
}

/// A frustum, or a parallel beam, along the unit vector `forward`, its x axis as near to `right` as can be.
/// Where that runs along `forward` itself, its y axis is as near to `up` as can be.
glm::dmat3 PictureAlong(const RaySpace& ray_space, const glm::dvec3& forward, const glm::dvec3& right,
                        const glm::dvec3& up, double tangent) {
  glm::dvec3 x_axis = right - glm::dot(right, forward) * forward;
  if (glm::length(x_axis) < 1e-6) x_axis = glm::cross(forward, up);
  x_axis = glm::normalize(x_axis);
  const glm::dvec3 y_axis = glm::cross(x_axis, forward);
  // Axes of the world become rows that act on ray coordinates, whose linear part is orthonormal.
  const glm::dvec3 w_row =
      ray_space.is_directional() ? glm::dvec3(0.0, 0.0, 1.0) : ray_space.RayFromVector(forward);
  return glm::transpose(glm::dmat3(ray_space.RayFromVector(x_axis) / tangent,
                                   ray_space.RayFromVector(y_axis) / tangent, w_row));
}

}  // namespace

absl::StatusOr<std::vector<LightMap>> MapsOfLight(const Light& light, const RaySpace& ray_space,
                                                  const Camera& camera,
                                                  const std::optional<glm::dmat4>& clip_from_world) {
  if (clip_from_world) {
    ShadowProjection projection;
    if (!ProjectionFromClip(ray_space, *clip_from_world, {2, 2}, &projection)) {
      return absl::InvalidArgumentError("previous_world_to_shadow_clip: not a regular matrix of this light");
    }
    // Texels of a 2x2 map, moved by one, are clip coordinates.
    glm::dmat3 rows = glm::transpose(projection.texel_from_ray);
    rows[0] -= rows[2];
    rows[1] -= rows[2];
    return std::vector<LightMap>{{.picture_from_ray = glm::transpose(rows)}};
  }
  const glm::dvec3 right = CameraAxis(camera, 0);
  const glm::dvec3 up = CameraAxis(camera, 1);
  if (const auto* spot = std::get_if<SpotLight>(&light)) {
    const double tangent = std::tan(spot->outer_half_angle);
    return std::vector<LightMap>{
        {.picture_from_ray = PictureAlong(ray_space, ray_space.ws_direction(), right, up, tangent),
         .inscribed_cone = true}};
  }
  if (ray_space.is_directional()) {
    return std::vector<LightMap>{
        {.picture_from_ray = PictureAlong(ray_space, ray_space.ws_direction(), right, up, 1.0),
         .bounded = false}};
  }
  std::vector<LightMap> faces;
  const glm::dvec3 forward = glm::normalize(glm::cross(up, right));
  const glm::dvec3 true_up = glm::cross(right, forward);
  for (const glm::dvec3& face : {forward, -forward, right, -right, true_up, -true_up}) {
    faces.push_back({.picture_from_ray = PictureAlong(ray_space, face, right, up, 1.0)});
  }
  return faces;
}

}  // namespace shadowfit::resolution
