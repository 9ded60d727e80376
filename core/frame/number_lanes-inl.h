// Consecutive numbers, for Highway's per-target code: included once for each target.

#if defined(SHADOWFIT_FRAME_NUMBER_LANES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SHADOWFIT_FRAME_NUMBER_LANES_INL_H_
#undef SHADOWFIT_FRAME_NUMBER_LANES_INL_H_
#else
#define SHADOWFIT_FRAME_NUMBER_LANES_INL_H_
#endif

#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

/// first, first + 1 and so on. Highway's Iota of a variable goes through memory, where a vector waits for the
/// lanes that it is loaded from; that of a constant does not.
template <class D>
HWY_INLINE hn::Vec<D> NumbersFrom(D d, hn::TFromD<D> first) {
  return hn::Add(hn::Iota(d, 0), hn::Set(d, first));
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
