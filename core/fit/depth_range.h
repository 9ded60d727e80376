#pragma once

#include <glm/glm.hpp>
#include <span>

#include "core/frame/light_samples.h"
#include "core/math/ray_space.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

/// Depth range of a map: near at the nearest hull sample that it holds (casters before it are clamped), far
/// beyond every visible point, so that lit surfaces behind the shadows still compare as lit against a cleared
/// texel. `ws_visible_corners` are those of the part of the view frustum that holds visible surfaces.
DepthRange FitDepthRange(const RaySpace& ray_space, const ShadowProjection& projection,
                         const LightSamples& samples, std::span<const glm::dvec3> ws_visible_corners);

}  // namespace shadowfit
