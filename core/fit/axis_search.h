#pragma once

#include <glm/glm.hpp>
#include <optional>

#include "core/fit/options.h"
#include "core/fit/whitened_samples.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

/// The best map that a search found.
struct AxisSearchResult {
  glm::dmat3 texel_from_whitened{1.0};  ///< Exactly around the hull.
  MapSize size;                         ///< As asked for unless the aspect is free.
  double cost = 0.0;                    ///< Expected misclassified pixels; infinite where no axis will do.
  int evaluations = 0;
};

/// Minimises the `edge` metric over all maps around the hull: axes on rings around the hull's centroid, at
/// each of them the best parallelogram of some (EdgeFit), and from the best of these descents over axis and
/// parallelogram together (EdgeObjective). `previous_axis` (alpha, beta) is one more to start from.
AxisSearchResult SearchAxis(const WhitenedSamples& samples, MapSize size, const DefaultOptions& options,
                            const std::optional<glm::dvec2>& previous_axis);

}  // namespace shadowfit
