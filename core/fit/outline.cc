#include "core/fit/outline.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

#include "core/fit/outer_samples.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/fit/outline.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/frame/number_lanes-inl.h"
#include "core/math/double_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

/// Directions come in opposite pairs.
constexpr int kPairs = kOutlineDirections / 2;

/// The greatest of a number so far, lane by lane, and whose it is.
struct Greatest {
  Doubles value, place;

  HWY_INLINE void Add(hn::Mask<DoubleLanes> counts, Doubles v, Doubles places) {
    const auto higher = hn::And(counts, hn::Gt(v, value));
    value = hn::IfThenElse(higher, v, value);
    place = hn::IfThenElse(higher, places, place);
  }
  /// The first of equal ones, however many lanes there are.
  int32_t Get() const {
    const DoubleLanes d;
    const auto best = hn::Eq(value, hn::MaxOfLanes(d, value));
    const auto none = hn::Set(d, std::numeric_limits<double>::infinity());
    return static_cast<int32_t>(hn::GetLane(hn::MinOfLanes(d, hn::IfThenElse(best, place, none))));
  }
};

/// False where a sample that counts, those in shadow or all, is not in front of the map. There is at least a
/// vector of them.
bool FindOutline(const LightSamples& samples, bool shadow_alone, const glm::dmat3& texel_from_ray,
                 const double (*directions)[2], int32_t* outline) {
  const DoubleLanes d;
  const hn::Rebind<uint8_t, DoubleLanes> bytes;
  const auto zero = hn::Zero(d);
  const size_t lanes = hn::Lanes(d);
  const size_t count = samples.hull_rays.size();
  Greatest farthest[kOutlineDirections];
  for (Greatest& far : farthest) far = {hn::Set(d, -std::numeric_limits<double>::infinity()), zero};
  auto seen = hn::Eq(zero, zero);
  for (size_t next = 0; next < count; next += lanes) {
    // The last vector has some samples of the one before again.
    const size_t i = std::min(next, count - lanes);
    const Doubles3 ray = LoadPoints(&samples.hull_rays[i].x);
    const auto in_shadow =
        hn::ConvertTo(d, hn::PromoteTo(hn::RebindToSigned<DoubleLanes>(),
                                       hn::PromoteTo(hn::Rebind<int32_t, DoubleLanes>(),
                                                     hn::LoadU(bytes, samples.hull_in_shadow.data() + i))));
    const auto counts = hn::Gt(in_shadow, hn::Set(d, shadow_alone ? 0.0 : -1.0));
    const Doubles3 h = Times(texel_from_ray, ray);
    // As for RescaleToHold; false for NaN.
    const auto in_front =
        hn::And(hn::Gt(h.z, zero), hn::Gt(hn::Mul(h.z, h.z), hn::Mul(hn::Set(d, 1e-8), Dot(ray, ray))));
    seen = hn::And(seen, hn::Or(in_front, hn::Not(counts)));
    const Doubles per_w = hn::Div(hn::Set(d, 1.0), h.z);
    const Doubles x = hn::Mul(h.x, per_w);
    const Doubles y = hn::Mul(h.y, per_w);
    const Doubles places = NumbersFrom(d, static_cast<double>(i));
    for (size_t k = 0; k < kPairs; ++k) {
      const Doubles along =
          hn::MulAdd(hn::Set(d, directions[k][0]), x, hn::Mul(hn::Set(d, directions[k][1]), y));
      farthest[k].Add(counts, along, places);
      farthest[k + kPairs].Add(counts, hn::Neg(along), places);
    }
  }
  for (size_t k = 0; k < kOutlineDirections; ++k) outline[k] = farthest[k].Get();
  return hn::AllTrue(d, seen);
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {
namespace {

HWY_EXPORT(FindOutline);

using Directions = std::array<double[2], kOutlineDirections / 2>;

const Directions& HalfOfTheDirections() {
  static const Directions directions = [] {
    Directions all;
    for (int k = 0; k < kOutlineDirections / 2; ++k) {
      const double angle = 2.0 * std::numbers::pi * k / kOutlineDirections;
      all[static_cast<size_t>(k)][0] = std::cos(angle);
      all[static_cast<size_t>(k)][1] = std::sin(angle);
    }
    return all;
  }();
  return directions;
}

/// Fewer samples than this have no outline; at least the lanes of a vector.
constexpr size_t kFewest = 32;

}  // namespace

std::optional<std::vector<int32_t>> OutlineOf(const LightSamples& samples, const glm::dmat3& texel_from_ray) {
  if (samples.hull_rays.size() < kFewest) return std::nullopt;
  std::vector<int32_t> outline(kOutlineDirections);
  if (!HWY_DYNAMIC_DISPATCH(FindOutline)(samples, AnyInShadow(samples), texel_from_ray,
                                         HalfOfTheDirections().data(), outline.data())) {
    return std::nullopt;
  }
  return outline;
}

}  // namespace shadowfit
#endif
