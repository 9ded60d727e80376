#include "core/fit/edge_kernels.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

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

/// Covectors g = w h, h = (e1 - a e3, e2 - b e3), at an axis (a, b, 1).
struct Covectors {
  hn::Vec<Lanes> w, hx, hy, gx, gy;

  HWY_INLINE Covectors(hn::Vec<Lanes> a, hn::Vec<Lanes> b, hn::Vec<Lanes> x, hn::Vec<Lanes> y,
                       hn::Vec<Lanes> e1, hn::Vec<Lanes> e2, hn::Vec<Lanes> e3)
      : w(hn::MulAdd(a, x, hn::MulAdd(b, y, hn::Set(Lanes(), 1.0f)))),
        hx(hn::NegMulAdd(a, e3, e1)),
        hy(hn::NegMulAdd(b, e3, e2)),
        gx(hn::Mul(w, hx)),
        gy(hn::Mul(w, hy)) {}
};

EdgeSlopes EdgeCostAndSlopes(const float* x, const float* y, const float* e1, const float* e2,
                             const float* e3, size_t count, const float axis[2], const float b1[2],
                             const float b2[2]) {
  const Lanes d;
  const auto a = hn::Set(d, axis[0]);
  const auto b = hn::Set(d, axis[1]);
  const auto b1x = hn::Set(d, b1[0]);
  const auto b1y = hn::Set(d, b1[1]);
  const auto b2x = hn::Set(d, b2[0]);
  const auto b2y = hn::Set(d, b2[1]);
  const auto quarter = hn::Set(d, 0.25f);
  auto cost = hn::Zero(d);
  auto f1x = hn::Zero(d);
  auto f1y = hn::Zero(d);
  auto f2x = hn::Zero(d);
  auto f2y = hn::Zero(d);
  auto per_a = hn::Zero(d);
  auto per_b = hn::Zero(d);
  for (size_t i = 0; i < count; i += hn::Lanes(d)) {
    const auto vx = hn::LoadU(d, x + i);
    const auto vy = hn::LoadU(d, y + i);
    const auto third = hn::LoadU(d, e3 + i);
    const auto [w, hx, hy, gx, gy] =
        Covectors(a, b, vx, vy, hn::LoadU(d, e1 + i), hn::LoadU(d, e2 + i), third);
    const auto p = hn::MulAdd(gx, b1x, hn::Mul(gy, b1y));
    const auto q = hn::MulAdd(gx, b2x, hn::Mul(gy, b2y));
    const auto s = hn::Max(hn::Abs(p), hn::Abs(q));
    const auto ratio = hn::Div(hn::Min(hn::Abs(p), hn::Abs(q)), hn::Add(s, hn::Set(d, 1e-30f)));
    // With r = t / s: s/4 + t^2/(12 s) = s (1/4 + r^2/12), its slope along s is 1/4 - r^2/12, along t r/6.
    const auto bow = hn::Mul(hn::Mul(ratio, ratio), hn::Set(d, 1.0f / 12.0f));
    cost = hn::MulAdd(s, hn::Add(quarter, bow), cost);
    const auto per_s = hn::Sub(quarter, bow);
    const auto per_t = hn::Mul(ratio, hn::Set(d, 1.0f / 6.0f));
    const auto p_is_s = hn::Ge(hn::Abs(p), hn::Abs(q));
    const auto per_p = hn::CopySign(hn::IfThenElse(p_is_s, per_s, per_t), p);
    const auto per_q = hn::CopySign(hn::IfThenElse(p_is_s, per_t, per_s), q);
    f1x = hn::MulAdd(per_p, gx, f1x);
    f1y = hn::MulAdd(per_p, gy, f1y);
    f2x = hn::MulAdd(per_q, gx, f2x);
    f2y = hn::MulAdd(per_q, gy, f2y);
    // c = df/dg; dg/da = x h - w e3 (1, 0), dg/db = y h - w e3 (0, 1).
    const auto cx = hn::MulAdd(per_p, b1x, hn::Mul(per_q, b2x));
    const auto cy = hn::MulAdd(per_p, b1y, hn::Mul(per_q, b2y));
    const auto c_h = hn::MulAdd(cx, hx, hn::Mul(cy, hy));
    const auto turn = hn::Mul(w, third);
    per_a = hn::Add(per_a, hn::NegMulAdd(cx, turn, hn::Mul(c_h, vx)));
    per_b = hn::Add(per_b, hn::NegMulAdd(cy, turn, hn::Mul(c_h, vy)));
  }
  const auto sum = [&](hn::Vec<Lanes> v) { return hn::GetLane(hn::SumOfLanes(d, v)); };
  return {sum(cost), {sum(f1x), sum(f1y)}, {sum(f2x), sum(f2y)}, {sum(per_a), sum(per_b)}};
}

