#include "core/frame/shadow_pixels.h"

#include <algorithm>
#include <cstddef>
#include <vector>

#include "core/math/clip_space.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/frame/shadow_pixels.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/frame/number_lanes-inl.h"
#include "core/frame/packing_lanes-inl.h"
#include "core/math/double_lanes-inl.h"

#ifndef SHADOWFIT_FRAME_SHADOW_PIXELS_ONCE
#define SHADOWFIT_FRAME_SHADOW_PIXELS_ONCE
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

using Indices = hn::Rebind<int32_t, DoubleLanes>;

/// Some pixels of a row.
struct Pixels {
  int row;
  std::ptrdiff_t first;  ///< PixelPlanes::Index of the first.
  Doubles column;
  Doubles depth;
  hn::Mask<Indices> in_shadow;  ///< And visible.

  /// Texel coordinates and w, all times the point's own w.
  HWY_INLINE Doubles3 On(const MapOfPixels& map) const {
    const DoubleLanes d;
    const auto component = [&](glm::length_t k) {
      const auto of_row = hn::Set(d, map.constant[k] + row * map.per_row[k]);
      return hn::MulAdd(depth, hn::Set(d, map.per_depth[k]),
                        hn::MulAdd(column, hn::Set(d, map.per_column[k]), of_row));
    };
    return {component(0), component(1), component(2)};
  }
};

HWY_INLINE hn::Mask<DoubleLanes> IsOnMap(const Doubles3& p, const MapOfPixels& map) {
  const DoubleLanes d;
  const auto within = [&](Doubles v, double size) {
    return hn::And(hn::Ge(v, hn::Zero(d)), hn::Le(v, hn::Mul(hn::Set(d, size), p.z)));
  };
  return hn::And(hn::Gt(p.z, hn::Zero(d)), hn::And(within(p.x, map.size.x), within(p.y, map.size.y)));
}

HWY_INLINE hn::Mask<DoubleLanes> IsOnAny(const Pixels& pixels, std::span<const MapOfPixels> maps) {
  hn::Mask<DoubleLanes> held = hn::FirstN(DoubleLanes(), 0);
  for (const MapOfPixels& map : maps) held = hn::Or(held, IsOnMap(pixels.On(map), map));
  return held;
}

/// Calls visit(pixels) for a row's pixels, where some of them are in shadow.
template <class Visit>
HWY_INLINE void ForShadowInRow(const PixelPlanes& planes, uint32_t light_bit, int row, const Visit& visit) {
  const DoubleLanes d;
  const hn::Rebind<float, DoubleLanes> df;
  const hn::Rebind<uint32_t, DoubleLanes> du;
  // Most vectors of most lights' rows have no shadow: they are passed by as many at a time as there are.
  const hn::CappedTag<uint32_t, kMostLanes> wide;
  const int step = static_cast<int>(std::max(hn::Lanes(wide), hn::Lanes(d)));
  const auto bit = hn::Set(du, light_bit);
  for (int x = 0; x < planes.width; x += static_cast<int>(hn::Lanes(d))) {
    const std::ptrdiff_t first = planes.Index(x, row);
    if (x % step == 0 && hn::AllFalse(wide, hn::TestBit(hn::LoadU(wide, planes.bits.data() + first),
                                                        hn::Set(wide, light_bit)))) {
      x += step - static_cast<int>(hn::Lanes(d));
      continue;
    }
    const auto has_bit = hn::TestBit(hn::LoadU(du, planes.bits.data() + first), bit);
    if (hn::AllFalse(du, has_bit)) continue;
    const auto distance = hn::LoadU(df, planes.inverse_distance.data() + first);
    const auto visible = hn::RebindMask(Indices(), hn::Eq(distance, distance));
    visit(Pixels{row, first, NumbersFrom(d, static_cast<double>(x)),
                 hn::PromoteTo(d, hn::LoadU(df, planes.window_depth.data() + first)),
                 hn::And(hn::RebindMask(Indices(), has_bit), visible)});
  }
}

