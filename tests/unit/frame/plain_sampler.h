#pragma once

#include <optional>
#include <span>
#include <vector>

#include "core/frame/camera.h"
#include "core/frame/images.h"
#include "core/frame/light_samples.h"
#include "core/math/ray_space.h"
#include "core/math/shadow_projection.h"

namespace shadowfit::testing {

/// What FrameSampler is to find, one pixel and one light after the other, as its definitions read.
std::vector<LightSamples> SamplePlainly(const Camera& camera, const DepthView& depth,
                                        const std::optional<BitsView>& bits,
                                        std::span<const RaySpace> ray_spaces, MapSize screen);

}  // namespace shadowfit::testing
