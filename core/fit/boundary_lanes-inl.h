// Boundary samples a vector at a time, for Highway's per-target code: included once for each target.

#if defined(SHADOWFIT_FIT_BOUNDARY_LANES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SHADOWFIT_FIT_BOUNDARY_LANES_INL_H_
#undef SHADOWFIT_FIT_BOUNDARY_LANES_INL_H_
#else
#define SHADOWFIT_FIT_BOUNDARY_LANES_INL_H_
#endif

#include <hwy/highway.h>

#include <vector>

#include "core/math/double_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

/// Calls add(load) for all of `count` samples, some at a time. load(array) is their part of one of the
/// samples' arrays, 0 in lanes beyond the last sample; load(three arrays) that of three.
template <class Add>
void ForBoundaryLanes(size_t count, const Add& add) {
  const DoubleLanes d;
  struct Load {
    hn::Mask<DoubleLanes> mask;
    size_t first;
    Doubles operator()(const std::vector<double>& v) const {
      return hn::MaskedLoad(mask, DoubleLanes(), v.data() + first);
    }
    Doubles3 operator()(const std::vector<double> (&v)[3]) const {
      return {(*this)(v[0]), (*this)(v[1]), (*this)(v[2])};
    }
  };
  for (size_t i = 0; i < count; i += hn::Lanes(d)) add(Load{hn::FirstN(d, count - i), i});
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