/// `outside` has room for a row from element `count` on. Returns one past the last found.
size_t FindInRow(const PixelPlanes& planes, uint32_t light_bit, int row, std::span<const MapOfPixels> maps,
                 size_t count, LaneList<int32_t>* outside) {
  const DoubleLanes d;
  const Indices di;
  ForShadowInRow(planes, light_bit, row, [&](const Pixels& pixels) {
    const auto found = hn::And(pixels.in_shadow, Narrow(d, hn::Not(IsOnAny(pixels, maps))));
    if (hn::AllFalse(di, found)) return;
    const auto indices = NumbersFrom(di, static_cast<int32_t>(pixels.first));
    hn::StoreU(Packing(di, found)(indices), di, outside->data() + count);
    count += hn::CountTrue(di, found);
  });
  return count;
}

/// The same of `x` and `y`; `others` are maps that have what they hold.
size_t PlaceRow(const PixelPlanes& planes, uint32_t light_bit, int row, const MapOfPixels& map,
                std::span<const MapOfPixels> others, size_t count, LaneList<float>* x, LaneList<float>* y) {
  const DoubleLanes d;
  const hn::Rebind<float, DoubleLanes> df;
  ForShadowInRow(planes, light_bit, row, [&](const Pixels& pixels) {
    const Doubles3 p = pixels.On(map);
    const auto has = hn::AndNot(IsOnAny(pixels, others), IsOnMap(p, map));
    const auto found = hn::RebindMask(df, hn::And(pixels.in_shadow, Narrow(d, has)));
    const Packing packed(df, found);
    const auto store = [&](Doubles v, double size, LaneList<float>* to) {
      hn::StoreU(packed(hn::DemoteTo(df, hn::Div(v, hn::Mul(p.z, hn::Set(d, size))))), df,
                 to->data() + count);
    };
    store(p.x, map.size.x, x);
    store(p.y, map.size.y, y);
    count += hn::CountTrue(df, found);
  });
  return count;
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {
namespace {

HWY_EXPORT(FindInRow);
HWY_EXPORT(PlaceRow);

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

std::vector<MapOfPixels> MapsOf(const Camera& camera, const PixelPlanes& planes, const RaySpace& ray_space,
                                std::span<const ShadowProjection> projections) {
  std::vector<MapOfPixels> maps;
  maps.reserve(projections.size());
  for (const ShadowProjection& projection : projections) {
    maps.push_back(MapOf(camera, planes, ray_space, projection));
  }
  return maps;
}

}  // namespace

void FindShadowOutside(const Camera& camera, const PixelPlanes& planes, uint32_t light_bit,
                       const RaySpace& ray_space, std::span<const ShadowProjection> projections,
                       LaneList<int32_t>* outside) {
  const std::vector<MapOfPixels> maps = MapsOf(camera, planes, ray_space, projections);
  size_t count = 0;
  for (int y = 0; y < planes.height; ++y) {
    outside->Reserve(count + static_cast<size_t>(planes.width));
    count = HWY_DYNAMIC_DISPATCH(FindInRow)(planes, light_bit, y, maps, count, outside);
  }
  outside->Resize(count);
}

void PlaceShadow(const Camera& camera, const PixelPlanes& planes, uint32_t light_bit,
                 const RaySpace& ray_space, const ShadowProjection& projection,
                 std::span<const ShadowProjection> others, ShadowPlaces* places) {
  const MapOfPixels map = MapOf(camera, planes, ray_space, projection);
  const std::vector<MapOfPixels> other_maps = MapsOf(camera, planes, ray_space, others);
  size_t count = 0;
  for (int y = kShadowRowStep / 2; y < planes.height; y += kShadowRowStep) {
    for (LaneList<float>* places_along : {&places->x, &places->y}) {
      places_along->Reserve(count + static_cast<size_t>(planes.width));
    }
    count =
        HWY_DYNAMIC_DISPATCH(PlaceRow)(planes, light_bit, y, map, other_maps, count, &places->x, &places->y);
  }
  places->x.Resize(count);
  places->y.Resize(count);
}

}  // namespace shadowfit
#endif
