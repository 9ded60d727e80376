#pragma once

#include <glm/glm.hpp>
#include <vector>

#include "core/frame/light_samples.h"

namespace shadowfit {

/// The samples whose dot(covector, r) is not positive, and those where it is.
std::vector<LightSamples> DivideByPlane(const LightSamples& samples, const glm::dvec3& covector);

/// The samples in each face of a cube around the light.
std::vector<LightSamples> DivideByCubeFaces(const LightSamples& samples);

}  // namespace shadowfit
