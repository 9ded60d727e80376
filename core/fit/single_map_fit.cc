#include "core/fit/single_map_fit.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "core/fit/axis_search.h"
#include "core/fit/ray_hull.h"
#include "core/fit/rescale_previous.h"
#include "core/fit/whitened_samples.h"

namespace shadowfit {
namespace {

/// Half angle in radians (80 degrees) of the widest cone that a single map is of use for: at the rim of a map
/// straight along its axis, texels are 33 times as wide as in its middle.
constexpr double kWidestHalfAngle = 1.3962634015954636;

}  // namespace

SingleMapFit FitSingleMap(const LightProblem& problem, const DefaultOptions& options) {
  const RayHull hull = MakeFitHull(problem);
  const WhitenedSamples samples = Whiten(problem, hull);
  std::optional<glm::dvec2> previous_axis;
  if (problem.previous != nullptr) {
    // A row vector h of ray space is h T^-1 in whitened coordinates.
    const glm::dvec3 axis =
        glm::transpose(glm::inverse(samples.whitened_from_ray)) * problem.previous->Axis();
    if (axis.z > 0.0) previous_axis = glm::dvec2(axis) / axis.z;
  }
  const AxisSearchResult found = SearchAxis(samples, problem.map_size, options, previous_axis);

  SingleMapFit fit;
  fit.complete = hull.complete;
  // Sums of costs stay finite.
  constexpr double kMostCost = 1e60;
  fit.usable = fit.complete && found.cost < kMostCost && hull.cos_half_angle > std::cos(kWidestHalfAngle);
  fit.cost = std::min(found.cost, kMostCost);
  for (const BoundarySamples* boundary : {&problem.samples->boundary, &problem.samples->rough_boundary}) {
    for (const double length : boundary->length) fit.edge_length += length;
  }
  fit.evaluations = found.evaluations;
  fit.projection.size = found.size;
  fit.projection.texel_from_ray = WithUnitAxis(found.texel_from_whitened * samples.whitened_from_ray);
  return fit;
}

}  // namespace shadowfit
