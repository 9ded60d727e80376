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
  uint32_t bits;
  std::memcpy(&bits, bytes, sizeof(bits));
  return bits;
}

HWY_INLINE MF LanesOf(uint32_t bits) {
  uint8_t bytes[8] = {};
  std::memcpy(bytes, &bits, sizeof(bits));
  return hn::LoadMaskBits(df, bytes);
}

HWY_INLINE MF NoLanes() { return hn::MaskFromVec(hn::Zero(df)); }

HWY_INLINE VF CombineHalves(const VH halves[2]) { return hn::Combine(df, halves[1], halves[0]); }

HWY_INLINE VI ClampedInt(VF value, int limit) {
  return hn::ConvertTo(di, hn::Min(hn::Max(value, hn::Zero(df)), hn::Set(df, static_cast<float>(limit))));
}

HWY_INLINE int ScalarClampedInt(float value, int limit) {
  return static_cast<int>(std::min(std::max(value, 0.0f), static_cast<float>(limit)));
}

// Samples and triangles find their cells by the same arithmetic, which is monotonic in u and in v: rounding
// cannot part them.

HWY_INLINE VI RowOf(const Face& face, VF v) {
  const VF bin = hn::Mul(hn::Sub(v, hn::Set(df, face.v_origin)), hn::Set(df, face.v_scale));
  return hn::GatherIndex(di, face.row_of_bin.data(), ClampedInt(bin, kRowBins - 1));
}

HWY_INLINE int ScalarRow(const Face& face, float v) {
  const float bin = (v - face.v_origin) * face.v_scale;
  return face.row_of_bin[static_cast<size_t>(ScalarClampedInt(bin, kRowBins - 1))];
}

/// A row's cells: first_cell + row * columns + column of plane coordinate u.
struct RowCells {
  VI first;
  VF origin, scale;
  int last_column;

  HWY_INLINE RowCells(const Face& face, VI row)
      : first(hn::Add(hn::Mul(row, hn::Set(di, face.columns)),
                      hn::Set(di, static_cast<int32_t>(face.first_cell)))),
        origin(hn::GatherIndex(df, face.row_u_origin.data(), row)),
        scale(hn::GatherIndex(df, face.row_u_scale.data(), row)),
        last_column(face.columns - 1) {}

  HWY_INLINE VI At(VF u) const {
    return hn::Add(first, ClampedInt(hn::Mul(hn::Sub(u, origin), scale), last_column));
  }
};

}  // namespace HWY_NAMESPACE
}  // namespace shadowfit::irregular
HWY_AFTER_NAMESPACE();

#endif
