#include "core/fit/prediction.h"

#include <algorithm>
#include <array>
#include <cstdint>

#include "core/fit/metric.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/fit/prediction.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/math/double_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

/// How many of the hull samples, in whole vectors from the first on, are lit or held by the map: all before
/// the first vector that has another.
size_t HeldFromTheFirst(const LightSamples& samples, const ShadowProjection& map, double margin) {
  const DoubleLanes d;
  const size_t lanes = hn::Lanes(d);
  size_t i = 0;
  for (; i + lanes <= samples.hull_rays.size(); i += lanes) {
    const Doubles3 h = Times(map.texel_from_ray, LoadPoints(&samples.hull_rays[i].x));
    // -margin <= u <= size + margin, times w. False for NaN.
    const auto within = [&](Doubles v, int size) {
      return hn::And(hn::Ge(v, hn::Mul(hn::Set(d, -margin), h.z)),
                     hn::Le(v, hn::Mul(hn::Set(d, size + margin), h.z)));
    };
    const auto held =
        hn::And(hn::Gt(h.z, hn::Zero(d)), hn::And(within(h.x, map.size.width), within(h.y, map.size.height)));
    if (hn::AllTrue(d, held)) continue;
    const uint8_t* in_shadow = &samples.hull_in_shadow[i];
    std::array<uint8_t, 8> bytes{};
    hn::StoreMaskBits(d, held, bytes.data());
    for (size_t k = 0; k < lanes; ++k) {
      if (in_shadow[k] != 0 && (bytes[0] >> k & 1) == 0) return i;
    }
  }
  return i;
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {
namespace {

HWY_EXPORT(HeldFromTheFirst);

}  // namespace

double PredictMisclassifiedPixels(const LightSamples& samples,
                                  std::span<const ShadowProjection> projections) {
  if (projections.size() > 1) return PredictHeldPixels(samples, projections);
  const glm::dmat3& texel_from_ray = projections[0].texel_from_ray;
  double pixels = 0.0;
  for (const BoundarySamples* boundary : samples.Boundaries())
    pixels += EdgeMetric(*boundary, texel_from_ray);
  return UnseenFactor(samples) * pixels;
}

bool HoldShadow(const LightSamples& samples, std::span<const ShadowProjection> projections) {
  constexpr double kMargin = 0.5;
  // As a rule the first map holds all.
  const size_t first = HWY_DYNAMIC_DISPATCH(HeldFromTheFirst)(samples, projections[0], kMargin);
  for (size_t i = first; i < samples.hull_rays.size(); ++i) {
    if (samples.hull_in_shadow[i] == 0) continue;
    const auto holds = [&](const ShadowProjection& map) { return map.Holds(samples.hull_rays[i], kMargin); };
    if (std::none_of(projections.begin(), projections.end(), holds)) return false;
  }
  return true;
}

double PredictHeldPixels(const LightSamples& samples, std::span<const ShadowProjection> projections) {
  double pixels = 0.0;
  for (const BoundarySamples* boundary : samples.Boundaries())
    pixels += EdgeMetricOfHeld(*boundary, projections);
  return UnseenFactor(samples) * pixels;
}

std::optional<double> ShadowOutside(const LightProblem& problem,
                                    std::span<const ShadowProjection> projections) {
  if (!problem.KnowsShadow()) return std::nullopt;
  // What lies between samples lies in the map that holds them all, but in none of two that share them.
  if (projections.size() == 1 && HoldShadow(*problem.samples, projections)) return std::nullopt;
  return problem.sampler->ShadowOutside(*problem.camera, *problem.ray_space, problem.light_in_frame,
                                        projections);
}

PredictedPixels PredictWrongPixels(const LightProblem& problem,
                                   std::span<const ShadowProjection> projections) {
  const std::optional<double> outside = ShadowOutside(problem, projections);
  if (!outside) return {PredictMisclassifiedPixels(*problem.samples, projections)};
  return {PredictHeldPixels(*problem.samples, projections), *outside};
}

}  // namespace shadowfit
#endif
