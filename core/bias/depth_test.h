#pragma once

#include <glm/glm.hpp>
#include <optional>

#include "core/math/ray_space.h"
#include "core/math/shadow_projection.h"

/// The arithmetic of a standard shadow map's depth test. Depth means window depth here, 0 at the near plane
/// of the map's DepthRange and 1 at the far plane, whatever the clip convention.
namespace shadowfit {

/// How a map stores depth.
enum class DepthFormat {
  kUnorm16,
  kUnorm24,
  kFloat32,
};

/// The value that a map of this format holds after `depth` was written: clamped to [0,1] and rounded.
double StoredDepth(DepthFormat format, double depth);

/// How far stored depth may lie from a receiver's own depth by rounding alone: that of the map, and that of
/// the receiver's arithmetic in float32.
double DepthRounding(DepthFormat format);

/// Depth of a point with homogeneous coordinates w = h3.r and along-ray coordinate q.
inline double WindowDepth(const DepthRange& range, double q, double w) {
  return ((q - range.q_origin) / w - range.near_q_over_w) / (range.far_q_over_w - range.near_q_over_w);
}

/// A receiver as the depth test sees it. Depth on its tangent plane is an affine function of texel
/// coordinates.
struct ReceiverDepth {
  glm::dvec2 texel{0.0};  ///< Where it falls on the map.
  double depth = 0.0;
  glm::dvec2 slope{0.0};     ///< Change of depth along the tangent plane, per texel in u and v.
  double ws_distance = 0.0;  ///< Along the light ray, world units, per unit of depth, at this receiver.

  /// How much depth changes at most over a texel's diagonal: |dz/du| + |dz/dv|, the measure that a receiver's
  /// own slope-scaled bias follows.
  double Steepness() const { return glm::abs(slope.x) + glm::abs(slope.y); }
  /// Polygon offset's measure of slope: max(|dz/du|, |dz/dv|).
  double MaxSlope() const { return glm::max(glm::abs(slope.x), glm::abs(slope.y)); }
};

/// Projects receivers into one map.
class ReceiverProjector {
 public:
  ReceiverProjector(const RaySpace& ray_space, const ShadowProjection& projection, const DepthRange& range);

  /// None where the point lies off the map or behind it, is not lit by the light, or its front (the side of
  /// `ws_normal`, unit length) faces away from the light.
  std::optional<ReceiverDepth> Project(const glm::dvec3& ws_point, const glm::dvec3& ws_normal) const;

  /// How far towards the light, in world units, a caster may stand off the receiver and still be passed over
  /// by a test with this bias. Never negative.
  double WsDetachment(const ReceiverDepth& receiver, const glm::dvec3& ws_point, double bias) const;

 private:
  const RaySpace& ray_space_;
  ShadowProjection projection_;
  DepthRange range_;
  glm::dmat3 ray_from_texel_;
};

}  // namespace shadowfit
