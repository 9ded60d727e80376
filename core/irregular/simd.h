// Types and helpers of the kernels; included once for each instruction set, and therefore without a guard of
// the usual kind.
#if defined(SHADOWFIT_IRREGULAR_SIMD_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SHADOWFIT_IRREGULAR_SIMD_H_
#undef SHADOWFIT_IRREGULAR_SIMD_H_
#else
#define SHADOWFIT_IRREGULAR_SIMD_H_
#endif

#include <hwy/highway.h>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <type_traits>

#include "core/irregular/mask_types.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::irregular {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

using DF = hn::CappedTag<float, 16>;
using DI = hn::RebindToSigned<DF>;
using DU = hn::RebindToUnsigned<DF>;
using DH = hn::Half<DF>;
using DD = hn::Rebind<double, DH>;
using VF = hn::Vec<DF>;
using VI = hn::Vec<DI>;
using VU = hn::Vec<DU>;
using VH = hn::Vec<DH>;
using VD = hn::Vec<DD>;
using MF = hn::Mask<DF>;

constexpr float kInfinity = std::numeric_limits<float>::infinity();
[[maybe_unused]] const DF df;
[[maybe_unused]] const DI di;
[[maybe_unused]] const DU du;
[[maybe_unused]] const DH dh;
[[maybe_unused]] const DD dd;
// CappedTag keeps this a compile-time constant.
constexpr int kLanes = static_cast<int>(hn::MaxLanes(DF()));
static_assert(16 % kLanes == 0 && kLanes >= 4);

HWY_INLINE uint32_t BitsOf(MF mask) {
  uint8_t bytes[8] = {};
  hn::StoreMaskBits(df, mask, bytes);
  // No wider than what is stored: then it never leaves the registers.
  std::conditional_t<(kLanes > 8), uint16_t, uint8_t> bits;
  std::memcpy(&bits, bytes, sizeof(bits));
  return bits;
}

HWY_INLINE MF LanesOf(uint32_t bits) {
  uint8_t bytes[8] = {};
  std::memcpy(bytes, &bits, sizeof(bits));
  return hn::LoadMaskBits(df, bytes);
}

HWY_INLINE MF NoLanes() { return hn::MaskFromVec(hn::Zero(df)); }

/// The first lanes, up to kLanes.
HWY_INLINE uint32_t FirstBits(uint32_t count) {
  constexpr uint32_t kAll = static_cast<uint32_t>((uint64_t{1} << kLanes) - 1);
  return count >= kLanes ? kAll : (1u << count) - 1;
}

/// Of a bit per sample, those of the kLanes samples from `first` on, and of some more.
HWY_INLINE uint32_t BitsAt(const uint32_t* words, uint32_t first) {
  words += first / 32;
  return static_cast<uint32_t>((uint64_t{words[1]} << 32 | words[0]) >> (first % 32));
}

HWY_INLINE VF CombineHalves(const VH halves[2]) { return hn::Combine(df, halves[1], halves[0]); }

HWY_INLINE VI ClampedInt(VF value, int limit) {
  return hn::ConvertTo(di, hn::Min(hn::Max(value, hn::Zero(df)), hn::Set(df, static_cast<float>(limit))));
}

/// What is in each block of four lanes changes places: of four vectors, one with the first lanes of all, and
/// so on.
HWY_INLINE void TransposeBlocks(VF rows[4]) {
  const auto pairs = [](VF v) HWY_ATTR { return hn::BitCast(dd, v); };
  const auto lower = [&](VF a, VF b)
                         HWY_ATTR { return hn::BitCast(df, hn::InterleaveLower(dd, pairs(a), pairs(b))); };
  const auto upper = [&](VF a, VF b)
                         HWY_ATTR { return hn::BitCast(df, hn::InterleaveUpper(dd, pairs(a), pairs(b))); };
  const VF lower01 = hn::InterleaveLower(df, rows[0], rows[1]);
  const VF lower23 = hn::InterleaveLower(df, rows[2], rows[3]);
  const VF upper01 = hn::InterleaveUpper(df, rows[0], rows[1]);
  const VF upper23 = hn::InterleaveUpper(df, rows[2], rows[3]);
  rows[0] = lower(lower01, lower23);
  rows[1] = upper(lower01, lower23);
  rows[2] = lower(upper01, upper23);
  rows[3] = upper(upper01, upper23);
}

/// Of an array of four values an element: elements index[0], index[4], index[8] and so on, one after the
/// other.
template <class D, typename Index>
HWY_INLINE hn::Vec<D> EveryFourth(D d, const float* fours, const Index* index) {
  if constexpr (hn::MaxLanes(D()) == 4) {
    return hn::Load(d, fours + size_t{4} * *index);
  } else {
    const hn::Half<D> half;
    return hn::Combine(d, EveryFourth(half, fours, index + hn::MaxLanes(half)),
                       EveryFourth(half, fours, index));
  }
}

/// See Face::BinAt.
HWY_INLINE VI BinOf(const Face& face, VF v) {
  const VF bin = hn::Mul(hn::Sub(v, hn::Set(df, face.v_origin)), hn::Set(df, face.v_scale));
  return ClampedInt(bin, static_cast<int>(face.row_of_bin.size()) - 1);
}

/// Rows of some bins.
struct RowLanes {
  VI number, first_cell;
  VF u_origin, u_scale;
  int last_column;

  HWY_INLINE RowLanes(const Face& face, VI bins) : last_column(face.columns - 1) {
    // A gather would cost as much as a load a lane, for each of the four values.
    static_assert(sizeof(Row) == 4 * sizeof(float));
    HWY_ALIGN uint32_t index[kLanes];
    hn::Store(hn::BitCast(du, bins), du, index);
    VF rows[4];
    for (size_t k = 0; k < 4; ++k) {
      rows[k] = EveryFourth(df, reinterpret_cast<const float*>(face.row_of_bin.data()), index + k);
    }
    TransposeBlocks(rows);
    number = hn::BitCast(di, rows[0]);
    first_cell = hn::Add(hn::BitCast(di, rows[1]), hn::Set(di, static_cast<int32_t>(face.first_cell)));
    u_origin = rows[2];
    u_scale = rows[3];
  }

  HWY_INLINE VI CellAt(VF u) const {
    return hn::Add(first_cell, ClampedInt(hn::Mul(hn::Sub(u, u_origin), u_scale), last_column));
  }
};

}  // namespace HWY_NAMESPACE
}  // namespace shadowfit::irregular
HWY_AFTER_NAMESPACE();

#endif
