#pragma once

#include <cstddef>
#include <glm/glm.hpp>
#include <span>

#include "absl/status/statusor.h"
#include "core/bias/standard_test.h"
#include "core/frame/camera.h"
#include "core/frame/images.h"

/// Which bias a standard shadow map needs. A receiver is compared with the depth stored at a texel's centre,
/// up to half a texel away (and further with percentage-closer filtering); on a slope the surface itself is
/// nearer there, and without a bias shadows itself. Too much bias detaches shadows from what casts them.
namespace shadowfit {

struct BiasOptions {
  DepthFormat format = DepthFormat::kFloat32;
  /// Percentage-closer filtering reads (2 r + 1)^2 texels around the nearest. 0 to kMaxPcfRadius.
  int pcf_radius = 0;
  /// The picture in which detachment counts pixels.
  MapSize screen{1920, 1080};
  /// For callers that have a depth buffer: how many of its pixels to take at most, see SamplesFromDepth().
  size_t max_samples = 65536;
};

/// In units of window depth; a receiver is in shadow where
///
///   stored < depth - min(constant + slope * (|dz/du| + |dz/dv|), clamp),
///
/// dz/du and dz/dv the receiver's change of depth per texel.
struct SafeBias {
  /// The three that leave no acne on any visible sample, wherever it falls in its texel, and detach shadows
  /// least on average.
  double constant = 0.0;
  double slope = 0.0;
  /// The least constant that does it without a slope: where a surface is so steep that the other two ask for
  /// more, it ends within the texel.
  double clamp = 0.0;
  /// The same for casters: glPolygonOffsetClamp(polygon_offset_slope, polygon_offset_constant / r, clamp), r
  /// being the resolution of the depth format. Its measure of slope, max(|dz/du|, |dz/dv|), follows the texel
  /// less well and costs some detachment.
  double polygon_offset_constant = 0.0;
  double polygon_offset_slope = 0.0;
  /// The constant beside receiver-plane bias, which takes the slope out of the comparison: rounding alone,
  /// that of vertices included.
  double receiver_plane_constant = 0.0;

  /// How far off its receiver, along the light ray, a caster may stand and leave no shadow, in world units,
  /// over the samples.
  double ws_mean_detachment = 0.0;
  double ws_worst_detachment = 0.0;
  /// How wide the strip is that stays lit beside a caster that touches the receiver, in pixels of the screen.
  double mean_detachment_pixels = 0.0;
  double worst_detachment_pixels = 0.0;
  /// The mean detachment with the clamp for a constant, in world units.
  double ws_mean_detachment_of_constant = 0.0;

  int samples =
      0;  ///< Visible samples on the map that face the light. 0: all of the above is rounding alone.
};

/// From visible points and their unit normals; of the whole picture for a promise about every pixel, of a
/// small buffer for a good estimate. `depth`, where given, is the picture that the camera sees: a plane is
/// taken to end where it shows something farther away, which keeps surfaces that the light grazes from asking
/// for absurd biases. InvalidArgument where an option is out of range, the projection or depth range is
/// degenerate, or the spans differ in length.
absl::StatusOr<SafeBias> FindSafeBias(const Camera& camera, std::span<const glm::dvec3> ws_points,
                                      std::span<const glm::dvec3> ws_normals, const RaySpace& ray_space,
                                      const ShadowProjection& projection, const DepthRange& range,
                                      const BiasOptions& options, const DepthView& depth = {});

}  // namespace shadowfit
