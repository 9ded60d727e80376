#pragma once

#include <span>

#include "core/frame/light_samples.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

/// Pixels of the final screen that a light's maps are expected to get wrong, each sample being judged by the
/// first map that holds it: the `edge` metric (metric.h) of all boundary samples, times kUnsampled.
double PredictMisclassifiedPixels(const LightSamples& samples, std::span<const ShadowProjection> projections);

/// Wrong pixels for every one at an edge that the samples show. Where they do, the metric agrees with
/// Embree's count to a few percent; but some three in ten wrong pixels of a 750x750 picture lie at features
/// that 180x180 samples miss (railings, leaves, rims). The median over the lights of a comparison of the
/// plaza is 1 with this factor.
inline constexpr double kUnsampled = 1.65;

}  // namespace shadowfit
