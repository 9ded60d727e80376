#pragma once

#include <glm/glm.hpp>
#include <limits>
#include <optional>
#include <tuple>
#include <vector>

#include "core/fit/edge_fit.h"
#include "core/fit/edge_objective.h"
#include "core/fit/options.h"
#include "core/fit/quasi_newton.h"
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
  /// The samples' sum of l y; infinite where no axis will do.
  double cost = std::numeric_limits<double>::infinity();
};

/// Minimises what a map displaces edges by, over all maps around the hull, in two halves: a survey that finds
/// the valleys, and the descent into them. Both look at some of the samples, the probes; the last steps at
/// all, and at the metric's tangent (TangentAt) where the others ended.
class AxisSearch {
 public:
  /// Borrows all of them.
  AxisSearch(const WhitenedSamples& probes, MapSize size, const DefaultOptions& options);

  /// The cost over the probes of any map of `size`, tight around the hull or not.
  double CostOf(const TexelGrid& grid) { return objective_.CostOf(grid); }

  /// Axes at the hull's centroid, on rings around it and at `previous_axis` (alpha, beta), at each of them
  /// the best parallelogram of some (EdgeFit), and short descents over axis and parallelogram together
  /// (EdgeObjective) from the best one and from others of the best that might end below `to_beat`. Returns
  /// the least cost found, which the descent will lower by some per cent at most.
  double Survey(const std::optional<glm::dvec2>& previous_axis, double to_beat);

  /// Descends from the best of a survey, at last over all `samples`, which the probes are some of.
  AxisSearchResult Descend(const WhitenedSamples& samples);

  /// Descends from a map that is known to be near the best, over all samples, which then are the probes.
  AxisSearchResult DescendFromMap(const ShadowProjection& map);

  int evaluations() const { return rings_.evaluations() + objective_.evaluations() + polish_evaluations_; }

 private:
  using Point = DescentPoint<std::tuple_size_v<EdgeObjective::Parameters>>;

  AxisSearchResult Polish(const WhitenedSamples& samples, const Point& from);

  const WhitenedSamples& probes_;
  const MapSize size_;
  const DefaultOptions& options_;
  EdgeFit rings_;
  EdgeObjective objective_;
  std::vector<Point> points_;
  int polish_evaluations_ = 0;
};

}  // namespace shadowfit
