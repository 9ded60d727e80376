#pragma once

#include <glm/glm.hpp>
#include <optional>
#include <vector>

#include "core/fit/options.h"
#include "core/fit/whitened_samples.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

/// A chart of the valid axes. Those, (alpha, beta, 1), are the interior of the polar dual of the hull, a
/// convex polygon around the origin: along a direction d they reach to 1 / max(-d.v). The chart y = d (-ln(1
/// - t)), t the share of that reach, maps them onto the whole plane: no constraint is left, and a step means
/// the same factor of smallest w everywhere. This is its inverse.
glm::dvec2 AxisAt(const std::vector<glm::dvec2>& hull, const glm::dvec2& y);

/// The best map that a search found.
struct AxisSearchResult {
  glm::dmat3 texel_from_whitened{1.0};  ///< Exactly around the hull.
  MapSize size;                         ///< As asked for unless the aspect is free.
  double cost = 0.0;                    ///< The samples' sum of l y; infinite where no axis will do.
  int evaluations = 0;
};

/// Minimises the `edge` metric over all maps around the hull: axes on rings around the hull's centroid, at
/// each of them the best parallelogram of some (EdgeFit), and from the best of these descents over axis and
/// parallelogram together (EdgeObjective), the last one under the metric's tangent (TangentAt) where the
/// others ended. `previous_axis` (alpha, beta) is one more to start from.
AxisSearchResult SearchAxis(const WhitenedSamples& samples, MapSize size, const DefaultOptions& options,
                            const std::optional<glm::dvec2>& previous_axis);

}  // namespace shadowfit
