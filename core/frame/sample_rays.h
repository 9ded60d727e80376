#pragma once

#include <cstdint>
#include <glm/glm.hpp>

#include "core/frame/edge_pattern.h"
#include "core/frame/lane_list.h"
#include "core/frame/light_pixels.h"
#include "core/frame/light_samples.h"
#include "core/frame/pixel_surfaces.h"
#include "core/math/ray_space.h"

namespace shadowfit {

/// Places of the samples that stand for textures.
struct SampledTextures {
  LaneList<int32_t> boundary;
  LaneList<int32_t> rough_boundary;
  LaneList<int32_t> unseen_boundary;  ///< All: what is not seen has no direction.
};

/// Fills a light's samples with what its pixels become in its ray coordinates, but for their source.
/// `patterns` are those of `pixels.hull`, needed where these have crossings; `scale` is final-screen pixels
/// per sample, and `directions` are made for it. Those of `textures` are still to be turned. Vectorised with
/// run-time dispatch (Highway).
void FillSamples(const PixelSurfaces& surfaces, const LightPixels& pixels,
                 const LaneList<EdgePattern>& patterns, const EdgeDirections& directions,
                 const glm::dvec2& scale, const RaySpace& ray_space, SampledTextures* textures,
                 LightSamples* samples);

}  // namespace shadowfit
