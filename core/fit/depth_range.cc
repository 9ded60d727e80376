#include "core/fit/depth_range.h"

#include <algorithm>
#include <cmath>
#include <limits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/fit/depth_range.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/math/double_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

/// The least and the greatest of w = h3.r and of q over the hull samples within a texel of the map: where a
/// light has several maps, others hold the rest. `extremes` are least w, most w, least q, most q so far.
void AddExtremes(const ShadowProjection& projection, const LightSamples& samples, double extremes[4]) {
  const DoubleLanes d;
  const size_t count = samples.hull_rays.size();
  const size_t lanes = hn::Lanes(d);
  auto least_w = hn::Set(d, extremes[0]);
  auto most_w = hn::Set(d, extremes[1]);
  auto least_q = hn::Set(d, extremes[2]);
  auto most_q = hn::Set(d, extremes[3]);
  const auto add = [&](const Doubles3& ray, Doubles q) {
    const Doubles3 u = Times(projection.texel_from_ray, ray);
    // -1 <= u <= size + 1, times w.
    const auto within = [&](Doubles v, int size) {
      return hn::And(hn::Ge(v, hn::Neg(u.z)), hn::Le(v, hn::Mul(hn::Set(d, size + 1.0), u.z)));
    };
    const auto held = hn::And(hn::Gt(u.z, hn::Zero(d)), hn::And(within(u.x, projection.size.width),
                                                                within(u.y, projection.size.height)));
    least_w = hn::IfThenElse(held, hn::Min(least_w, u.z), least_w);
    most_w = hn::IfThenElse(held, hn::Max(most_w, u.z), most_w);
    least_q = hn::IfThenElse(held, hn::Min(least_q, q), least_q);
    most_q = hn::IfThenElse(held, hn::Max(most_q, q), most_q);
  };
  size_t i = 0;
  for (; i + lanes <= count; i += lanes) {
    add(LoadPoints(&samples.hull_rays[i].x), hn::LoadU(d, samples.hull_along_ray.data() + i));
  }
  for (; i < count; ++i) add(Set(samples.hull_rays[i]), hn::Set(d, samples.hull_along_ray[i]));
  extremes[0] = hn::GetLane(hn::MinOfLanes(d, least_w));
  extremes[1] = hn::GetLane(hn::MaxOfLanes(d, most_w));
  extremes[2] = hn::GetLane(hn::MinOfLanes(d, least_q));
  extremes[3] = hn::GetLane(hn::MaxOfLanes(d, most_q));
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {

HWY_EXPORT(AddExtremes);

DepthRange FitDepthRange(const RaySpace& ray_space, const ShadowProjection& projection,
                         const LightSamples& samples, std::span<const glm::dvec3> ws_visible_corners) {
  // A hundredth of slack on either side covers surfaces between the samples.
  constexpr double kSlack = 0.01;
  double extremes[4] = {1e300, 0.0, 1e300, -1e300};
  HWY_DYNAMIC_DISPATCH(AddExtremes)(projection, samples, extremes);
  auto [w_low, w_high, q_low, q_high] = extremes;
  const double nearest_hull_w = w_low;
  const glm::dvec3 axis = projection.Axis();
  for (const glm::dvec3& corner : ws_visible_corners) {
    const double w = glm::dot(axis, ray_space.RayFromPoint(corner));
    const double q = ray_space.AlongRay(corner);
    q_low = std::min(q_low, q);
    q_high = std::max(q_high, q);
    if (w > 0.0) {
      w_low = std::min(w_low, w);
      w_high = std::max(w_high, w);
    }
  }
  if (!(w_high > 0.0)) w_low = w_high = 1.0;

  DepthRange range;
  if (!ray_space.is_directional()) {
    // q = 1: depth runs over 1/w, from the nearest hull sample to the farthest visible point.
    const double near_w = (nearest_hull_w < 1e300 ? nearest_hull_w : w_low) * (1.0 - kSlack);
    range.near_q_over_w = 1.0 / near_w;
    range.far_q_over_w = 1.0 / (std::max(w_high, near_w) * (1.0 + kSlack));
    return range;
  }
  const double span = std::max(q_high - q_low, 1e-6 * (1.0 + std::abs(q_high)));
  range.q_origin = q_low - kSlack * span;
  range.near_q_over_w = 0.0;
  // (q - origin) / w is largest where q is and w is smallest; where the axis plane cuts the visible frustum,
  // w is bounded by the hull's.
  const double w_least =
      std::isfinite(nearest_hull_w) && nearest_hull_w < 1e300 ? std::min(w_low, nearest_hull_w) : w_low;
  range.far_q_over_w = (span * (1.0 + 2.0 * kSlack)) / w_least;
  return range;
}

}  // namespace shadowfit
#endif
