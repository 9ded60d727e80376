#include "core/fit/frame_sizing.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/budget/texel_budget.h"
#include "core/fit/map_quality.h"
#include "core/fit/metric.h"
#include "core/fit/prediction.h"

namespace shadowfit {
namespace {

absl::Status CheckSides(const std::string& path, const SideLimits& sides) {
  const int least = sides.rounding == SizeRounding::kMultipleOf8 ? 8 : 1;
  for (const auto& [value, name] :
       {std::pair(sides.min_side, "min_side"), std::pair(sides.max_side, "max_side")}) {
    if (value < least || value > kMaxMapSize) {
      return absl::InvalidArgumentError(
          absl::StrFormat("%s.%s: %d is outside %d to %d", path, name, value, least, kMaxMapSize));
    }
  }
  if (sides.min_side > sides.max_side) {
    return absl::InvalidArgumentError(
        absl::StrFormat("%s.min_side: %d is above max_side, %d", path, sides.min_side, sides.max_side));
  }
  return absl::OkStatus();
}

double PredictedPixels(const SizedLight& light) {
  return PredictMisclassifiedPixels(*light.problem.samples, light.fit.Projections());
}

/// What a light's maps gain together.
TexelDemand DemandOf(const SizedLight& light, bool edges_known) {
  TexelDemand demand;
  demand.weight = light.weight;
  demand.requested = light.fit.projection.size;
  const LightSamples& samples = *light.problem.samples;
  if (edges_known && samples.source != SampleSource::kShadowBoundary) return demand;
  double texels = 0.0;
  for (const ShadowProjection& projection : light.fit.Projections()) texels += projection.size.texels();
  double length = 0.0;
  double most_pixels = 0.0;
  double tails = 0.0;
  // Edges that do not show add next to nothing to a prediction, and would raise what it may approach.
  for (const BoundarySamples* boundary : {&samples.boundary, &samples.rough_boundary}) {
    const double of_list = std::accumulate(boundary->length.begin(), boundary->length.end(), 0.0);
    length += of_list;
    most_pixels += boundary->limit * of_list;
    tails +=
        std::inner_product(boundary->length.begin(), boundary->length.end(), boundary->tail.begin(), 0.0);
  }
  demand.unit_pixels = UnseenFactor(samples) * kUnitPixelsPerLength * length;
  demand.most_pixels = UnseenFactor(samples) * most_pixels;
  if (length > 0.0) demand.tail = tails / length;
  demand.cost = demand.Displaced(PredictedPixels(light)) * std::sqrt(texels);
  if (!std::isfinite(demand.cost)) demand.cost = 0.0;
  return demand;
}

/// The maps of all lights, light by light. A light's maps have their texels by the same rule as those of a
/// frame, t in proportion to c^(2/3), so that the pixels that each is predicted to get wrong, c / sqrt(t),
/// are in proportion to its texels.
std::vector<TexelDemand> MapDemands(std::span<const SizedLight> lights, bool edges_known) {
  std::vector<TexelDemand> demands;
  for (const SizedLight& light : lights) {
    const TexelDemand whole = DemandOf(light, edges_known);
    const std::vector<ShadowProjection> projections = light.fit.Projections();
    double texels = 0.0;
    for (const ShadowProjection& projection : projections) texels += projection.size.texels();
    for (const ShadowProjection& projection : projections) {
      const double share = projection.size.texels() / texels;
      TexelDemand& demand = demands.emplace_back(whole);
      demand.requested = projection.size;
      demand.cost = whole.cost * share * std::sqrt(share);
    }
  }
  return demands;
}

/// The fit with maps of other sizes.
absl::Status Resize(const LightMatrixMethod& method, std::span<const MapSize> sizes, SizedLight* light) {
  const MapSize fitted = light->fit.projection.size;
  const double stretch = (double(sizes[0].width) / sizes[0].height) / (double(fitted.width) / fitted.height);
  light->fit.projection = Resized(light->fit.projection, sizes[0]);
  for (size_t k = 1; k < sizes.size(); ++k) {
    light->fit.further_projections[k - 1] = Resized(light->fit.further_projections[k - 1], sizes[k]);
  }
  // Sides are whole: a hundredth is no change of shape.
  if (sizes.size() > 1 || std::abs(std::log(stretch)) < 0.01) return absl::OkStatus();
  SizedLight again = *light;
  again.problem.map_size = sizes[0];
  absl::StatusOr<LightFit> fit = method.Fit(again.problem);
  if (!fit.ok()) return fit.status();
  light->fit.evaluations += fit->evaluations;
  if (!fit->further_projections.empty()) return absl::OkStatus();
  again.fit = *std::move(fit);
  // With a free aspect ratio the method chooses sides of its own.
  again.fit.projection = Resized(again.fit.projection, sizes[0]);
  again.fit.evaluations = light->fit.evaluations;
  if (PredictedPixels(again) <= PredictedPixels(*light)) *light = std::move(again);
  return absl::OkStatus();
}

/// Sizes a light's maps for the tolerance.
absl::Status SizeByTolerance(const ToleranceOptions& options, const LightMatrixMethod& method,
                             bool edges_known, SizedLight* light) {
  const double allowed = options.max_misclassified_pixels / light->weight;
  const std::vector<ShadowProjection> fitted = light->fit.Projections();
  double fitted_texels = 0.0;
  for (const ShadowProjection& projection : fitted) fitted_texels += projection.size.texels();
  TexelDemand demand = DemandOf(*light, edges_known);
  double texels = SafeTexels(demand, allowed);
  // Edges do not saturate all at once, as the demand has it; and rounded sides change the aspect ratio, which
  // may cost a little.
  constexpr int kMostAttempts = 16;
  for (int attempt = 0; attempt < kMostAttempts; ++attempt) {
    std::vector<MapSize> sizes;
    bool largest = true;
    for (const ShadowProjection& projection : fitted) {
      const double share = projection.size.texels() / fitted_texels;
      sizes.push_back(SizeFrom(projection.size, texels * share, options.sides));
      largest = largest && sizes.back().texels() < texels * share;
    }
    if (absl::Status status = Resize(method, sizes, light); !status.ok()) return status;
    demand.cost = demand.Displaced(PredictedPixels(*light));
    if (!(demand.unit_pixels > 0.0) || !(SafeWrongPixels(demand, {1, 1}) > allowed)) return absl::OkStatus();
    if (largest) break;
    double sized_texels = 0.0;
    for (const MapSize& size : sizes) sized_texels += size.texels();
    demand.cost *= std::sqrt(sized_texels);
    texels = std::max(1.01 * texels, SafeTexels(demand, allowed));
  }
  light->fit.note = "the largest map allowed is too small for the tolerance";
  return absl::OkStatus();
}

absl::StatusOr<std::vector<MapSize>> SizesByBudget(const BudgetOptions& options,
                                                   std::span<const TexelDemand> demands,
                                                   std::span<SizedLight> lights) {
  BudgetOptions limits = options;
  if (options.atlas) {
    limits.sides.max_side = std::min({options.sides.max_side, options.atlas->width, options.atlas->height});
    limits.sides.min_side = std::min(limits.sides.min_side, limits.sides.max_side);
  }
  double total = options.atlas ? options.atlas->texels() : options.total_texels;
  if (options.total_texels > 0.0) total = std::min(total, options.total_texels);
  double least = 0.0;
  for (const TexelDemand& demand : demands) least += SmallestSize(demand.requested, limits.sides).texels();
  if (total < least) {
    return absl::InvalidArgumentError(absl::StrFormat(
        "options.texel_budget.%s: %.0f texels, %d maps of the least size need %.0f",
        total == options.total_texels ? "total_texels" : "atlas", total, demands.size(), least));
  }
  if (!options.atlas) return ShareSizes(demands, limits.sides, total);
  // Fewer texels until the packer finds room.
  constexpr double kStep = 0.98;
  for (;;) {
    const std::vector<MapSize> sizes = ShareSizes(demands, limits.sides, std::max(total, least));
    if (const auto positions = PackAtlas(sizes, *options.atlas)) {
      auto position = positions->begin();
      for (SizedLight& light : lights) {
        const auto maps = static_cast<std::ptrdiff_t>(1 + light.fit.further_projections.size());
        light.atlas_positions.assign(position, position + maps);
        position += maps;
      }
      return sizes;
    }
    if (total <= least) {
      return absl::InvalidArgumentError(
          absl::StrFormat("options.texel_budget.atlas: %dx%d does not hold %d maps of the least size",
                          options.atlas->width, options.atlas->height, sizes.size()));
    }
    total *= kStep;
  }
}

}  // namespace

absl::Status CheckSizing(const MapSizing& sizing) {
  if (const auto* budget = std::get_if<BudgetOptions>(&sizing)) {
    if (!std::isfinite(budget->total_texels) || budget->total_texels < 0.0 ||
        (budget->total_texels == 0.0 && !budget->atlas)) {
      return absl::InvalidArgumentError(
          absl::StrFormat("options.texel_budget.total_texels: %g, %s", budget->total_texels,
                          budget->total_texels == 0.0 ? "needed where there is no atlas"
                                                      : "must be finite and not negative"));
    }
    if (budget->atlas) {
      const auto outside = [](int side) { return side < 1 || side > kMaxMapSize; };
      if (outside(budget->atlas->width) || outside(budget->atlas->height)) {
        return absl::InvalidArgumentError(
            absl::StrFormat("options.texel_budget.atlas: %dx%d, sides are 1 to %d", budget->atlas->width,
                            budget->atlas->height, kMaxMapSize));
      }
    }
    return CheckSides("options.texel_budget.sides", budget->sides);
  }
  if (const auto* tolerance = std::get_if<ToleranceOptions>(&sizing)) {
    if (!std::isfinite(tolerance->max_misclassified_pixels) || !(tolerance->max_misclassified_pixels > 0.0)) {
      return absl::InvalidArgumentError(
          absl::StrFormat("options.tolerance.max_misclassified_pixels: %g is not finite and above 0",
                          tolerance->max_misclassified_pixels));
    }
    return CheckSides("options.tolerance.sides", tolerance->sides);
  }
  return absl::OkStatus();
}

absl::Status SizeMaps(const MapSizing& sizing, const LightMatrixMethod& method, bool edges_known,
                      std::span<SizedLight> lights) {
  if (const auto* tolerance = std::get_if<ToleranceOptions>(&sizing)) {
    for (SizedLight& light : lights) {
      if (absl::Status status = SizeByTolerance(*tolerance, method, edges_known, &light); !status.ok()) {
        return status;
      }
    }
    return absl::OkStatus();
  }
  const auto* budget = std::get_if<BudgetOptions>(&sizing);
  if (budget == nullptr) return absl::OkStatus();
  const absl::StatusOr<std::vector<MapSize>> sizes =
      SizesByBudget(*budget, MapDemands(lights, edges_known), lights);
  if (!sizes.ok()) return sizes.status();
  std::span<const MapSize> rest = *sizes;
  for (SizedLight& light : lights) {
    const size_t maps = 1 + light.fit.further_projections.size();
    if (absl::Status status = Resize(method, rest.first(maps), &light); !status.ok()) return status;
    rest = rest.subspan(maps);
  }
  return absl::OkStatus();
}

}  // namespace shadowfit