float WeighByTangent(const float* x, const float* y, const EdgeLimits& limits, size_t count,
                     const float axis[2], const float b1[2], const float b2[2], float* e1, float* e2,
                     float* e3) {
  const Lanes d;
  const auto a = hn::Set(d, axis[0]);
  const auto b = hn::Set(d, axis[1]);
  const auto one = hn::Set(d, 1.0f);
  auto sum = hn::Zero(d);
  for (size_t i = 0; i < count; i += hn::Lanes(d)) {
    const auto first = hn::LoadU(d, e1 + i);
    const auto second = hn::LoadU(d, e2 + i);
    const auto third = hn::LoadU(d, e3 + i);
    const Covectors g(a, b, hn::LoadU(d, x + i), hn::LoadU(d, y + i), first, second, third);
    const auto along = [&](const float step[2]) {
      return hn::Abs(hn::MulAdd(g.gx, hn::Set(d, step[0]), hn::Mul(g.gy, hn::Set(d, step[1]))));
    };
    const auto cost = ExpectedWidth(along(b1), along(b2));
    // c / (1 + c/k) has the slope 1 / (1 + c/k)^2.
    const auto share = [&](const float* inverse) {
      return hn::Div(one, hn::MulAdd(cost, hn::LoadU(d, inverse + i), one));
    };
    const auto plain = share(limits.inverse_limit);
    const auto wide = share(limits.inverse_tail_limit);
    const auto tail = hn::LoadU(d, limits.tail + i);
    const auto mixed = [&](auto a, auto b) { return hn::MulAdd(tail, hn::Sub(b, a), a); };
    const auto weight = mixed(hn::Mul(plain, plain), hn::Mul(wide, wide));
    sum = hn::MulAdd(cost, mixed(plain, wide), sum);
    hn::StoreU(hn::Mul(first, weight), d, e1 + i);
    hn::StoreU(hn::Mul(second, weight), d, e2 + i);
    hn::StoreU(hn::Mul(third, weight), d, e3 + i);
  }
  return hn::GetLane(hn::SumOfLanes(d, sum));
}

/// The least and the greatest of a linear function so far, lane by lane, and where they are.
struct Supports {
  hn::Vec<Lanes> low, low_x, low_y, high, high_x, high_y;

  void Add(hn::Vec<Lanes> along, hn::Vec<Lanes> x, hn::Vec<Lanes> y) {
    const auto lower = hn::Lt(along, low);
    low = hn::IfThenElse(lower, along, low);
    low_x = hn::IfThenElse(lower, x, low_x);
    low_y = hn::IfThenElse(lower, y, low_y);
    const auto higher = hn::Gt(along, high);
    high = hn::IfThenElse(higher, along, high);
    high_x = hn::IfThenElse(higher, x, high_x);
    high_y = hn::IfThenElse(higher, y, high_y);
  }
  HullSupport Get() const {
    const Lanes d;
    const auto at = [&](hn::Mask<Lanes> best, hn::Vec<Lanes> v_x, hn::Vec<Lanes> v_y) {
      const auto lane = static_cast<size_t>(std::max<std::ptrdiff_t>(0, hn::FindFirstTrue(d, best)));
      return std::array<float, 2>{hn::ExtractLane(v_x, lane), hn::ExtractLane(v_y, lane)};
    };
    const auto lowest = at(hn::Eq(low, hn::MinOfLanes(d, low)), low_x, low_y);
    const auto highest = at(hn::Eq(high, hn::MaxOfLanes(d, high)), high_x, high_y);
    return {{lowest[0], lowest[1]}, {highest[0], highest[1]}};
  }
};

HullView ViewHull(const float* x, const float* y, size_t count, const float axis[2], const float normal1[2],
                  const float normal2[2]) {
  const Lanes d;
  const auto zero = hn::Zero(d);
  const Supports none = {hn::Set(d, 1e30f), zero, zero, hn::Set(d, -1e30f), zero, zero};
  Supports across1 = none;
  Supports across2 = none;
  auto least_w = hn::Set(d, 1e30f);
  auto most_w = zero;
  for (size_t i = 0; i < count; i += hn::Lanes(d)) {
    const auto vx = hn::LoadU(d, x + i);
    const auto vy = hn::LoadU(d, y + i);
    const auto w = hn::MulAdd(hn::Set(d, axis[0]), vx, hn::MulAdd(hn::Set(d, axis[1]), vy, hn::Set(d, 1.0f)));
    least_w = hn::Min(least_w, w);
    most_w = hn::Max(most_w, w);
    const auto px = hn::Div(vx, w);
    const auto py = hn::Div(vy, w);
    across1.Add(hn::MulAdd(px, hn::Set(d, normal1[0]), hn::Mul(py, hn::Set(d, normal1[1]))), px, py);
    across2.Add(hn::MulAdd(px, hn::Set(d, normal2[0]), hn::Mul(py, hn::Set(d, normal2[1]))), px, py);
  }
  return {hn::GetLane(hn::MinOfLanes(d, least_w)), hn::GetLane(hn::MaxOfLanes(d, most_w)), across1.Get(),
          across2.Get()};
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {

HWY_EXPORT(EdgeCovectors);
HWY_EXPORT(EdgeCost);
HWY_EXPORT(EdgeCostsOfPairs);
HWY_EXPORT(HullExtents);
HWY_EXPORT(EdgeCostAndSlopes);
HWY_EXPORT(WeighByTangent);
HWY_EXPORT(ViewHull);

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

EdgeSlopes EdgeCostAndSlopes(const float* x, const float* y, const float* e1, const float* e2,
                             const float* e3, size_t count, const float axis[2], const float b1[2],
                             const float b2[2]) {
  return HWY_DYNAMIC_DISPATCH(EdgeCostAndSlopes)(x, y, e1, e2, e3, count, axis, b1, b2);
}
float WeighByTangent(const float* x, const float* y, const EdgeLimits& limits, size_t count,
                     const float axis[2], const float b1[2], const float b2[2], float* e1, float* e2,
                     float* e3) {
  return HWY_DYNAMIC_DISPATCH(WeighByTangent)(x, y, limits, count, axis, b1, b2, e1, e2, e3);
}
HullView ViewHull(const float* x, const float* y, size_t count, const float axis[2], const float normal1[2],
                  const float normal2[2]) {
  return HWY_DYNAMIC_DISPATCH(ViewHull)(x, y, count, axis, normal1, normal2);
}

}  // namespace shadowfit
#endif
