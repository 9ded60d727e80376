#pragma once

#include <limits>
#include <span>
#include <vector>

#include "core/budget/map_sizing.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

/// What a light gains by texels. What texels displace edges by is homogeneous in their sides: at a fixed
/// axis, parallelogram and aspect ratio a map of T texels displaces cost / sqrt(T) pixels, and is predicted
/// to get Predicted() of these wrong.
struct TexelDemand {
  double cost = 0.0;         ///< What a map of one texel displaces: displaced pixels * sqrt(texels).
  double weight = 1.0;       ///< What a wrong pixel of this light counts.
  MapSize requested;         ///< Gives the aspect ratio.
  double unit_pixels = 0.0;  ///< See MapQuality; for tolerances.
  /// What the prediction approaches as texels grow, but for its tail; for tolerances. Budgets share texels
  /// out by displaced pixels.
  double most_pixels = std::numeric_limits<double>::infinity();
  double tail = 0.0;  ///< Share of the displaced pixels that does not level off, 0 to 1.

  /// Of y displaced pixels: (1 - tail) y / (1 + y / most_pixels) + tail y.
  double Predicted(double displaced) const;
  /// Its inverse; without a tail, predictions near most_pixels or above it are those of about a thousand
  /// times as many.
  double Displaced(double predicted) const;

  double WrongPixels(MapSize size) const;
};

/// The minimum of sum_i demand_i / sqrt(t_i) over the t_i that add up to `total`, each within [least_i,
/// most_i]. Marginal gains demand_i / (2 t_i^(3/2)) are equal where no bound holds, so that
///
///   t_i = clamp(lambda * demand_i^(2/3), least_i, most_i),
///
/// and the sum rises with lambda, which is found by bisection. Where the least together exceed the total each
/// gets its least; where the most do not reach it each gets its most. Texels that no demand asks for are not
/// handed out.
std::vector<double> ShareTexels(std::span<const double> demand, std::span<const double> least,
                                std::span<const double> most, double total);

/// Sizes of allowed sides, together at most `total` texels as far as the smallest allowed sizes leave that
/// possible: the closed form above, rounded down, then the remaining texels given step by step (one side, one
/// allowed length) where they gain most per texel. Powers of two are too coarse for that, and their best
/// choice is found exactly.
std::vector<MapSize> ShareSizes(std::span<const TexelDemand> demands, const SideLimits& sides, double total);

/// What a prediction is multiplied with so that nine lights in ten stay below it. The samples miss shadows
/// that are thinner than they are apart: large texels lose those anyway, as a part of the prediction, but
/// small ones have edges to draw that nobody saw. So it depends on how many pixels wide a texel is, predicted
/// / unit pixels (map_quality.h). Measured by bench_budget with 180x180 samples of the plaza at 750x750: the
/// ninth decile of Embree's count over the prediction is 1.6 at texels of 0.15 pixels, 1.2 at 0.5 and 1.1
/// from 1 on; to these comes a margin for scenes whose shadows are finer.
double ToleranceSafety(double texel_pixels);

/// The upper end of what a map of this size is expected to get wrong.
double SafeWrongPixels(const TexelDemand& demand, MapSize size);

/// The least number of texels, not whole, with SafeWrongPixels <= allowed; 0 where no texel is needed.
double SafeTexels(const TexelDemand& demand, double allowed);

/// The smallest allowed size of at least so many texels; the largest allowed where none is large enough.
MapSize SizeFrom(MapSize requested, double texels, const SideLimits& sides);

/// The smallest size that these limits allow.
MapSize SmallestSize(MapSize requested, const SideLimits& sides);

/// The same map with another number of texels a side.
ShadowProjection Resized(const ShadowProjection& projection, MapSize size);

}  // namespace shadowfit
