#include "core/frame/pixel_surfaces.h"

#include <limits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/frame/pixel_surfaces.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/frame/bend_lanes-inl.h"
#include "core/math/double_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

using Lanes = DoubleLanes;
using FloatLanes = hn::Rebind<float, Lanes>;
using IndexLanes = hn::Rebind<int32_t, Lanes>;
static_assert(hn::MaxLanes(Lanes()) <= kMostLanes);

HWY_INLINE void Store(const Doubles3& v, size_t i, LaneList<glm::dvec3>* to) {
  static_assert(sizeof(glm::dvec3) == 3 * sizeof(double));
  hn::StoreInterleaved3(v.x, v.y, v.z, Lanes(), &to->data()[i].x);
}

/// Elements of a plane around pixels.
struct Around {
  const AlignedVector<float>& plane;
  hn::Vec<IndexLanes> indices;
  hn::Vec<FloatLanes> operator()(std::ptrdiff_t step) const {
    const IndexLanes di;
    return hn::GatherIndex(FloatLanes(), plane.data(),
                           hn::Add(indices, hn::Set(di, static_cast<int32_t>(step))));
  }
};

/// The derivative of depth along an axis, and where it can be trusted.
struct Derivative {
  Doubles value;
  hn::Vec<FloatLanes> known;  ///< 1 or 0.
};

/// Where the bend of a side's own pixels is less than this share of the bend here, the surface has a crease
/// on the other side; bends of less than the other share of what is a discontinuity may be depth's rounding.
constexpr float kFlat = 0.25f;
constexpr float kLeastCrease = 0.02f;

/// Of window depth, in NDC, from the neighbours `step` away. Central where the surface is smooth; else of the
/// side whose own bend is small, the smaller one. Bends are NaN beside pixels without a surface and where a
/// camera's entries are extreme: those fail every comparison, and never choose a side.
HWY_INLINE Derivative DepthDerivative(const Around& depths, const Around& distances, std::ptrdiff_t step,
                                      const BendTolerance& tolerance, double ndc_per_depth) {
  const Lanes d;
  const FloatLanes df;
  const auto here = distances(0);
  const auto behind = distances(-step);
  const auto ahead = distances(step);
  const auto one = hn::Set(df, 1.0f);
  const auto relative_bend = [&](hn::Vec<FloatLanes> before, hn::Vec<FloatLanes> at,
                                 hn::Vec<FloatLanes> after) {
    return hn::Div(Bend(before, at, after), MostBend(tolerance, at));
  };
  const auto central = relative_bend(behind, here, ahead);
  const auto forward = relative_bend(here, ahead, distances(2 * step));
  const auto backward = relative_bend(distances(-2 * step), behind, here);
  const auto flat = hn::Mul(hn::Set(df, kFlat), central);
  const auto creased = hn::And(hn::Gt(central, hn::Set(df, kLeastCrease)),
                               hn::Or(hn::Lt(forward, flat), hn::Lt(backward, flat)));
  const auto smooth = hn::AndNot(creased, hn::Le(central, one));
  const auto use_forward = hn::AndNot(hn::Lt(backward, forward), hn::Le(forward, one));
  const auto use_backward = hn::AndNot(use_forward, hn::Le(backward, one));
  const auto depth = depths(0);
  const auto to = hn::IfThenElse(hn::Or(smooth, use_forward), depths(step), depth);
  const auto from = hn::IfThenElse(hn::Or(smooth, use_backward), depths(-step), depth);
  const auto difference =
      hn::Mul(hn::Set(d, ndc_per_depth), hn::Sub(hn::PromoteTo(d, to), hn::PromoteTo(d, from)));
  const auto per_step = hn::PromoteTo(d, hn::IfThenElse(smooth, hn::Set(df, 0.5f), one));
  return {hn::Mul(per_step, difference),
          hn::IfThenElseZero(hn::Or(smooth, hn::Or(use_forward, use_backward)), one)};
}

/// (dX, dw) = world_from_clip (dclip): the change of a homogeneous point by that of its clip coordinates.
struct HomogeneousStep {
  Doubles3 xyz;
  Doubles w;
};

