#pragma once

#include <cstddef>
#include <glm/glm.hpp>
#include <limits>
#include <vector>

#include "core/frame/camera.h"
#include "core/frame/images.h"

namespace shadowfit {

/// Visible points with their tangent planes, shared by all lights of a frame.
struct SurfaceSamples {
  std::vector<glm::dvec3> ws_point;
  std::vector<glm::dvec3> ws_normal;  ///< Unit length, towards the viewer.
};

/// Samples at pixels of a depth buffer that are not background and have neighbours to tell their plane by: of
/// the two on each axis, the one nearer in depth, so that a plane does not bridge a discontinuity. Of every
/// n-th pixel of every n-th row, n being the least that keeps within `max_samples` (at least 1).
SurfaceSamples SamplesFromDepth(const Camera& camera, const DepthView& depth,
                                size_t max_samples = std::numeric_limits<size_t>::max());

}  // namespace shadowfit
