#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <span>
#include <vector>

#include "absl/functional/function_ref.h"
#include "core/frame/light_samples.h"

namespace shadowfit {

/// The samples whose dot(covector, r) is not positive, and those where it is.
std::vector<LightSamples> DivideByPlane(const LightSamples& samples, const glm::dvec3& covector);

/// The samples in each face of a cube around the light.
std::vector<LightSamples> DivideByCubeFaces(const LightSamples& samples);

/// Of every stride-th boundary sample, with stride times its length, those whose ray is chosen; and the hull
/// samples that are marked by a number other than 0.
LightSamples SomeSamples(const LightSamples& samples, size_t stride,
                         absl::FunctionRef<bool(const glm::dvec3&)> chosen,
                         std::span<const uint8_t> hull_samples);

}  // namespace shadowfit
