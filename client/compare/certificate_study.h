#pragma once

#include <optional>

#include "client/compare/comparison.h"
#include "core/fit/frame_optimizer.h"
#include "core/reference/view_study.h"

namespace shadowfit {

/// Bounds how far the default method's one map for the request's only light is from the best one
/// (core/fit/certify.h) of those that hold all of its shadow: the map that it is before any is let go of.
/// None where the light has several maps, or no single map holds all of its rays.
std::optional<CertificateRecord> CertifyFit(const ViewStudy& view, const LightStudy& light,
                                            const FrameRequest& request, const DefaultOptions& options,
                                            const LightSummary& fit, double tolerance, double time_limit);

}  // namespace shadowfit
