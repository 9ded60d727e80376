#include "core/math/shadow_projection.h"

#include <cmath>

namespace shadowfit {
namespace {

/// The world row vector h G of a ray-space row vector h.
glm::dvec4 WorldRow(const RaySpace& ray_space, const glm::dvec3& h) {
  return {glm::transpose(ray_space.linear()) * h, glm::dot(h, ray_space.offset())};
}

/// The world row Q with Q [X;1] = q - q_origin.
glm::dvec4 AlongRayRow(const RaySpace& ray_space, double q_origin) {
  if (ray_space.is_directional()) return {ray_space.ws_direction(), -q_origin};
  return {0.0, 0.0, 0.0, 1.0 - q_origin};
}

}  // namespace

glm::dmat4 ClipFromWorld(const RaySpace& ray_space, const ShadowProjection& projection,
                         const DepthRange& range, ClipDepth convention) {
  const glm::dmat3 rows = glm::transpose(projection.texel_from_ray);
  const glm::dvec3 clip_x = rows[0] * (2.0 / projection.size.width) - rows[2];
  const glm::dvec3 clip_y = rows[1] * (2.0 / projection.size.height) - rows[2];

  const double near_ndc = NearNdc(convention);
  const double far_ndc = FarNdc(convention);
  const double span = range.far_q_over_w - range.near_q_over_w;
  const double alpha = (far_ndc - near_ndc) / span;
  const double beta = near_ndc - alpha * range.near_q_over_w;

  const glm::dvec4 w_row = WorldRow(ray_space, rows[2]);
  return glm::transpose(glm::dmat4(WorldRow(ray_space, clip_x), WorldRow(ray_space, clip_y),
                                   alpha * AlongRayRow(ray_space, range.q_origin) + beta * w_row, w_row));
}

ShadowProjection KeepWinding(const ShadowProjection& projection) {
  // An unmirrored camera has (right, up, look) left-handed, as its third axis points backwards; ray space is
  // right-handed with look as its third axis.
  if (glm::determinant(projection.texel_from_ray) < 0.0) return projection;
  ShadowProjection mirrored = projection;
  for (int column = 0; column < 3; ++column) {
    glm::dvec3& c = mirrored.texel_from_ray[column];
    c.x = projection.size.width * c.z - c.x;  // u1 becomes width - u1.
  }
  return mirrored;
}

bool ProjectionFromClip(const RaySpace& ray_space, const glm::dmat4& clip_from_world, MapSize size,
                        ShadowProjection* projection) {
  const glm::dmat4 rows = glm::transpose(clip_from_world);
  glm::dvec3 h[3];
  const int row_of[3] = {0, 1, 3};
  for (int i = 0; i < 3; ++i) {
    const glm::dvec4 row = rows[row_of[i]];
    const glm::dvec3 ws(row);
    // The rows of G's linear part are orthonormal (or zero for a directional light's third).
    h[i] = ray_space.linear() * ws;
    if (ray_space.is_directional()) h[i].z = row.w;
    const glm::dvec4 back = WorldRow(ray_space, h[i]);
    const double scale = glm::length(ws) * (1.0 + glm::length(ray_space.offset())) + std::abs(row.w);
    if (!(glm::length(back - row) <= 1e-6 * scale)) return false;
  }
  const double axis_length = glm::length(h[2]);
  if (!(axis_length > 0.0) || !std::isfinite(axis_length)) return false;
  for (glm::dvec3& row : h) row /= axis_length;
  const glm::dvec3 u = (h[0] + h[2]) * (0.5 * size.width);
  const glm::dvec3 v = (h[1] + h[2]) * (0.5 * size.height);
  projection->texel_from_ray = glm::transpose(glm::dmat3(u, v, h[2]));
  projection->size = size;
  const double volume = std::abs(glm::determinant(projection->texel_from_ray));
  return std::isfinite(volume) && volume > 0.0;
}

}  // namespace shadowfit
