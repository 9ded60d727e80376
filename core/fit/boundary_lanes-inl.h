// Boundary samples a vector at a time, for Highway's per-target code: included once for each target.

#if defined(SHADOWFIT_FIT_BOUNDARY_LANES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SHADOWFIT_FIT_BOUNDARY_LANES_INL_H_
#undef SHADOWFIT_FIT_BOUNDARY_LANES_INL_H_
#else
#define SHADOWFIT_FIT_BOUNDARY_LANES_INL_H_
#endif

#include <hwy/highway.h>

#include <glm/glm.hpp>
#include <vector>

#include "core/frame/light_samples.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

using BoundaryLanes = hn::CappedTag<double, 8>;
using Doubles = hn::Vec<BoundaryLanes>;

/// Three coordinates of several samples.
struct Doubles3 {
  Doubles x, y, z;
};

inline Doubles Dot(const Doubles3& a, const Doubles3& b) {
  return hn::Add(hn::Add(hn::Mul(a.x, b.x), hn::Mul(a.y, b.y)), hn::Mul(a.z, b.z));
}

inline Doubles3 Cross(const Doubles3& a, const Doubles3& b) {
  return {hn::Sub(hn::Mul(a.y, b.z), hn::Mul(a.z, b.y)), hn::Sub(hn::Mul(a.z, b.x), hn::Mul(a.x, b.z)),
          hn::Sub(hn::Mul(a.x, b.y), hn::Mul(a.y, b.x))};
}

inline Doubles3 Times(const glm::dmat3& m, const Doubles3& v) {
  const BoundaryLanes d;
  const auto row = [&](int i) {
    return Dot({hn::Set(d, m[0][i]), hn::Set(d, m[1][i]), hn::Set(d, m[2][i])}, v);
  };
  return {row(0), row(1), row(2)};
}

/// Calls add(load) for all of `count` samples, some at a time. load(array) is their part of one of the
/// samples' arrays, 0 in lanes beyond the last sample; load(three arrays) that of three.
template <class Add>
void ForBoundaryLanes(size_t count, const Add& add) {
  const BoundaryLanes d;
  struct Load {
    hn::Mask<BoundaryLanes> mask;
    size_t first;
    Doubles operator()(const std::vector<double>& v) const {
      return hn::MaskedLoad(mask, BoundaryLanes(), v.data() + first);
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
