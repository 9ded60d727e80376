#include "core/frame/pixel_scan.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/frame/pixel_scan.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using Lanes = hn::CappedTag<float, kMostLanes>;
using BitLanes = hn::RebindToUnsigned<Lanes>;

/// One row of ScanDepth; `constant` holds the law's terms in y.
void ScanDepthRow(const float* depth, int width, const InverseDistanceLaw& law, double constant,
                  float* inverse_distance, VisibleDepths* visible) {
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
  std::array<float, kMostLanes> tail;
  for (int x = 0; x < width; x += lanes) {
    const float* source = depth + x;
    if (x + lanes > width) {
      tail.fill(law.background);
      std::copy(depth + x, depth + width, tail.begin());
      source = tail.data();
    }
    const auto value = hn::LoadU(d, source);
    const auto column = hn::Iota(d, static_cast<float>(x));
    const auto inverse =
        hn::Add(hn::Set(d, static_cast<float>(constant)),
                hn::Add(hn::Mul(per_x, column), hn::Mul(per_depth, hn::Sub(value, background))));
    // Comparisons are false for NaN.
    const auto seen =
        hn::And(hn::And(hn::And(hn::Ge(value, zero), hn::Le(value, one)), hn::Ne(value, background)),
                hn::Gt(inverse, least));
    hn::StoreU(hn::IfThenElse(seen, inverse, nothing), d, inverse_distance + x);
    smallest = hn::IfThenElse(seen, hn::Min(smallest, value), smallest);
    largest = hn::IfThenElse(seen, hn::Max(largest, value), largest);
    count += hn::CountTrue(d, seen);
  }
  visible->smallest = hn::GetLane(hn::MinOfLanes(d, smallest));
  visible->largest = hn::GetLane(hn::MaxOfLanes(d, largest));
  visible->count += static_cast<int>(count);
}

