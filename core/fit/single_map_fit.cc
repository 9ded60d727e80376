#include "core/fit/single_map_fit.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "core/fit/axis_search.h"
#include "core/fit/outline.h"
#include "core/fit/prediction.h"
#include "core/fit/ray_hull.h"
#include "core/fit/rescale_previous.h"
#include "core/fit/whitened_samples.h"

namespace shadowfit {
namespace {

/// Half angle in radians (80 degrees) of the widest cone that a single map is of use for: at the rim of a map
/// straight along its axis, texels are 33 times as wide as in its middle.
constexpr double kWidestHalfAngle = 1.3962634015954636;

/// Fraction of width and height left free on each side where a kept matrix is rescaled to hold this frame's
/// samples: until they have moved through it, the next frames need not rescale again.
constexpr double kBorder = 0.02;

/// A kept matrix's texels grow where it would get more than this many times the pixels wrong as it is: all of
/// them move when they do.
constexpr double kWorthGrowing = 1.05;

/// Of a kept matrix: with a free aspect ratio, the ratio stays as well, and with it every texel where the
/// number of texels does.
MapSize KeptSize(const LightProblem& problem, const DefaultOptions& options) {
  const MapSize previous = problem.previous->size;
  if (!options.free_aspect) return problem.map_size;
  const double share = previous.texels() / problem.map_size.texels();
  if (share <= 1.0 && share > 0.98) return previous;
  return SizeOfTexels(problem.map_size.texels(), double(previous.width) / previous.height);
}

/// The previous frame's map as it serves this frame, and what it costs.
struct ServedPrevious {
  ShadowProjection projection;
  TexelGrid grid;           ///< Of the samples that were asked.
  WhitenedSamples tangent;  ///< Those, see TangentAt().
  double metric = 0.0;      ///< What they say that it gets wrong where it holds the shadow.
  double outside = 0.0;     ///< Shadow that it does not hold, in the metric's pixels: before UnseenFactor().
  double Total() const { return metric + outside; }
};

/// Whether any texel of a map is larger than it was.
bool HasGrown(const ShadowProjection& map, const ShadowProjection& previous) {
  constexpr double kRounding = 1e-9;
  const glm::dmat3 moved = map.texel_from_ray * glm::inverse(previous.texel_from_ray);
  return moved[0][0] < moved[2][2] * (1.0 - kRounding) || moved[1][1] < moved[2][2] * (1.0 - kRounding);
}

/// Rescaled to hold all shadow, or as it is where `samples` say that what it does not hold costs hardly more
/// than larger texels (kWorthGrowing): a map that let go of some (TrimShadow) need not take it back. None
/// where it cannot serve, or is not asked for.
std::optional<ServedPrevious> ServePrevious(const LightProblem& problem, const DefaultOptions& options,
                                            std::span<const int32_t> outer_samples,
                                            const WhitenedSamples& samples,
                                            const glm::dmat3& ray_from_whitened) {
  if (problem.previous == nullptr || !(options.keep_within > 0.0)) return std::nullopt;
  const ShadowProjection& previous = *problem.previous;
  const auto served = [&](const ShadowProjection& map) -> std::optional<ServedPrevious> {
    const std::optional<TexelGrid> grid = GridOf(map.texel_from_ray * ray_from_whitened);
    if (!grid) return std::nullopt;
    ServedPrevious serves{map, *grid, {}};
    serves.tangent = TangentAt(samples, *grid, &serves.metric);
    if (!std::isfinite(serves.metric)) return std::nullopt;
    return serves;
  };
  std::vector<glm::dvec3> rays;
  rays.reserve(outer_samples.size());
  for (const int32_t i : outer_samples) rays.push_back(problem.samples->hull_rays[static_cast<size_t>(i)]);
  const MapSize size = KeptSize(problem, options);
  const std::optional<ShadowProjection> rescaled = RescaleToHold(previous, size, rays, kBorder);
  std::optional<ServedPrevious> best;
  if (rescaled) best = served(*rescaled);
  const bool may_lose_shadow = !options.hold_all_shadow && problem.KnowsShadow();
  if (!may_lose_shadow || !(size == previous.size) || (rescaled && !HasGrown(*rescaled, previous)))
    return best;
  std::optional<ServedPrevious> as_it_is = served(previous);
  if (!as_it_is || (best && !(as_it_is->metric < best->metric))) return best;
  as_it_is->outside = ShadowOutside(problem, {&previous, 1}).value_or(0.0) / UnseenFactor(*problem.samples);
  return !best || as_it_is->Total() < kWorthGrowing * best->Total() ? as_it_is : best;
}

/// The previous frame's axis as (alpha, beta) of whitened coordinates; none where it looks away.
std::optional<glm::dvec2> PreviousAxis(const LightProblem& problem, const glm::dmat3& ray_from_whitened) {
  if (problem.previous == nullptr) return std::nullopt;
  // A row vector h of ray space is h T^-1 in whitened coordinates.
  const glm::dvec3 axis = glm::transpose(ray_from_whitened) * problem.previous->Axis();
  if (!(axis.z > 0.0)) return std::nullopt;
  return glm::dvec2(axis) / axis.z;
}

/// The previous frame's map where a survey over few samples, and over a hull that is a little too small,
/// finds nothing that might take its place.
std::optional<SingleMapFit> KeepAtAGlance(const LightProblem& problem, const DefaultOptions& options) {
  // Where several maps might do better, it matters what the best single one costs.
  if (problem.previous == nullptr || !(options.keep_within > 0.0) || options.glance_samples == 0 ||
      options.most_maps > 1)
    return std::nullopt;
  const std::optional<std::vector<int32_t>> outline =
      OutlineOf(*problem.samples, problem.previous->texel_from_ray);
  if (!outline) return std::nullopt;
  std::vector<glm::dvec3> corners;
  corners.reserve(4 * outline->size());
  for (const int32_t i : *outline) {
    for (int corner = 0; corner < 4; ++corner) {
      corners.push_back(problem.samples->FootprintCorner(static_cast<size_t>(i), corner));
    }
  }
  const RayHull hull = MakeRayHull(*problem.ray_space, corners);
  // Well within what a single map is of use for, see kWidestHalfAngle.
  if (!hull.complete || !(hull.cos_half_angle > std::cos(kReducedHalfAngle))) return std::nullopt;

  const WhitenedSamples some = WhitenSome(problem, hull, options.glance_samples);
  const glm::dmat3 ray_from_whitened = glm::inverse(some.whitened_from_ray);
  const std::optional<ServedPrevious> kept =
      ServePrevious(problem, options, *outline, some, ray_from_whitened);
  if (!kept) return std::nullopt;
  // What matters is whether there is another valley, not how deep it is.
  DefaultOptions quick = options;
  quick.search_directions = 3;
  quick.starts = 1;
  quick.evaluations_per_start = 6;
  AxisSearch search(kept->tangent, problem.map_size, quick);
  // The metric is to fall to 1/k of what it is. Let all edges be displaced by z times kEdgeLimit: displaced
  // by a z, they get, tails aside, (1 + z) a / (1 + a z) times the pixels wrong, which is 1/k at a = 1 / (k +
  // (k - 1) z). And the metric is 1 + z times its tangent.
  const double cost = search.CostOf(kept->grid);
  const double keep = options.keep_within;
  const double to_beat = (cost + kept->outside) / (keep + (keep - 1.0) * (kept->metric / cost - 1.0));
  if (!std::isfinite(to_beat)) return std::nullopt;
  SingleMapFit fit;
  fit.cost = search.Survey(PreviousAxis(problem, ray_from_whitened), to_beat);
  if (fit.cost < to_beat) return std::nullopt;
  fit.projection = kept->projection;
  fit.kept_previous = true;
  fit.evaluations = search.evaluations();
  return fit;
}

/// What a search found, in ray coordinates.
void Take(const AxisSearchResult& found, const WhitenedSamples& samples, SingleMapFit* fit) {
  fit->cost = found.cost;
  fit->projection.size = found.size;
  fit->projection.texel_from_ray = WithUnitAxis(found.texel_from_whitened * samples.whitened_from_ray);
}

/// Whether a map of its cost around the hull is of use.
void Judge(const RayHull& hull, SingleMapFit* fit) {
  // Sums of costs stay finite.
  constexpr double kMostCost = 1e60;
  fit->complete = hull.complete;
  fit->usable = hull.complete && fit->cost < kMostCost && hull.cos_half_angle > std::cos(kWidestHalfAngle);
  fit->cost = std::min(fit->cost, kMostCost);
}

}  // namespace

SingleMapFit FitSingleMap(const LightProblem& problem, const DefaultOptions& options) {
  if (const std::optional<SingleMapFit> kept = KeepAtAGlance(problem, options)) return *kept;
  const RayHull hull = MakeFitHull(problem);
  const WhitenedSamples probes = WhitenSome(problem, hull, options.search_samples);
  const glm::dmat3 ray_from_whitened = glm::inverse(probes.whitened_from_ray);
  AxisSearch search(probes, problem.map_size, options);

  SingleMapFit fit;
  std::optional<ServedPrevious> kept;
  if (hull.complete) {
    kept = ServePrevious(problem, options, hull.shadow_samples, probes, ray_from_whitened);
  }
  double to_beat = std::numeric_limits<double>::infinity();
  if (kept) {
    to_beat = (search.CostOf(kept->grid) + kept->outside) / options.keep_within;
    if (!std::isfinite(to_beat)) kept.reset();
  }
  fit.cost = search.Survey(PreviousAxis(problem, ray_from_whitened), to_beat);
  if (kept && !(fit.cost < to_beat)) {
    fit.kept_previous = true;
  } else {
    Take(search.Descend(Whiten(problem, hull)), probes, &fit);
    // What the probes say of a small difference is not what all samples say.
    fit.kept_previous =
        kept && PredictMisclassifiedPixels(*problem.samples, {&kept->projection, 1}) +
                        UnseenFactor(*problem.samples) * kept->outside <=
                    options.keep_within * PredictMisclassifiedPixels(*problem.samples, {&fit.projection, 1});
  }
  if (fit.kept_previous) fit.projection = kept->projection;
  fit.evaluations = search.evaluations();
  Judge(hull, &fit);
  for (const BoundarySamples* boundary : problem.samples->Boundaries()) {
    for (const double length : boundary->length) fit.edge_length += length;
  }
  return fit;
}

SingleMapFit RefitSingleMap(const LightProblem& problem, const DefaultOptions& options) {
  const RayHull hull = MakeFitHull(problem);
  const WhitenedSamples samples = Whiten(problem, hull);
  AxisSearch search(samples, problem.map_size, options);
  SingleMapFit fit;
  Take(search.DescendFromMap(*problem.previous), samples, &fit);
  fit.evaluations = search.evaluations();
  Judge(hull, &fit);
  return fit;
}

}  // namespace shadowfit
