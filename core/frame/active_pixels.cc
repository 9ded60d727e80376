#include "core/frame/active_pixels.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/frame/active_pixels.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/frame/bend_lanes-inl.h"
#include "core/frame/number_lanes-inl.h"
#include "core/frame/packing_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

using Floats = hn::CappedTag<float, kMostLanes>;
using Words = hn::RebindToUnsigned<Floats>;
using Indices = hn::RebindToSigned<Floats>;

/// Steps between the pixels inside of shadows that the map must hold, too: the light's picture of a shadow
/// may reach beyond that of its outline, where the surface folds and where it surrounds the light.
constexpr int kInnerStride = 8;

/// One row; `active` has room for all of it.
void FindInRow(const PixelPlanes& planes, const BendTolerance& tolerance, int y, ActivePixels* active) {
  const Floats d;
  const Words dw;
  const Indices di;
  const std::array<std::ptrdiff_t, 4> steps = planes.NeighbourSteps();
  const auto inner_column = hn::Set(di, y % kInnerStride == kInnerStride / 2 ? kInnerStride / 2 : -1);
  size_t count = active->size();
  for (int x = 0; x < planes.width; x += static_cast<int>(hn::Lanes(d))) {
    const std::ptrdiff_t first = planes.Index(x, y);
    const uint32_t* bits = planes.bits.data() + first;
    const auto mine = hn::LoadU(dw, bits);
    hn::Vec<Words> differences[4];
    for (size_t k = 0; k < 4; ++k) differences[k] = hn::Xor(mine, hn::LoadU(dw, bits + steps[k]));
    const auto different =
        hn::Or(hn::Or(differences[0], differences[1]), hn::Or(differences[2], differences[3]));
    if (hn::AllTrue(dw, hn::Eq(hn::Or(mine, different), hn::Zero(dw)))) continue;

    const float* distances = planes.inverse_distance.data() + first;
    // The two next to each other along an axis lie on one surface where either side predicts the other. False
    // beside pixels without a surface.
    const auto smooth = [&](std::ptrdiff_t at, std::ptrdiff_t step) {
      const float* p = distances + at;
      const auto here = hn::LoadU(d, p);
      return hn::Le(Bend(hn::LoadU(d, p - step), here, hn::LoadU(d, p + step)), MostBend(tolerance, here));
    };
    const auto smooth_x = smooth(0, 1);
    const auto smooth_y = smooth(0, planes.stride);
    const auto inner =
        hn::RebindMask(d, hn::Eq(hn::And(NumbersFrom(di, x), hn::Set(di, kInnerStride - 1)), inner_column));
    const auto settled = hn::AndNot(inner, hn::And(smooth_x, smooth_y));
    const auto here = hn::LoadU(d, distances);
    const auto visible = hn::Eq(here, here);
    const auto has_bits = [&](hn::Vec<Words> v) { return hn::RebindMask(d, hn::Ne(v, hn::Zero(dw))); };
    const auto candidate = hn::And(visible, hn::Or(has_bits(different), hn::AndNot(settled, has_bits(mine))));
    if (hn::AllFalse(d, candidate)) continue;

    const hn::Mask<Floats> continuous[4] = {
        hn::Or(smooth_x, smooth(steps[0], 1)), hn::Or(smooth_x, smooth(steps[1], 1)),
        hn::Or(smooth_y, smooth(steps[2], planes.stride)), hn::Or(smooth_y, smooth(steps[3], planes.stride))};
    auto crossing = hn::Zero(dw);
    auto narrow = hn::Zero(dw);
    auto goes_on = hn::Zero(dw);
    const hn::Vec<Words> unlike[4] = {differences[0], differences[1], differences[2], differences[3]};
    for (size_t k = 0; k < 4; ++k) {
      const auto neighbour = hn::LoadU(d, distances + steps[k]);
      differences[k] = hn::IfThenElseZero(hn::RebindMask(dw, hn::Eq(neighbour, neighbour)), differences[k]);
      crossing = hn::Or(crossing, differences[k]);
      // What the pixels behind this one have, seen from neighbour k.
      static_assert(kWideSamples == 3);
      const size_t behind = k ^ 1;
      const auto unlike_behind =
          hn::Or(unlike[behind], hn::Xor(mine, hn::LoadU(dw, bits + 2 * steps[behind])));
      narrow = hn::Or(narrow, hn::IfThenElse(hn::RebindMask(dw, continuous[behind]),
                                             hn::And(differences[k], unlike_behind), differences[k]));
      goes_on = hn::Or(goes_on, hn::IfThenElseZero(hn::RebindMask(dw, continuous[k]), hn::Set(dw, 1u << k)));
    }
    const auto at_rim = hn::Or(hn::RebindMask(dw, inner), hn::Ne(goes_on, hn::Set(dw, 15u)));
    const auto rim = hn::IfThenElseZero(at_rim, mine);
    const auto chosen = hn::And(visible, has_bits(hn::Or(crossing, rim)));
    const Packing packed(dw, hn::RebindMask(dw, chosen));
    const auto store = [&](hn::Vec<Words> v, LaneList<uint32_t>* to) {
      hn::StoreU(packed(v), dw, to->data() + count);
    };
    const auto indices = hn::BitCast(dw, NumbersFrom(di, static_cast<int32_t>(first)));
    hn::StoreU(hn::BitCast(di, packed(indices)), di, active->index.data() + count);
    for (size_t k = 0; k < 4; ++k) store(differences[k], &active->crossing[k]);
    store(goes_on, &active->continuous);
    store(rim, &active->rim);
    store(narrow, &active->narrow);
    count += hn::CountTrue(d, chosen);
  }
  active->Resize(count);
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {

HWY_EXPORT(FindInRow);

void ActivePixels::Reserve(size_t size) {
  index.Reserve(size);
  for (LaneList<uint32_t>& lights : crossing) lights.Reserve(size);
  continuous.Reserve(size);
  rim.Reserve(size);
  narrow.Reserve(size);
}

void ActivePixels::Resize(size_t size) {
  index.Resize(size);
  for (LaneList<uint32_t>& lights : crossing) lights.Resize(size);
  continuous.Resize(size);
  rim.Resize(size);
  narrow.Resize(size);
}

bool ActivePixels::Has(int32_t pixel) const {
  if (size() == 0) return false;
  // What is left there of earlier frames does not point back.
  const auto place = static_cast<size_t>(place_of_index[static_cast<size_t>(pixel)]);
  return place < size() && index[place] == pixel;
}

void FindActivePixels(const PixelPlanes& planes, const BendTolerance& tolerance, ActivePixels* active) {
  for (int y = 0; y < planes.height; ++y) {
    active->Reserve(active->size() + static_cast<size_t>(planes.width));
    HWY_DYNAMIC_DISPATCH(FindInRow)(planes, tolerance, y, active);
  }
  active->index.Pad(static_cast<int32_t>(planes.Index(0, 0)));
  active->place_of_index.resize(planes.bits.size());
  for (size_t i = 0; i < active->size(); ++i) {
    active->place_of_index[static_cast<size_t>(active->index[i])] = static_cast<int32_t>(i);
  }
}

}  // namespace shadowfit
#endif
