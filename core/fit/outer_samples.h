#pragma once

#include <cstdint>
#include <vector>

#include "core/frame/light_samples.h"
#include "core/math/ray_space.h"

namespace shadowfit {

/// Indices of the hull samples that may be, or whose footprints may reach (`with_footprints`), a vertex of
/// the samples' hull, in rising order. The others lie within an octagon of samples: most of a dense set are
/// found in one vectorised pass (Akl and Toussaint's filter, on rays). All samples where they do not fit into
/// a half space around their mean.
std::vector<int32_t> OuterSamples(const LightSamples& samples, const RaySpace& ray_space,
                                  bool with_footprints);

}  // namespace shadowfit
