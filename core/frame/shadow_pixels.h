#pragma once

#include <cstdint>
#include <span>

#include "core/frame/camera.h"
#include "core/frame/lane_list.h"
#include "core/frame/pixel_scan.h"
#include "core/math/ray_space.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

/// Lists the visible pixels with the light's bit that none of its maps holds. Vectorised with run-time
/// dispatch (Highway), in doubles.
///
/// Ray coordinates are linear in homogeneous points, and so in clip coordinates: r w = [L | o] Q^-1 (x, y, z,
/// 1), w > 0 before the viewer. Each of a map's rows is one product of four numbers a pixel, without
/// division: those that lie on the map are known by signs.
void FindShadowOutside(const Camera& camera, const PixelPlanes& planes, uint32_t light_bit,
                       const RaySpace& ray_space, std::span<const ShadowProjection> projections,
                       LaneList<int32_t>* outside);

/// Where pixels in shadow lie on a map, as shares of its width and height.
struct ShadowPlaces {
  LaneList<float> x;
  LaneList<float> y;
};

/// Of the pixels that a map holds and none of the others does: those of every kShadowRowStep-th row.
void PlaceShadow(const Camera& camera, const PixelPlanes& planes, uint32_t light_bit,
                 const RaySpace& ray_space, const ShadowProjection& projection,
                 std::span<const ShadowProjection> others, ShadowPlaces* places);

inline constexpr int kShadowRowStep = 2;

}  // namespace shadowfit
