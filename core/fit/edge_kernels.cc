#include "core/fit/edge_kernels.h"

#include <cmath>

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

/// s/4 + t^2 / (12 s), s >= t the sorted p, q >= 0.
HWY_INLINE hn::Vec<Lanes> ExpectedWidth(hn::Vec<Lanes> p, hn::Vec<Lanes> q) {
  const Lanes d;
  const auto s = hn::Max(p, q);
  const auto t = hn::Min(p, q);
  return hn::Add(hn::Mul(hn::Set(d, 0.25f), s),
                 hn::Div(hn::Mul(hn::Mul(t, t), hn::Set(d, 1.0f / 12.0f)), hn::Add(s, hn::Set(d, 1e-30f))));
}

/// |g . b|
HWY_INLINE hn::Vec<Lanes> Along(const float* gx, const float* gy, size_t i, const float b[2]) {
  const Lanes d;
  return hn::Abs(hn::Add(hn::Mul(hn::LoadU(d, gx + i), hn::Set(d, b[0])),
                         hn::Mul(hn::LoadU(d, gy + i), hn::Set(d, b[1]))));
}

float EdgeCost(const float* gx, const float* gy, size_t count, const float b1[2], const float b2[2]) {
  const Lanes d;
  auto sum = hn::Zero(d);
  for (size_t i = 0; i < count; i += hn::Lanes(d)) {
    sum = hn::Add(sum, ExpectedWidth(Along(gx, gy, i, b1), Along(gx, gy, i, b2)));
  }
  return hn::GetLane(hn::SumOfLanes(d, sum));
}

/// Greatest minus least n . v.
float HullExtent(const float* vx, const float* vy, size_t count, float nx, float ny) {
  const Lanes d;
  const auto x = hn::Set(d, nx);
  const auto y = hn::Set(d, ny);
  auto low = hn::Set(d, 1e30f);
  auto high = hn::Set(d, -1e30f);
  for (size_t i = 0; i < count; i += hn::Lanes(d)) {
    const auto along = hn::Add(hn::Mul(hn::LoadU(d, vx + i), x), hn::Mul(hn::LoadU(d, vy + i), y));
    low = hn::Min(low, along);
    high = hn::Max(high, along);
  }
  return hn::GetLane(hn::MaxOfLanes(d, high)) - hn::GetLane(hn::MinOfLanes(d, low));
}

void HullExtents(const float* vx, const float* vy, size_t count, const float n1[2], const float n2[2],
                 float extents[2]) {
  extents[0] = HullExtent(vx, vy, count, n1[0], n1[1]);
  extents[1] = HullExtent(vx, vy, count, n2[0], n2[1]);
}

void EdgeCostsOfPairs(const float* gx, const float* gy, size_t count, const float* vx, const float* vy,
                      size_t hull_count, const float directions[kCoarseDirections][2], float width,
                      float height, float costs[kCoarseDirections][kCoarseDirections]) {
  const Lanes d;
  float along[kCoarseDirections][kMostGathered];
  float extents[kCoarseDirections];
  for (size_t k = 0; k < kCoarseDirections; ++k) {
    const float* direction = directions[k];
    extents[k] = HullExtent(vx, vy, hull_count, -direction[1], direction[0]);
    for (size_t i = 0; i < count; i += hn::Lanes(d)) {
      hn::StoreU(Along(gx, gy, i, direction), d, along[k] + i);
    }
  }
  const auto cost = [&](size_t i, size_t j) {
    const float sine = std::abs(directions[i][0] * directions[j][1] - directions[i][1] * directions[j][0]);
    const auto step1 = hn::Set(d, extents[j] / (sine * width));
    const auto step2 = hn::Set(d, extents[i] / (sine * height));
    auto sum = hn::Zero(d);
    for (size_t k = 0; k < count; k += hn::Lanes(d)) {
      sum = hn::Add(sum, ExpectedWidth(hn::Mul(hn::LoadU(d, along[i] + k), step1),
                                       hn::Mul(hn::LoadU(d, along[j] + k), step2)));
    }
    return hn::GetLane(hn::SumOfLanes(d, sum));
  };
  for (size_t i = 0; i < kCoarseDirections; ++i) {
    for (size_t j = i + 1; j < kCoarseDirections; ++j) {
      costs[i][j] = cost(i, j);
      costs[j][i] = width == height ? costs[i][j] : cost(j, i);
    }
  }
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {

HWY_EXPORT(EdgeCovectors);
HWY_EXPORT(EdgeCost);
HWY_EXPORT(EdgeCostsOfPairs);
HWY_EXPORT(HullExtents);

void EdgeCovectors(const float* x, const float* y, const float* e1, const float* e2, const float* e3,
                   size_t count, float a, float b, int bins, float* gx, float* gy, int32_t* bin) {
  HWY_DYNAMIC_DISPATCH(EdgeCovectors)(x, y, e1, e2, e3, count, a, b, bins, gx, gy, bin);
}
float EdgeCost(const float* gx, const float* gy, size_t count, const float b1[2], const float b2[2]) {
  return HWY_DYNAMIC_DISPATCH(EdgeCost)(gx, gy, count, b1, b2);
}
void EdgeCostsOfPairs(const float* gx, const float* gy, size_t count, const float* vx, const float* vy,
                      size_t hull_count, const float directions[kCoarseDirections][2], float width,
                      float height, float costs[kCoarseDirections][kCoarseDirections]) {
  HWY_DYNAMIC_DISPATCH(EdgeCostsOfPairs)
  (gx, gy, count, vx, vy, hull_count, directions, width, height, costs);
}
void HullExtents(const float* vx, const float* vy, size_t count, const float n1[2], const float n2[2],
                 float extents[2]) {
  HWY_DYNAMIC_DISPATCH(HullExtents)(vx, vy, count, n1, n2, extents);
}

}  // namespace shadowfit
#endif