void Unproject(const Camera& camera, const PixelPlanes& planes, const BendTolerance& tolerance,
               const LaneList<int32_t>& indices, PixelSurfaces* surfaces) {
  const Lanes d;
  const glm::dmat4& m = camera.world_from_clip();
  const auto xyz = [&m](int column) { return Set(glm::dvec3(m[column])); };
  const auto w = [&](int column) { return hn::Set(d, m[column][3]); };
  // A step of one pixel along screen x or y, the depth's part left out.
  const auto per_column = hn::Set(d, 2.0 / planes.width);
  const auto per_row = hn::Set(d, 2.0 / planes.height);
  const HomogeneousStep step1{Scaled(xyz(0), per_column), hn::Mul(w(0), per_column)};
  const HomogeneousStep step2{Scaled(xyz(1), per_row), hn::Mul(w(1), per_row)};
  const Doubles3 eye = Set(glm::dvec3(camera.ws_eye()));
  const auto eye_w = hn::Set(d, camera.ws_eye().w);
  const auto zero = hn::Zero(d);
  const auto one = hn::Set(d, 1.0);
  const auto half = hn::Set(d, 0.5);
  const auto nothing = hn::Set(d, std::numeric_limits<double>::quiet_NaN());
  // NDC depth is an affine function of window depth.
  const double ndc_offset = NdcFromWindowDepth(camera.clip_depth(), 0.0);
  const double ndc_per_depth = NdcFromWindowDepth(camera.clip_depth(), 1.0) - ndc_offset;
  const auto stride = hn::Set(d, static_cast<double>(planes.stride));
  const auto rows_per_place = hn::Set(d, 1.0 / static_cast<double>(planes.stride));
  for (size_t i = 0; i < indices.size(); i += hn::Lanes(d)) {
    const auto index = hn::LoadU(IndexLanes(), indices.data() + i);
    const auto place = hn::PromoteTo(d, index);
    const auto row = hn::Floor(hn::Mul(hn::Add(place, half), rows_per_place));
    const auto column = hn::Sub(place, hn::Mul(row, stride));
    const auto ndc = [&](Doubles coordinate, int rim, Doubles per_pixel) {
      const auto centre = hn::Add(hn::Sub(coordinate, hn::Set(d, static_cast<double>(rim))), half);
      return hn::Sub(hn::Mul(centre, per_pixel), one);
    };
    const Doubles x = ndc(column, PixelPlanes::kRimColumns, per_column);
    const Doubles y = ndc(row, PixelPlanes::kRimRows, per_row);
    const Around depths{planes.window_depth, index};
    const Around distances{planes.inverse_distance, index};
    const Doubles z =
        hn::Add(hn::Mul(hn::Set(d, ndc_per_depth), hn::PromoteTo(d, depths(0))), hn::Set(d, ndc_offset));
    const Derivative dz1 = DepthDerivative(depths, distances, 1, tolerance, ndc_per_depth);
    const Derivative dz2 = DepthDerivative(depths, distances, planes.stride, tolerance, ndc_per_depth);

    const Doubles point_w =
        hn::Add(hn::Add(hn::Mul(w(0), x), hn::Mul(w(1), y)), hn::Add(hn::Mul(w(2), z), w(3)));
    const Doubles inverse_w = hn::Div(one, point_w);
    const Doubles3 position =
        Scaled(Plus(Plus(Scaled(xyz(0), x), Scaled(xyz(1), y)), Plus(Scaled(xyz(2), z), xyz(3))), inverse_w);
    // X = p / p.w, so dX = (dp - X dp.w) / p.w.
    const auto derivative = [&](const HomogeneousStep& step, Doubles dz) {
      const Doubles3 dp = Plus(step.xyz, Scaled(xyz(2), dz));
      const Doubles dw = hn::Add(step.w, hn::Mul(w(2), dz));
      return Scaled(Minus(dp, Scaled(position, dw)), inverse_w);
    };
    const Doubles3 dx1 = derivative(step1, dz1.value);
    const Doubles3 dx2 = derivative(step2, dz2.value);
    const Doubles3 normal = Cross(dx1, dx2);
    const Doubles length = hn::Sqrt(Dot(normal, normal));
    const Doubles known = hn::PromoteTo(d, hn::Mul(dz1.known, dz2.known));
    const auto reliable = hn::And(hn::Gt(known, zero), hn::And(hn::Gt(length, zero), hn::IsFinite(length)));
    const Doubles3 towards_viewer = Minus(eye, Scaled(position, eye_w));
    const Doubles unit = hn::Div(one, length);
    const Doubles scale = hn::IfThenElse(hn::Lt(Dot(normal, towards_viewer), zero), hn::Neg(unit), unit);
    Store(position, i, &surfaces->ws_position);
    Store(dx1, i, &surfaces->ws_dx1);
    Store(dx2, i, &surfaces->ws_dx2);
    Store(Scaled(normal, hn::IfThenElse(reliable, scale, nothing)), i, &surfaces->ws_normal);
  }
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {

HWY_EXPORT(Unproject);

void PixelSurfaces::Resize(size_t size) {
  for (LaneList<glm::dvec3>* vectors : {&ws_position, &ws_dx1, &ws_dx2, &ws_normal}) vectors->Resize(size);
}

void UnprojectPixels(const Camera& camera, const PixelPlanes& planes, const BendTolerance& tolerance,
                     const LaneList<int32_t>& indices, PixelSurfaces* surfaces) {
  surfaces->Resize(indices.size());
  HWY_DYNAMIC_DISPATCH(Unproject)(camera, planes, tolerance, indices, surfaces);
}

}  // namespace shadowfit
#endif
