#include "core/fit/outer_samples.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>
#include <span>

#include "core/fit/ray_hull.h"
#include "core/math/convex_hull.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/fit/outer_samples.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/math/double_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

/// Share of a product's size below which its sign is rounding: the polygon's own corners must not count as
/// inside it.
constexpr double kRounding = 1e-12;

/// Which of `count` rays may not be strictly on the positive side of all `sides` covectors, together with
/// their footprint r +- k dx1 +- k dx2, k = kFootprintReach, where dx1 is not null. A covector is linear, so
/// that the least of the five values is no less than c.r - k |c|.(|dx1| + |dx2|), component by component:
/// three numbers of a footprint for all sides. A covector's largest component is 1. Rays are x, y, z in turn.
/// Returns how many indices were written.
size_t RaysNotInside(const double* rays, const double* dx1, const double* dx2, size_t count,
                     const double (*covectors)[3], size_t sides, int32_t* outside) {
  const DoubleLanes d;
  const size_t lanes = hn::Lanes(d);
  const auto dot = [](const Doubles3& c, const Doubles3& v) {
    return hn::MulAdd(c.x, v.x, hn::MulAdd(c.y, v.y, hn::Mul(c.z, v.z)));
  };
  const auto abs = [](const Doubles3& v) { return Doubles3{hn::Abs(v.x), hn::Abs(v.y), hn::Abs(v.z)}; };
  size_t found = 0;
  size_t i = 0;
  for (; i + lanes <= count; i += lanes) {
    const Doubles3 ray = LoadPoints(rays + 3 * i);
    const Doubles3 sizes = abs(ray);
    const auto rounding = hn::Mul(hn::Set(d, kRounding), hn::Add(hn::Add(sizes.x, sizes.y), sizes.z));
    Doubles3 around{hn::Zero(d), hn::Zero(d), hn::Zero(d)};
    if (dx1 != nullptr) {
      const auto reach = hn::Set(d, LightSamples::kFootprintReach);
      const Doubles3 a = abs(LoadPoints(dx1 + 3 * i));
      const Doubles3 b = abs(LoadPoints(dx2 + 3 * i));
      around = Scaled(Plus(a, b), reach);
    }
    auto inside = hn::Eq(hn::Zero(d), hn::Zero(d));
    for (size_t side = 0; side < sides; ++side) {
      const double* c = covectors[side];
      const Doubles3 covector{hn::Set(d, c[0]), hn::Set(d, c[1]), hn::Set(d, c[2])};
      // False for NaN.
      inside = hn::And(inside, hn::Gt(dot(covector, ray), hn::Add(dot(abs(covector), around), rounding)));
    }
    std::array<uint8_t, 8> bytes{};
    hn::StoreMaskBits(d, inside, bytes.data());
    for (unsigned left = ~unsigned{bytes[0]} & ((1u << lanes) - 1); left != 0; left &= left - 1) {
      outside[found++] = static_cast<int32_t>(i) + std::countr_zero(left);
    }
  }
  for (; i < count; ++i) outside[found++] = static_cast<int32_t>(i);
  return found;
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {
namespace {

HWY_EXPORT(RaysNotInside);

constexpr size_t kCorners = 8;

/// Every this many samples make the octagon; any part of the samples makes a valid one.
constexpr size_t kProbes = 128;

/// Sides of the second polygon; hulls have about 16 vertices.
constexpr size_t kMostSides = 32;

/// Fewer samples than this need no second polygon.
constexpr size_t kFew = 32;

/// The chart in which the octagon is made: any in which all rays are in front.
std::optional<ImagePlane> FrontPlane(std::span<const glm::dvec3> probes, bool directional) {
  return directional ? ImagePlane{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}} : ImagePlane::Facing(probes);
}

/// The half planes whose intersection is a convex polygon, counter-clockwise in the chart, as covectors. A
/// point v is left of an edge (a, b) where (b - a) x (v - a) > 0, which is linear in the ray: times w.
struct InnerPolygon {
  std::array<double[3], kMostSides + 1> covectors;
  size_t sides = 0;

  InnerPolygon(const ImagePlane& plane, std::span<const glm::dvec2> corners) {
    for (size_t k = 0; k < corners.size(); ++k) {
      const glm::dvec2 a = corners[k];
      const glm::dvec2 edge = corners[(k + 1) % corners.size()] - a;
      if (edge == glm::dvec2(0.0)) continue;  // Two directions have the same extreme point.
      Add(edge.x * plane.b2 - edge.y * plane.b1 + (edge.y * a.x - edge.x * a.y) * plane.axis);
    }
    Add(plane.axis);
  }
  /// False for samples on one line.
  bool HasArea() const { return sides >= 4; }

 private:
  void Add(const glm::dvec3& covector) {
    const glm::dvec3 sizes = glm::abs(covector);
    const double largest = std::max({sizes.x, sizes.y, sizes.z});
    for (int axis = 0; axis < 3; ++axis) covectors[sides][axis] = covector[axis] / largest;
    ++sides;
  }
};

/// Rays and, where footprints are wanted, their derivatives.
struct Rays {
  const std::vector<glm::dvec3>* center;
  const std::vector<glm::dvec3>* dx1;
  const std::vector<glm::dvec3>* dx2;
};

std::vector<int32_t> Outside(const Rays& rays, const InnerPolygon& polygon) {
  static_assert(sizeof(glm::dvec3) == 3 * sizeof(double));
  const auto flat = [](const std::vector<glm::dvec3>* v) { return v == nullptr ? nullptr : &v->data()->x; };
  std::vector<int32_t> outside(rays.center->size());
  outside.resize(HWY_DYNAMIC_DISPATCH(RaysNotInside)(flat(rays.center), flat(rays.dx1), flat(rays.dx2),
                                                     rays.center->size(), polygon.covectors.data(),
                                                     polygon.sides, outside.data()));
  return outside;
}

/// Those of the chosen samples that are not inside the polygon of the chosen ones' hull, where footprints
/// reach at most.
std::vector<int32_t> OutsideOfTheirHull(const Rays& all, const ImagePlane& plane,
                                        const std::vector<int32_t>& chosen) {
  const auto of_chosen = [&](const std::vector<glm::dvec3>* from) {
    std::vector<glm::dvec3> some;
    if (from == nullptr) return some;
    some.reserve(chosen.size());
    for (const int32_t i : chosen) some.push_back((*from)[static_cast<size_t>(i)]);
    return some;
  };
  const std::vector<glm::dvec3> center = of_chosen(all.center);
  const std::vector<glm::dvec3> dx1 = of_chosen(all.dx1);
  const std::vector<glm::dvec3> dx2 = of_chosen(all.dx2);
  std::vector<glm::dvec2> points;
  points.reserve(center.size());
  for (const glm::dvec3& r : center) points.push_back(plane.Project(r));
  const std::vector<int> hull = ConvexHull2(points);
  const size_t stride = (hull.size() + kMostSides - 1) / kMostSides;
  std::vector<glm::dvec2> corners;
  for (size_t i = 0; i < hull.size(); i += stride) corners.push_back(points[static_cast<size_t>(hull[i])]);
  const InnerPolygon polygon(plane, corners);
  if (!polygon.HasArea()) return chosen;
  std::vector<int32_t> outer =
      Outside({&center, all.dx1 != nullptr ? &dx1 : nullptr, all.dx2 != nullptr ? &dx2 : nullptr}, polygon);
  for (int32_t& i : outer) i = chosen[static_cast<size_t>(i)];
  return outer;
}

}  // namespace

bool AnyInShadow(const LightSamples& samples) {
  return std::find(samples.hull_in_shadow.begin(), samples.hull_in_shadow.end(), 1) !=
         samples.hull_in_shadow.end();
}

std::vector<int32_t> HullSamples(const LightSamples& samples, HullOf hull_of) {
  std::vector<int32_t> chosen;
  const size_t count = samples.hull_rays.size();
  chosen.reserve(count);
  if (hull_of == HullOf::kShadow && AnyInShadow(samples)) {
    for (size_t i = 0; i < count; ++i) {
      if (samples.hull_in_shadow[i] != 0) chosen.push_back(static_cast<int32_t>(i));
    }
    return chosen;
  }
  chosen.resize(count);
  std::iota(chosen.begin(), chosen.end(), 0);
  return chosen;
}

std::vector<int32_t> OuterSamples(const LightSamples& samples, const RaySpace& ray_space, HullOf hull_of) {
  const std::vector<glm::dvec3>& rays = samples.hull_rays;
  const bool shadow_alone = hull_of == HullOf::kShadow && AnyInShadow(samples);
  const auto is_asked = [&](size_t i) { return !shadow_alone || samples.hull_in_shadow[i] != 0; };
  std::vector<glm::dvec3> probes;
  const size_t stride = std::max<size_t>(1, rays.size() / kProbes);
  for (size_t i = 0; i < rays.size(); i += stride) {
    if (is_asked(i)) probes.push_back(rays[i]);
  }
  const std::optional<ImagePlane> plane = FrontPlane(probes, ray_space.is_directional());
  if (probes.size() < 4 * kCorners || !plane) return HullSamples(samples, hull_of);
  constexpr std::array<std::array<double, 2>, kCorners> kAlong = {
      {{1, 0}, {1, 1}, {0, 1}, {-1, 1}, {-1, 0}, {-1, -1}, {0, -1}, {1, -1}}};
  std::array<double, kCorners> most;
  most.fill(-std::numeric_limits<double>::infinity());
  std::array<glm::dvec2, kCorners> corner;
  corner.fill(glm::dvec2(0.0));
  for (const glm::dvec3& probe : probes) {
    const glm::dvec2 p = plane->Project(probe);
    for (size_t k = 0; k < kCorners; ++k) {
      const double along = kAlong[k][0] * p.x + kAlong[k][1] * p.y;
      if (along > most[k]) {
        most[k] = along;
        corner[k] = p;
      }
    }
  }

  const InnerPolygon octagon(*plane, corner);
  if (!octagon.HasArea()) return HullSamples(samples, hull_of);
  const bool with_footprints = hull_of == HullOf::kShadow;
  const Rays all = {&rays, with_footprints ? &samples.hull_rays_dx1 : nullptr,
                    with_footprints ? &samples.hull_rays_dx2 : nullptr};
  std::vector<int32_t> outer = Outside(all, octagon);
  std::erase_if(outer, [&](int32_t i) { return !is_asked(static_cast<size_t>(i)); });
  if (!ray_space.is_directional()) {
    for (const int32_t i : outer) {
      if (!(glm::dot(plane->axis, rays[static_cast<size_t>(i)]) > 0.0)) return HullSamples(samples, hull_of);
    }
  }
  return outer.size() < kFew ? outer : OutsideOfTheirHull(all, *plane, outer);
}

}  // namespace shadowfit
#endif
