#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/frame/camera.h"
#include "core/frame/lane_list.h"
#include "core/frame/pixel_scan.h"

namespace shadowfit {

/// Surfaces of pixels in world space, structure of arrays; derivatives are per low-resolution pixel.
struct PixelSurfaces {
  LaneList<double> ws_position[3];
  LaneList<double> ws_dx1[3];
  LaneList<double> ws_dx2[3];
  /// Towards the viewer, unit length; NaN where the derivatives do not follow the surface.
  LaneList<double> ws_normal[3];

  size_t size() const { return ws_normal[0].size(); }
  void Resize(size_t size);
};

/// Unprojects the pixels of the planes with these indices, which are visible. Vectorised with run-time
/// dispatch (Highway), in doubles.
void UnprojectPixels(const Camera& camera, const PixelPlanes& planes, const BendTolerance& tolerance,
                     const LaneList<int32_t>& indices, PixelSurfaces* surfaces);

}  // namespace shadowfit
