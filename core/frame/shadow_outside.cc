#include "core/frame/shadow_outside.h"

#include <cstddef>
#include <vector>

#include "core/math/clip_space.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/frame/shadow_outside.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/frame/number_lanes-inl.h"
#include "core/frame/packing_lanes-inl.h"
#include "core/math/double_lanes-inl.h"

#ifndef SHADOWFIT_FRAME_SHADOW_OUTSIDE_ONCE
#define SHADOWFIT_FRAME_SHADOW_OUTSIDE_ONCE
namespace shadowfit {

/// A map as a function of a pixel's column, row and window depth, times the homogeneous w of its point.
struct MapOfPixels {
  glm::dvec3 constant;
  glm::dvec3 per_column;
  glm::dvec3 per_row;
  glm::dvec3 per_depth;
  glm::dvec2 size;
};

}  // namespace shadowfit
#endif

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

/// One row; `outside` has room for all of it from element `count` on. Returns one past the last found.
size_t FindInRow(const PixelPlanes& planes, uint32_t light_bit, int y, std::span<const MapOfPixels> maps,
                 size_t count, LaneList<int32_t>* outside) {
  const DoubleLanes d;
  const hn::Rebind<float, DoubleLanes> df;
  const hn::Rebind<int32_t, DoubleLanes> di;
  const hn::Rebind<uint32_t, DoubleLanes> du;
  const auto bit = hn::Set(du, light_bit);
  for (int x = 0; x < planes.width; x += static_cast<int>(hn::Lanes(d))) {
    const std::ptrdiff_t first = planes.Index(x, y);
    const auto in_shadow = hn::TestBit(hn::LoadU(du, planes.bits.data() + first), bit);
    if (hn::AllFalse(du, in_shadow)) continue;
    const auto distance = hn::LoadU(df, planes.inverse_distance.data() + first);
    const auto visible = hn::RebindMask(di, hn::Eq(distance, distance));
    const Doubles column = NumbersFrom(d, static_cast<double>(x));
    const Doubles depth = hn::PromoteTo(d, hn::LoadU(df, planes.window_depth.data() + first));
    hn::Mask<DoubleLanes> held = hn::FirstN(d, 0);
    for (const MapOfPixels& map : maps) {
      const auto component = [&](glm::length_t k) {
        const auto of_row = hn::Set(d, map.constant[k] + y * map.per_row[k]);
        return hn::MulAdd(depth, hn::Set(d, map.per_depth[k]),
                          hn::MulAdd(column, hn::Set(d, map.per_column[k]), of_row));
      };
      const Doubles w = component(2);
      const auto within = [&](Doubles v, double size) {
        return hn::And(hn::Ge(v, hn::Zero(d)), hn::Le(v, hn::Mul(hn::Set(d, size), w)));
      };
      held = hn::Or(held, hn::And(hn::Gt(w, hn::Zero(d)), hn::And(within(component(0), map.size.x),
                                                                  within(component(1), map.size.y))));
    }
    const auto found = hn::And(hn::And(hn::RebindMask(di, in_shadow), visible), Narrow(d, hn::Not(held)));
    if (hn::AllFalse(di, found)) continue;
    const Packing packed(di, found);
    hn::StoreU(packed(NumbersFrom(di, static_cast<int32_t>(first))), di, outside->data() + count);
    count += hn::CountTrue(di, found);
  }
  return count;
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {
namespace {

HWY_EXPORT(FindInRow);

MapOfPixels MapOf(const Camera& camera, const PixelPlanes& planes, const RaySpace& ray_space,
                  const ShadowProjection& projection) {
  const glm::dmat3 from_xyz = projection.texel_from_ray * ray_space.linear();
  const glm::dvec3 from_w = projection.texel_from_ray * ray_space.offset();
  const auto from_clip = [&](glm::length_t k) {
    const glm::dvec4& column = camera.world_from_clip()[k];
    return from_xyz * glm::dvec3(column) + from_w * column.w;
  };
  const glm::dvec3 per_column = from_clip(0) * (2.0 / planes.width);
  const glm::dvec3 per_row = from_clip(1) * (2.0 / planes.height);
  const double ndc_offset = NdcFromWindowDepth(camera.clip_depth(), 0.0);
  MapOfPixels map;
  map.per_column = per_column;
  map.per_row = per_row;
  map.per_depth = from_clip(2) * (NdcFromWindowDepth(camera.clip_depth(), 1.0) - ndc_offset);
  // Pixel centres; the first is at half a pixel from -1.
  map.constant =
      from_clip(3) + from_clip(2) * ndc_offset - from_clip(0) - from_clip(1) + 0.5 * (per_column + per_row);
  map.size = {projection.size.width, projection.size.height};
  return map;
}

}  // namespace

void FindShadowOutside(const Camera& camera, const PixelPlanes& planes, uint32_t light_bit,
                       const RaySpace& ray_space, std::span<const ShadowProjection> projections,
                       LaneList<int32_t>* outside) {
  std::vector<MapOfPixels> maps;
  maps.reserve(projections.size());
  for (const ShadowProjection& projection : projections) {
    maps.push_back(MapOf(camera, planes, ray_space, projection));
  }
  size_t count = 0;
  for (int y = 0; y < planes.height; ++y) {
    outside->Reserve(count + static_cast<size_t>(planes.width));
    count = HWY_DYNAMIC_DISPATCH(FindInRow)(planes, light_bit, y, maps, count, outside);
  }
  outside->Resize(count);
}

}  // namespace shadowfit
#endif
