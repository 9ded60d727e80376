#pragma once

#include <algorithm>
#include <cmath>
#include <glm/glm.hpp>

#include "core/math/clip_space.h"
#include "core/math/ray_space.h"

namespace shadowfit {

/// Size of a shadow map in texels.
struct MapSize {
  int width = 0;
  int height = 0;
  double texels() const { return double(width) * double(height); }
  friend bool operator==(const MapSize&, const MapSize&) = default;
};

/// The whole sides of a map of at most so many texels (one at least) and about this ratio of width to height.
inline MapSize SizeOfTexels(double texels, double aspect) {
  const int width = std::max(1, static_cast<int>(std::sqrt(texels * aspect)));
  return {width, std::max(1, static_cast<int>(texels / width))};
}

/// What a map's width or height is rounded to.
enum class SizeRounding {
  kExact,        ///< Whole texels.
  kMultipleOf8,  ///< As many GPUs tile their textures.
  kPowerOfTwo,
};

/// Where one shadow map's texels lie: the homography H from ray coordinates to texel coordinates (rows h1,
/// h2, h3; |h3| = 1),
///
///   u_i = (h_i . r) / (h_3 . r),  i = 1, 2,     valid where h_3 . r > 0,
///
/// u in [0,width] x [0,height] with texel centres at i + 0.5 and v growing upwards in clip space.
struct ShadowProjection {
  glm::dmat3 texel_from_ray{1.0};  ///< Column-major as all of GLM: texel_from_ray * r is (u1 w, u2 w, w).
  MapSize size;

  glm::dvec3 Axis() const { return glm::transpose(texel_from_ray)[2]; }

  /// Texel coordinates and w = h3.r of ray coordinates; meaningless where the returned z <= 0.
  glm::dvec3 TexelFromRay(const glm::dvec3& r) const {
    const glm::dvec3 homogeneous = texel_from_ray * r;
    return {homogeneous.x / homogeneous.z, homogeneous.y / homogeneous.z, homogeneous.z};
  }

  /// Whether a ray falls onto the map, or within `margin` texels of it.
  bool Holds(const glm::dvec3& r, double margin = 0.0) const {
    const glm::dvec3 u = TexelFromRay(r);
    return u.z > 0.0 && u.x >= -margin && u.x <= size.width + margin && u.y >= -margin &&
           u.y <= size.height + margin;
  }
};

/// The range of (q - q_origin) / (h3.r) (see RaySpace) that a map's depth covers. For a point light q_origin
/// is 0 and the quotient is 1/w, falling from the near to the far plane; for a directional one it is the
/// warped distance beyond q_origin.
struct DepthRange {
  double q_origin = 0.0;
  double near_q_over_w = 0.0;
  double far_q_over_w = 1.0;
};

/// The 4x4 world-to-clip matrix of a projection: rows [s h1 G; s h2 G; alpha (Q - q_origin) + beta h3 G; h3
/// G] with u rescaled to clip range [-1,1] and Q the along-ray row, so that depth is monotone along every
/// light ray. Casters nearer than `range` must be clamped to the near plane (GL_DEPTH_CLAMP, "pancaking"),
/// not clipped.
glm::dmat4 ClipFromWorld(const RaySpace& ray_space, const ShadowProjection& projection,
                         const DepthRange& range, ClipDepth convention);

/// The same map, mirrored if need be so that triangles keep their winding: counter-clockwise as seen from the
/// light is counter-clockwise in clip space, as renderers that cull faces expect of any camera. Every texel
/// keeps its shape.
ShadowProjection KeepWinding(const ShadowProjection& projection);

/// The inverse of ClipFromWorld as far as texels go: the homography that a world-to-clip matrix of this light
/// means. False where the matrix does not belong to the light (its rows are not multiples of G's: it would
/// map the light itself, or the light's direction, into the picture) or is singular.
bool ProjectionFromClip(const RaySpace& ray_space, const glm::dmat4& clip_from_world, MapSize size,
                        ShadowProjection* projection);

}  // namespace shadowfit
