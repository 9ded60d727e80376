#include "core/frame/pixel_scan.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/frame/pixel_scan.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/frame/number_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using Lanes = hn::CappedTag<float, kMostLanes>;
using BitLanes = hn::RebindToUnsigned<Lanes>;

void ScanDepth(const DepthView& depth, const InverseDistanceLaw& law, PixelPlanes* planes,
               VisibleDepths* visible) {
  const Lanes d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const auto zero = hn::Zero(d);
  const auto one = hn::Set(d, 1.0f);
  const auto background = hn::Set(d, law.background);
  const auto per_x = hn::Set(d, static_cast<float>(law.per_x));
  const auto per_depth = hn::Set(d, static_cast<float>(law.per_depth));
  const auto least = hn::Set(d, law.must_be_positive ? 0.0f : -std::numeric_limits<float>::infinity());
  const auto nothing = hn::Set(d, std::numeric_limits<float>::quiet_NaN());
  auto smallest = hn::Set(d, visible->smallest);
  auto largest = hn::Set(d, visible->largest);
  size_t count = 0;
  for (int y = 0; y < depth.height; ++y) {
    const float* row = depth.Row(y);
    const auto constant = hn::Set(d, static_cast<float>(law.constant + law.per_y * y));
    float* window_depth = planes->window_depth.data() + planes->Index(0, y);
    float* inverse_distance = planes->inverse_distance.data() + planes->Index(0, y);
    const auto scan = [&](int x, const float* source) {
      const auto value = hn::LoadU(d, source);
      const auto column = NumbersFrom(d, static_cast<float>(x));
      const auto inverse =
          hn::Add(constant, hn::Add(hn::Mul(per_x, column), hn::Mul(per_depth, hn::Sub(value, background))));
      // Comparisons are false for NaN.
      const auto seen =
          hn::And(hn::And(hn::And(hn::Ge(value, zero), hn::Le(value, one)), hn::Ne(value, background)),
                  hn::Gt(inverse, least));
      hn::StoreU(value, d, window_depth + x);
      hn::StoreU(hn::IfThenElse(seen, inverse, nothing), d, inverse_distance + x);
      smallest = hn::IfThenElse(seen, hn::Min(smallest, value), smallest);
      largest = hn::IfThenElse(seen, hn::Max(largest, value), largest);
      count += hn::CountTrue(d, seen);
    };
    int x = 0;
    for (; x + lanes <= depth.width; x += lanes) scan(x, row + x);
    if (x == depth.width) continue;
    std::array<float, kMostLanes> tail;
    tail.fill(law.background);
    std::copy(row + x, row + depth.width, tail.begin());
    scan(x, tail.data());
  }
  visible->smallest = hn::GetLane(hn::MinOfLanes(d, smallest));
  visible->largest = hn::GetLane(hn::MaxOfLanes(d, largest));
  visible->count += static_cast<int>(count);
}

void CopyBits(const BitsView& bits, uint32_t lights, PixelPlanes* planes) {
  const BitLanes d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const auto kept = hn::Set(d, lights);
  for (int y = 0; y < bits.height; ++y) {
    const uint32_t* row = bits.Row(y);
    uint32_t* to = planes->bits.data() + planes->Index(0, y);
    const auto copy = [&](int x) { hn::StoreU(hn::And(hn::LoadU(d, row + x), kept), d, to + x); };
    int x = 0;
    for (; x + lanes <= bits.width; x += lanes) copy(x);
    // The last vector has some pixels of the one before again.
    if (bits.width >= lanes) {
      copy(bits.width - lanes);
    } else {
      for (; x < bits.width; ++x) to[x] = row[x] & lights;
    }
  }
}

/// 16 pixels at a time, of which of(x) gives a vector's mask.
template <class MaskOf>
void PackRow(int width, uint8_t* packed, const MaskOf& of) {
  const Lanes d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  for (int x = 0; x < width; x += kMostLanes) {
    uint32_t bits = 0;
    for (int lane = 0; lane < kMostLanes; lane += lanes) {
      std::array<uint8_t, 8> bytes{};
      hn::StoreMaskBits(d, of(x + lane), bytes.data());
      bits |= static_cast<uint32_t>(bytes[0] | bytes[1] << 8) << lane;
    }
    packed[x / 8] = static_cast<uint8_t>(bits);
    packed[x / 8 + 1] = static_cast<uint8_t>(bits >> 8);
  }
}

void PackVisible(const PixelPlanes& planes, PackedBits* packed) {
  for (int y = 0; y < planes.height; ++y) {
    const float* row = planes.inverse_distance.data() + planes.Index(0, y);
    PackRow(planes.width, packed->bytes.data() + planes.Index(0, y) / 8, [&](int x) {
      const auto here = hn::LoadU(Lanes(), row + x);
      return hn::Eq(here, here);
    });
  }
}

void PackLight(const PixelPlanes& planes, uint32_t light_bit, PackedBits* packed) {
  const BitLanes db;
  const auto bit = hn::Set(db, light_bit);
  for (int y = 0; y < planes.height; ++y) {
    const uint32_t* row = planes.bits.data() + planes.Index(0, y);
    PackRow(planes.width, packed->bytes.data() + planes.Index(0, y) / 8,
            [&](int x) { return hn::RebindMask(Lanes(), hn::TestBit(hn::LoadU(db, row + x), bit)); });
  }
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {

HWY_EXPORT(ScanDepth);
HWY_EXPORT(CopyBits);
HWY_EXPORT(PackVisible);
HWY_EXPORT(PackLight);

namespace {

/// Clears the rim where the picture has another size.
void Resize(const PixelPlanes& planes, PackedBits* packed) {
  if (packed->width == planes.width && packed->height == planes.height) return;
  packed->width = planes.width;
  packed->height = planes.height;
  packed->stride = planes.stride;
  // A window around the last pixel reads four bytes from its first on.
  packed->bytes.assign(planes.bits.size() / 8 + sizeof(uint32_t), 0);
}

}  // namespace

void PixelPlanes::Resize(int new_width, int new_height) {
  // The rim stays as it is from frame to frame, and the rest is overwritten.
  if (width == new_width && height == new_height) return;
  width = new_width;
  height = new_height;
  stride = kRimColumns + (width + kMostLanes - 1) / kMostLanes * kMostLanes;
  const auto size = static_cast<size_t>(stride) * static_cast<size_t>(height + 2 * kRimRows) + kMostLanes;
  window_depth.assign(size, 0.0f);
  inverse_distance.assign(size, std::numeric_limits<float>::quiet_NaN());
  bits.assign(size, 0);
}

VisibleDepths ScanDepth(const DepthView& depth, const InverseDistanceLaw& law, PixelPlanes* planes) {
  VisibleDepths visible;
  HWY_DYNAMIC_DISPATCH(ScanDepth)(depth, law, planes, &visible);
  return visible;
}

void CopyBits(const BitsView& bits, uint32_t lights, PixelPlanes* planes) {
  HWY_DYNAMIC_DISPATCH(CopyBits)(bits, lights, planes);
}

void PackVisible(const PixelPlanes& planes, PackedBits* packed) {
  Resize(planes, packed);
  HWY_DYNAMIC_DISPATCH(PackVisible)(planes, packed);
}

void PackLight(const PixelPlanes& planes, uint32_t light_bit, PackedBits* packed) {
  Resize(planes, packed);
  HWY_DYNAMIC_DISPATCH(PackLight)(planes, light_bit, packed);
}

}  // namespace shadowfit
#endif
