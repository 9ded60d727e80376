#pragma once

#include <cstdint>
#include <vector>

#include "core/frame/light_samples.h"
#include "core/math/ray_space.h"

namespace shadowfit {

/// What of a light's hull samples a map is to hold.
enum class HullOf {
  kSamples,  ///< All of them, their centres: TR-07-07's used samples.
  kShadow,   ///< The footprints of those in shadow; of all where none is.
};

/// Whether any hull sample is known to be in shadow; where none is, all count as such.
bool AnyInShadow(const LightSamples& samples);

/// Those that HullOf asks for, in rising order.
std::vector<int32_t> HullSamples(const LightSamples& samples, HullOf hull_of);

/// Those of them that may be, or whose footprints may reach, a vertex of their hull. The others lie within a
/// polygon of samples: most of a dense set are found in one vectorised pass over an octagon's sides (Akl and
/// Toussaint's filter, on rays), most of the rest in one over their own hull's. All where they do not fit
/// into a half space around their mean.
std::vector<int32_t> OuterSamples(const LightSamples& samples, const RaySpace& ray_space, HullOf hull_of);

}  // namespace shadowfit
