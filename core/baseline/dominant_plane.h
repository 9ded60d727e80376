#pragma once

#include <glm/glm.hpp>
#include <optional>
#include <span>

namespace shadowfit {

/// A point of a receiver.
struct PlaneSample {
  glm::dvec3 ws_position;
  double weight = 1.0;     ///< Positive.
  double tolerance = 0.0;  ///< Distance up to which the point counts as on the plane; positive.
};

/// The plane (n, c), n.X + c = 0 with |n| = 1, on which the most weight lies: random triples of samples are
/// tried (P. H. S. Torr, A. Zisserman, "MLESAC", 2000: residuals count squared and capped at the tolerance),
/// and the best is refined by weighted least squares over the samples it holds. None where the samples are
/// fewer than three or lie on a line. Deterministic; the sign of (n, c) is arbitrary.
std::optional<glm::dvec4> DominantPlane(std::span<const PlaneSample> samples);

}  // namespace shadowfit
