#pragma once

#include <glm/glm.hpp>
#include <vector>

#include "core/frame/camera.h"
#include "core/frame/images.h"

namespace shadowfit {

/// Visible points with their tangent planes, shared by all lights of a frame.
struct SurfaceSamples {
  std::vector<glm::dvec3> ws_point;
  std::vector<glm::dvec3> ws_normal;  ///< Unit length, towards the viewer.
};

/// One sample for every pixel of a depth buffer that is not background and has neighbours to tell its plane
/// by: of the two on each axis, the one nearer in depth, so that a plane does not bridge a discontinuity.
SurfaceSamples SamplesFromDepth(const Camera& camera, const DepthView& depth);

}  // namespace shadowfit
