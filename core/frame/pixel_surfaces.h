#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>

#include "core/frame/camera.h"
#include "core/frame/lane_list.h"
#include "core/frame/pixel_scan.h"

namespace shadowfit {

/// Surfaces of pixels in world space; derivatives are per low-resolution pixel. Lights pick pixels here and
/// there: what belongs together lies together.
struct PixelSurfaces {
  LaneList<glm::dvec3> ws_position;
  LaneList<glm::dvec3> ws_dx1;
  LaneList<glm::dvec3> ws_dx2;
  /// Towards the viewer, unit length; NaN where the derivatives do not follow the surface.
  LaneList<glm::dvec3> ws_normal;

  size_t size() const { return ws_normal.size(); }
  void Resize(size_t size);
};

/// Unprojects the visible pixels of the planes with these indices, padded with that of any. Vectorised with
/// run-time dispatch (Highway), in doubles.
void UnprojectPixels(const Camera& camera, const PixelPlanes& planes, const BendTolerance& tolerance,
                     const LaneList<int32_t>& indices, PixelSurfaces* surfaces);

}  // namespace shadowfit
