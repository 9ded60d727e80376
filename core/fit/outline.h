#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <optional>
#include <vector>

#include "core/frame/light_samples.h"

namespace shadowfit {

/// The corners of a polygon inside the hull of a light's samples in shadow (of all, where none is): in each
/// of kOutlineDirections directions of a map's plane, evenly spaced from map x on, the sample that lies
/// farthest, in that order. Along those directions it is as wide as the hull, between them a little narrower.
/// None where the map's axis does not see all of the samples, or there are too few to be worth the question.
/// One vectorised pass.
std::optional<std::vector<int32_t>> OutlineOf(const LightSamples& samples, const glm::dmat3& texel_from_ray);

inline constexpr int kOutlineDirections = 16;

}  // namespace shadowfit
