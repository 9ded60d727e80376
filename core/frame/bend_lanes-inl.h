// How inverse distance bends, several pixels at once, for Highway's per-target code: included once for each
// target.

#if defined(SHADOWFIT_FRAME_BEND_LANES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SHADOWFIT_FRAME_BEND_LANES_INL_H_
#undef SHADOWFIT_FRAME_BEND_LANES_INL_H_
#else
#define SHADOWFIT_FRAME_BEND_LANES_INL_H_
#endif

#include <hwy/highway.h>

#include "core/frame/pixel_scan.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

/// The second difference's magnitude. NaN beside pixels without a surface.
template <class V>
HWY_INLINE V Bend(V before, V here, V after) {
  return hn::Abs(hn::Add(hn::Sub(before, hn::Add(here, here)), after));
}

/// How much is no discontinuity.
template <class V>
HWY_INLINE V MostBend(const BendTolerance& tolerance, V here) {
  const hn::DFromV<V> d;
  return hn::Add(hn::Mul(hn::Set(d, tolerance.relative), here), hn::Set(d, tolerance.absolute));
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