/// One row of FindBoundaryCandidates, from the pixel with index `first` on; returns how many were found.
size_t FindBoundaryCandidatesRow(const float* inverse_distance, const uint32_t* bits, std::ptrdiff_t stride,
                                 std::ptrdiff_t first, int width, const BendTolerance& tolerance,
                                 int32_t* candidates) {
  const Lanes d;
  const BitLanes db;
  const auto relative = hn::Set(d, tolerance.relative);
  const auto absolute = hn::Set(d, tolerance.absolute);
  size_t found = 0;
  for (int x = 0; x < width; x += static_cast<int>(hn::Lanes(d))) {
    const float* z = inverse_distance + first + x;
    const auto here = hn::LoadU(d, z);
    const auto allowed = hn::Add(hn::Mul(relative, here), absolute);
    const auto bend = [&](std::ptrdiff_t step) {
      return hn::Abs(hn::Add(hn::Sub(hn::LoadU(d, z - step), hn::Add(here, here)), hn::LoadU(d, z + step)));
    };
    // False beside NaN: pixels without a surface.
    const auto smooth = hn::And(hn::Le(bend(1), allowed), hn::Le(bend(stride), allowed));
    const uint32_t* b = bits + first + x;
    const auto mine = hn::LoadU(db, b);
    const auto difference =
        hn::Or(hn::Or(hn::Xor(mine, hn::LoadU(db, b - 1)), hn::Xor(mine, hn::LoadU(db, b + 1))),
               hn::Or(hn::Xor(mine, hn::LoadU(db, b - stride)), hn::Xor(mine, hn::LoadU(db, b + stride))));
    const auto differs = hn::RebindMask(d, hn::Ne(difference, hn::Zero(db)));
    const auto shadowed = hn::RebindMask(d, hn::Ne(mine, hn::Zero(db)));
    const auto candidate = hn::And(hn::Eq(here, here), hn::Or(differs, hn::AndNot(smooth, shadowed)));
    std::array<uint8_t, 8> mask_bytes{};
    hn::StoreMaskBits(d, candidate, mask_bytes.data());
    uint64_t mask;
    std::memcpy(&mask, mask_bytes.data(), sizeof mask);
    for (; mask != 0; mask &= mask - 1) {
      const int lane = __builtin_ctzll(mask);
      if (x + lane < width) candidates[found++] = static_cast<int32_t>(first + x + lane);
    }
  }
  return found;
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

void PackVisibleRow(const float* inverse_distance, int width, uint8_t* packed) {
  PackRow(width, packed, [&](int x) {
    const auto here = hn::LoadU(Lanes(), inverse_distance + x);
    return hn::Eq(here, here);
  });
}

void PackLightRow(const uint32_t* bits, uint32_t light_bit, int width, uint8_t* packed) {
  const BitLanes db;
  PackRow(width, packed, [&](int x) {
    return hn::RebindMask(Lanes(), hn::TestBit(hn::LoadU(db, bits + x), hn::Set(db, light_bit)));
  });
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {

HWY_EXPORT(ScanDepthRow);
HWY_EXPORT(FindBoundaryCandidatesRow);
HWY_EXPORT(PackVisibleRow);
HWY_EXPORT(PackLightRow);

void PixelPlanes::Resize(int new_width, int new_height) {
  // The rim stays as it is from frame to frame, and the rest is overwritten.
  if (width == new_width && height == new_height) return;
  width = new_width;
  height = new_height;
  stride = width + 2 + kMostLanes;
  const auto size = static_cast<size_t>(stride) * static_cast<size_t>(height + 2) + kMostLanes;
  inverse_distance.assign(size, std::numeric_limits<float>::quiet_NaN());
  bits.assign(size, 0);
}

void PackedBits::Resize(int width, int height) {
  if (width_ == width && height_ == height) return;
  width_ = width;
  height_ = height;
  // A window reads four bytes from its first on.
  stride_ = static_cast<size_t>((width + kMostLanes - 1) / kMostLanes * kMostLanes / 8 + kBorder) + 4;
  bytes_.assign(stride_ * static_cast<size_t>(height + 2 * kBorderRows), 0);
}

VisibleDepths ScanDepth(const DepthView& depth, const InverseDistanceLaw& law, PixelPlanes* planes) {
  VisibleDepths visible;
  for (int y = 0; y < depth.height; ++y) {
    HWY_DYNAMIC_DISPATCH(ScanDepthRow)
    (depth.Row(y), depth.width, law, law.constant + law.per_y * y,
     planes->inverse_distance.data() + planes->Index(0, y), &visible);
  }
  return visible;
}

void CopyBits(const BitsView& bits, uint32_t lights, PixelPlanes* planes) {
  for (int y = 0; y < bits.height; ++y) {
    const uint32_t* row = bits.Row(y);
    std::transform(row, row + bits.width, planes->bits.begin() + planes->Index(0, y),
                   [lights](uint32_t value) { return value & lights; });
  }
}

void PackVisible(const PixelPlanes& planes, PackedBits* packed) {
  packed->Resize(planes.width, planes.height);
  for (int y = 0; y < planes.height; ++y) {
    HWY_DYNAMIC_DISPATCH(PackVisibleRow)
    (planes.inverse_distance.data() + planes.Index(0, y), planes.width, packed->Row(y));
  }
}

void PackLight(const PixelPlanes& planes, uint32_t light_bit, PackedBits* packed) {
  packed->Resize(planes.width, planes.height);
  for (int y = 0; y < planes.height; ++y) {
    HWY_DYNAMIC_DISPATCH(PackLightRow)
    (planes.bits.data() + planes.Index(0, y), light_bit, planes.width, packed->Row(y));
  }
}

std::span<const int32_t> FindBoundaryCandidates(const PixelPlanes& planes, const BendTolerance& tolerance,
                                                std::vector<int32_t>* scratch) {
  const size_t pixels = static_cast<size_t>(planes.width) * static_cast<size_t>(planes.height);
  if (scratch->size() < pixels) scratch->resize(pixels);
  size_t found = 0;
  for (int y = 0; y < planes.height; ++y) {
    found += HWY_DYNAMIC_DISPATCH(FindBoundaryCandidatesRow)(
        planes.inverse_distance.data(), planes.bits.data(), planes.stride, planes.Index(0, y), planes.width,
        tolerance, scratch->data() + found);
  }
  return {scratch->data(), found};
}

}  // namespace shadowfit
#endif
