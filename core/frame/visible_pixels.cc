#include "core/frame/visible_pixels.h"

#include <algorithm>
#include <limits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/frame/visible_pixels.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/frame/number_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

void ListRow(const PixelPlanes& planes, int y, VisiblePixels* pixels) {
  const hn::CappedTag<float, kMostLanes> d;
  const hn::RebindToSigned<decltype(d)> di;
  pixels->row.Reserve(static_cast<size_t>(planes.width));
  pixels->row_rim.Reserve(static_cast<size_t>(planes.width));
  size_t count = 0;
  size_t rim_count = 0;
  for (int x = 0; x < planes.width; x += static_cast<int>(hn::Lanes(d))) {
    const std::ptrdiff_t first = planes.Index(x, y);
    const auto visible = [&](std::ptrdiff_t step) {
      const auto distance = hn::LoadU(d, planes.inverse_distance.data() + first + step);
      return hn::RebindMask(di, hn::Eq(distance, distance));
    };
    auto enclosed = visible(0);
    for (const std::ptrdiff_t step : planes.NeighbourSteps()) enclosed = hn::And(enclosed, visible(step));
    const auto here = visible(0);
    const auto rim = hn::AndNot(enclosed, here);
    const auto indices = NumbersFrom(di, static_cast<int32_t>(first));
    hn::StoreU(hn::Compress(indices, here), di, pixels->row.data() + count);
    hn::StoreU(hn::Compress(indices, rim), di, pixels->row_rim.data() + rim_count);
    count += hn::CountTrue(di, here);
    rim_count += hn::CountTrue(di, rim);
  }
  pixels->row.Resize(count);
  pixels->row_rim.Resize(rim_count);
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {

HWY_EXPORT(ListRow);

void ListVisiblePixels(const PixelPlanes& planes, const ActivePixels& active, size_t stride,
                       VisiblePixels* pixels) {
  LaneList<int32_t>& index = pixels->index;
  index.Resize(active.size());
  std::copy_n(active.index.data(), active.size(), index.data());
  size_t next = 0;  // Place in the row of the next stride-th pixel.
  for (int y = 0; y < planes.height; ++y) {
    HWY_DYNAMIC_DISPATCH(ListRow)(planes, y, pixels);
    const LaneList<int32_t>& row = pixels->row;
    const LaneList<int32_t>& rim = pixels->row_rim;
    constexpr int32_t kNone = std::numeric_limits<int32_t>::max();
    for (size_t next_rim = 0; next < row.size() || next_rim < rim.size();) {
      const int32_t chosen = next < row.size() ? row[next] : kNone;
      const int32_t at_rim = next_rim < rim.size() ? rim[next_rim] : kNone;
      const int32_t first = std::min(chosen, at_rim);
      if (first == chosen) next += stride;
      if (first == at_rim) ++next_rim;
      if (!active.Has(first)) index.Append(first);
    }
    next -= row.size();
  }
  index.Pad(static_cast<int32_t>(planes.Index(0, 0)));
}

}  // namespace shadowfit
#endif
