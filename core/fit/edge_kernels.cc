#include "core/fit/edge_kernels.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/fit/edge_kernels.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using Lanes = hn::CappedTag<float, kEdgeLanes>;

void EdgeCovectors(const float* x, const float* y, const float* e1, const float* e2, const float* e3,
                   size_t count, float a, float b, int bins, float* gx, float* gy, int32_t* bin) {
  const Lanes d;
  const hn::RebindToSigned<Lanes> di;
  const auto va = hn::Set(d, a);
  const auto vb = hn::Set(d, b);
  const auto one = hn::Set(d, 1.0f);
  const auto half = hn::Set(d, 0.5f);
  const auto tiny = hn::Set(d, 1e-30f);
  const auto scale = hn::Set(d, static_cast<float>(bins));
  const auto last = hn::Set(d, static_cast<float>(bins) - 0.5f);
  for (size_t i = 0; i < count; i += hn::Lanes(d)) {
    const auto w = hn::Add(hn::Add(one, hn::Mul(va, hn::LoadU(d, x + i))), hn::Mul(vb, hn::LoadU(d, y + i)));
    const auto third = hn::LoadU(d, e3 + i);
    const auto cx = hn::Mul(w, hn::Sub(hn::LoadU(d, e1 + i), hn::Mul(va, third)));
    const auto cy = hn::Mul(w, hn::Sub(hn::LoadU(d, e2 + i), hn::Mul(vb, third)));
    const auto below = hn::Lt(cy, hn::Zero(d));
    const auto ux = hn::IfThenElse(below, hn::Neg(cx), cx);
    const auto uy = hn::Abs(cy);
    const auto diamond = hn::Sub(half, hn::Div(hn::Mul(half, ux), hn::Add(hn::Add(hn::Abs(ux), uy), tiny)));
    hn::StoreU(ux, d, gx + i);
    hn::StoreU(uy, d, gy + i);
    hn::StoreU(hn::ConvertTo(di, hn::Min(hn::Mul(diamond, scale), last)), di, bin + i);
  }
}

float EdgeCost(const float* gx, const float* gy, size_t count, const float b1[2], const float b2[2]) {
  const Lanes d;
  const auto b1x = hn::Set(d, b1[0]);
  const auto b1y = hn::Set(d, b1[1]);
  const auto b2x = hn::Set(d, b2[0]);
  const auto b2y = hn::Set(d, b2[1]);
  const auto quarter = hn::Set(d, 0.25f);
  const auto twelfth = hn::Set(d, 1.0f / 12.0f);
  const auto tiny = hn::Set(d, 1e-30f);
  auto sum = hn::Zero(d);
  for (size_t i = 0; i < count; i += hn::Lanes(d)) {
    const auto x = hn::LoadU(d, gx + i);
    const auto y = hn::LoadU(d, gy + i);
    const auto p = hn::Abs(hn::Add(hn::Mul(x, b1x), hn::Mul(y, b1y)));
    const auto q = hn::Abs(hn::Add(hn::Mul(x, b2x), hn::Mul(y, b2y)));
    const auto s = hn::Max(p, q);
    const auto t = hn::Min(p, q);
    sum = hn::Add(sum,
                  hn::Add(hn::Mul(quarter, s), hn::Div(hn::Mul(hn::Mul(t, t), twelfth), hn::Add(s, tiny))));
  }
  return hn::GetLane(hn::SumOfLanes(d, sum));
}

void HullExtents(const float* vx, const float* vy, size_t count, const float n1[2], const float n2[2],
                 float extents[2]) {
  const Lanes d;
  const auto n1x = hn::Set(d, n1[0]);
  const auto n1y = hn::Set(d, n1[1]);
  const auto n2x = hn::Set(d, n2[0]);
  const auto n2y = hn::Set(d, n2[1]);
  auto low1 = hn::Set(d, 1e30f);
  auto low2 = low1;
  auto high1 = hn::Set(d, -1e30f);
  auto high2 = high1;
  for (size_t i = 0; i < count; i += hn::Lanes(d)) {
    const auto x = hn::LoadU(d, vx + i);
    const auto y = hn::LoadU(d, vy + i);
    const auto along1 = hn::Add(hn::Mul(x, n1x), hn::Mul(y, n1y));
    const auto along2 = hn::Add(hn::Mul(x, n2x), hn::Mul(y, n2y));
    low1 = hn::Min(low1, along1);
    high1 = hn::Max(high1, along1);
    low2 = hn::Min(low2, along2);
    high2 = hn::Max(high2, along2);
  }
  extents[0] = hn::GetLane(hn::MaxOfLanes(d, high1)) - hn::GetLane(hn::MinOfLanes(d, low1));
  extents[1] = hn::GetLane(hn::MaxOfLanes(d, high2)) - hn::GetLane(hn::MinOfLanes(d, low2));
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {

HWY_EXPORT(EdgeCovectors);
HWY_EXPORT(EdgeCost);
HWY_EXPORT(HullExtents);

void EdgeCovectors(const float* x, const float* y, const float* e1, const float* e2, const float* e3,
                   size_t count, float a, float b, int bins, float* gx, float* gy, int32_t* bin) {
  HWY_DYNAMIC_DISPATCH(EdgeCovectors)(x, y, e1, e2, e3, count, a, b, bins, gx, gy, bin);
}
float EdgeCost(const float* gx, const float* gy, size_t count, const float b1[2], const float b2[2]) {
  return HWY_DYNAMIC_DISPATCH(EdgeCost)(gx, gy, count, b1, b2);
}
void HullExtents(const float* vx, const float* vy, size_t count, const float n1[2], const float n2[2],
                 float extents[2]) {
  HWY_DYNAMIC_DISPATCH(HullExtents)(vx, vy, count, n1, n2, extents);
}

}  // namespace shadowfit
#endif
