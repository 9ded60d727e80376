#pragma once

#include <cstddef>
#include <cstdint>

#include "core/frame/active_pixels.h"
#include "core/frame/lane_list.h"
#include "core/frame/pixel_surfaces.h"
#include "core/math/ray_space.h"

namespace shadowfit {

struct EdgeCrossings {
  LaneList<double> crossings;  ///< A pixel; 0 for most.
  size_t pixels = 0;           ///< With crossings.
};

/// What one light makes of a frame's active pixels: those that its map must hold, and how much of a shadow's
/// edge each of them shows. Vectorised with run-time dispatch (Highway).
struct LightPixels {
  /// Active pixels that the light asks for, and what it asks them for.
  LaneList<int32_t> concerned;
  LaneList<int32_t> marks;
  /// By active pixel, of those concerned: between its normal and its direction to the light. Below -1 outside
  /// a spot's cone, NaN where the normal is not known.
  LaneList<double> cosine;

  /// Of `concerned`, in that order: those that the map must hold.
  LaneList<int32_t> hull;
  LaneList<int32_t> hull_marks;

  LaneList<double> tail;  ///< Of `hull`: BoundarySamples::tail of an edge.
  /// Of `hull`: neighbours across an edge of the light's shadow.
  EdgeCrossings edges;
  /// Neighbours across what may be one, times the edges that there are for each of them on average.
  EdgeCrossings rough_edges;
  /// Where neither is: edges that do not show, in the same measure.
  EdgeCrossings unseen_edges;
};

/// Fills `pixels` with the light's part of a shadow's boundary, rim and inside.
void FindLightPixels(const ActivePixels& active, const PixelSurfaces& surfaces, std::ptrdiff_t stride,
                     const RaySpace& ray_space, uint32_t light_bit, LightPixels* pixels);

/// Fills `pixels` with all that the light may shine on, without crossings, and `lit` with the places in
/// `pixels->hull` of those that it surely does.
void FindLitPixels(const PixelSurfaces& surfaces, const RaySpace& ray_space, LightPixels* pixels,
                   LaneList<int32_t>* lit);

}  // namespace shadowfit
