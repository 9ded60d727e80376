// Several points or directions at once, in doubles, for Highway's per-target code: included once for each
// target.

#if defined(SHADOWFIT_MATH_DOUBLE_LANES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SHADOWFIT_MATH_DOUBLE_LANES_INL_H_
#undef SHADOWFIT_MATH_DOUBLE_LANES_INL_H_
#else
#define SHADOWFIT_MATH_DOUBLE_LANES_INL_H_
#endif

#include <hwy/highway.h>

#include <glm/glm.hpp>

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

using DoubleLanes = hn::CappedTag<double, 8>;
using Doubles = hn::Vec<DoubleLanes>;

/// Three coordinates of each.
struct Doubles3 {
  Doubles x, y, z;
};

HWY_INLINE Doubles3 Set(const glm::dvec3& v) {
  const DoubleLanes d;
  return {hn::Set(d, v.x), hn::Set(d, v.y), hn::Set(d, v.z)};
}
/// Of as many points, one after the other in memory.
HWY_INLINE Doubles3 LoadPoints(const double* from) {
  const DoubleLanes d;
  Doubles3 v{hn::Zero(d), hn::Zero(d), hn::Zero(d)};
  hn::LoadInterleaved3(d, from, v.x, v.y, v.z);
  return v;
}
HWY_INLINE Doubles3 Plus(const Doubles3& a, const Doubles3& b) {
  return {hn::Add(a.x, b.x), hn::Add(a.y, b.y), hn::Add(a.z, b.z)};
}
HWY_INLINE Doubles3 Minus(const Doubles3& a, const Doubles3& b) {
  return {hn::Sub(a.x, b.x), hn::Sub(a.y, b.y), hn::Sub(a.z, b.z)};
}
HWY_INLINE Doubles3 Scaled(const Doubles3& a, Doubles by) {
  return {hn::Mul(a.x, by), hn::Mul(a.y, by), hn::Mul(a.z, by)};
}
HWY_INLINE Doubles Dot(const Doubles3& a, const Doubles3& b) {
  return hn::Add(hn::Add(hn::Mul(a.x, b.x), hn::Mul(a.y, b.y)), hn::Mul(a.z, b.z));
}
HWY_INLINE Doubles3 Cross(const Doubles3& a, const Doubles3& b) {
  return {hn::Sub(hn::Mul(a.y, b.z), hn::Mul(a.z, b.y)), hn::Sub(hn::Mul(a.z, b.x), hn::Mul(a.x, b.z)),
          hn::Sub(hn::Mul(a.x, b.y), hn::Mul(a.y, b.x))};
}
HWY_INLINE Doubles3 Times(const glm::dmat3& m, const Doubles3& v) {
  return Plus(Plus(Scaled(Set(m[0]), v.x), Scaled(Set(m[1]), v.y)), Scaled(Set(m[2]), v.z));
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
