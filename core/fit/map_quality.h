#pragma once

#include <span>
#include <string_view>

#include "core/frame/camera.h"
#include "core/frame/light_samples.h"
#include "core/math/ray_space.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

enum class MapFlaw { kNone, kPerspective, kProjection, kFit, kBudget };

/// "none", "perspective", "projection", "fit", "budget".
std::string_view MapFlawName(MapFlaw flaw);

/// The mean of s/4 + t^2/(12 s) over all directions of an edge, s >= t the widths of a square texel's sides
/// across it: ((1/4 - 1/12) sqrt(1/2) + ln(1 + sqrt(2)) / 12) / (pi/4).
inline constexpr double kUnitPixelsPerLength = 0.24356936;

/// Why a map is predicted to get as many pixels wrong as it is: factors whose product is the prediction over
/// what a map displaces edges by which had one texel for every pixel at every shadow edge,
///
///   predicted = budget * fit * perspective * projection * saturation * unit_pixels.
///
/// At an edge sample i of length l_i let P be the gradients of the two pixel coordinates by the world point,
/// and U those of the two texel coordinates. The beam of a pixel, cut at right angles, has the area 1/|P1 x
/// P2|, that of a texel 1/|U1 x U2|. Their ratio
///
///   a_i = |P1 x P2| / |U1 x U2|
///
/// is a texel's area in pixels before any surface cuts the two beams, the classical perspective aliasing; a
/// surface multiplies it by cos(viewer) / cos(light), the classical projection aliasing. (The texel's area
/// on the picture is |N . P1 x P2| / |N . U1 x U2| for a surface of normal N.) With L = sum l_i:
///
///   unit_pixels  k L, with k = kUnitPixelsPerLength: what square texels a pixel wide displace; times what
///                UnseenFactor() (prediction.h) says of features that the samples miss
///   a            L / sum(l_i / a_i), the harmonic mean: what all texels had if these edges' density of
///                texels were spread evenly
///   fill         share of the map, or of all maps' texels, that the hull of the samples covers
///
///   budget       sqrt(a * fill): too few texels, even if all were put to use and spread evenly. Twice the
///                texels divide it by sqrt(2); no other factor changes.
///   fit          sqrt(1 / fill), at least 1: texels that lie outside all that is seen.
///   perspective  sum(l_i sqrt(a_i)) / (L sqrt(a)), at least 1: texels spread unevenly, large ones where the
///                viewer is near. 1 where light and viewer are in one place.
///   projection   sum(l_i y_i) / (k sum(l_i sqrt(a_i))), y_i the displacement (metric.h): surfaces that the
///   light grazes and the viewer does not.
///                Below 1 where it is the other way round, or where edges run along the texels' long sides.
///   saturation   predicted / sum(l_i y_i), at most 1: shadows are lost rather than displaced where texels
///                are larger than they. The larger the others, the smaller it is.
///
/// A matrix trades them for each other: an optimized one has perspective above its least to meet projection.
struct MapQuality {
  double predicted_pixels = 0.0;
  double unit_pixels = 0.0;
  double perspective = 1.0;
  double projection = 1.0;
  double fit = 1.0;
  double budget = 1.0;
  double saturation = 1.0;

  /// The largest factor above 1; none where no wrong pixels are predicted.
  MapFlaw Worst() const;
};

/// `screen` is the picture whose pixels count. A sample belongs to the first map that holds it; what no map
/// holds takes no part. Rough samples count as in a prediction (prediction.h). All factors are 1 where there
/// are no samples.
MapQuality AssessMaps(const Camera& camera, const RaySpace& ray_space, const LightSamples& samples,
                      std::span<const ShadowProjection> projections, MapSize screen);

}  // namespace shadowfit
