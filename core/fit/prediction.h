#pragma once

#include <optional>
#include <span>

#include "core/fit/light_problem.h"
#include "core/frame/light_samples.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

/// Wrong pixels for every one that is expected at an edge that the samples show. Others lie at features that
/// the samples miss (railings, leaves, rims). As species seen once tell how many were not seen at all (Good
/// 1953), shadows that are one sample wide tell how many are narrower: counted against rays, this many edges
/// are missed for each that belongs to one of those.
inline constexpr double kMissedPerNarrow = 2.8;

inline double UnseenFactor(const LightSamples& samples) {
  return 1.0 + kMissedPerNarrow * samples.narrow_share;
}

/// Pixels of the final screen that a light's maps are expected to get wrong, each sample being judged by the
/// first map that holds it: the `edge` metric (metric.h) of all boundary samples, times UnseenFactor().
/// Of a single map, which as a rule holds the shadow whole, all samples count.
double PredictMisclassifiedPixels(const LightSamples& samples, std::span<const ShadowProjection> projections);

/// Whether the maps together hold what the samples show of the light's shadow, to half a texel.
bool HoldShadow(const LightSamples& samples, std::span<const ShadowProjection> projections);

/// As PredictMisclassifiedPixels(), without the samples that no map holds: to them comes the shadow that is
/// outside all maps (FrameSampler::ShadowOutside).
double PredictHeldPixels(const LightSamples& samples, std::span<const ShadowProjection> projections);

/// Pixels of the final screen in shadow that none of the maps holds (FrameSampler::ShadowOutside()). None
/// where the maps hold what the samples show of it (HoldShadow()), or the samples are all that is known.
std::optional<double> ShadowOutside(const LightProblem& problem,
                                    std::span<const ShadowProjection> projections);

/// What a light's maps are expected to get wrong of its frame, pixels of the final screen.
struct PredictedPixels {
  double at_edges = 0.0;  ///< Of what the maps hold.
  double outside = 0.0;   ///< Of the shadow that none of them holds, which is shown lit.
  double Total() const { return at_edges + outside; }
};

PredictedPixels PredictWrongPixels(const LightProblem& problem,
                                   std::span<const ShadowProjection> projections);

}  // namespace shadowfit
