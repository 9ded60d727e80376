// Boundary samples a vector at a time, for Highway's per-target code: included once for each target.

#if defined(SHADOWFIT_FIT_BOUNDARY_LANES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SHADOWFIT_FIT_BOUNDARY_LANES_INL_H_
#undef SHADOWFIT_FIT_BOUNDARY_LANES_INL_H_
#else
#define SHADOWFIT_FIT_BOUNDARY_LANES_INL_H_
#endif

#include <hwy/highway.h>

#include <array>
#include <cstdint>
#include <vector>

#include "core/math/double_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

/// Calls add(load) for all of `count` samples, some at a time. load(array) is their part of one of the
/// samples' arrays, 0 in lanes beyond the last sample; load(three arrays) that of three.
template <class Add>
HWY_INLINE void ForBoundaryLanes(size_t count, const Add& add) {
  const DoubleLanes d;
  struct Load {
    hn::Mask<DoubleLanes> mask;
    size_t first;
    HWY_INLINE Doubles operator()(const std::vector<double>& v) const {
      return hn::MaskedLoad(mask, DoubleLanes(), v.data() + first);
    }
    HWY_INLINE Doubles3 operator()(const std::vector<double> (&v)[3]) const {
      return {(*this)(v[0]), (*this)(v[1]), (*this)(v[2])};
    }
  };
  for (size_t i = 0; i < count; i += hn::Lanes(d)) add(Load{hn::FirstN(d, count - i), i});
}

/// The same for samples `first`, first + stride and so on below `count`.
template <class Add>
HWY_INLINE void ForSomeBoundaryLanes(size_t first, size_t stride, size_t count, const Add& add) {
  const DoubleLanes d;
  const hn::RebindToSigned<DoubleLanes> di;
  struct Load {
    hn::Mask<DoubleLanes> mask;
    hn::Vec<hn::RebindToSigned<DoubleLanes>> indices;
    HWY_INLINE Doubles operator()(const std::vector<double>& v) const {
      return hn::IfThenElseZero(mask, hn::GatherIndex(DoubleLanes(), v.data(), indices));
    }
    HWY_INLINE Doubles3 operator()(const std::vector<double> (&v)[3]) const {
      return {(*this)(v[0]), (*this)(v[1]), (*this)(v[2])};
    }
  };
  std::array<int64_t, 8> multiples;
  for (size_t k = 0; k < multiples.size(); ++k) multiples[k] = static_cast<int64_t>(k * stride);
  const auto steps = hn::LoadU(di, multiples.data());
  for (size_t i = first; i < count; i += stride * hn::Lanes(d)) {
    const auto indices = hn::Add(hn::Set(di, static_cast<int64_t>(i)), steps);
    const auto within = hn::Lt(indices, hn::Set(di, static_cast<int64_t>(count)));
    add(Load{hn::RebindMask(d, within), hn::IfThenElseZero(within, indices)});
  }
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
