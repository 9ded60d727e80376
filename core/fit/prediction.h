#pragma once

#include <span>

#include "core/frame/light_samples.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

/// Pixels of the final screen that a light's maps are expected to get wrong, each sample being judged by the
/// first map that holds it: the `edge` metric (metric.h) of the boundary samples, and of the rough ones half
/// of it, capped as the fit does (Whiten).
double PredictMisclassifiedPixels(const LightSamples& samples, std::span<const ShadowProjection> projections);

}  // namespace shadowfit
