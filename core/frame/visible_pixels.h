#pragma once

#include <cstddef>
#include <cstdint>

#include "core/frame/active_pixels.h"
#include "core/frame/lane_list.h"
#include "core/frame/pixel_scan.h"

namespace shadowfit {

/// Pixels that stand in for shadow boundaries where there are none.
struct VisiblePixels {
  LaneList<int32_t> index;  ///< PixelPlanes::Index.

  /// Of one row at a time, while the list is made: all that are visible, and those at a rim.
  LaneList<int32_t> row, row_rim;
};

/// Lists the active pixels; then, row by row, every stride-th visible pixel, and those at the rim of a
/// surface or of the screen, which make the hull. Vectorised with run-time dispatch (Highway).
void ListVisiblePixels(const PixelPlanes& planes, const ActivePixels& active, size_t stride,
                       VisiblePixels* pixels);

}  // namespace shadowfit
