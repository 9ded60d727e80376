#include "core/fit/single_map_fit.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <tuple>
#include <utility>
#include <vector>

#include "core/fit/edge_fit.h"
#include "core/fit/edge_objective.h"
#include "core/fit/quasi_newton.h"
#include "core/fit/ray_hull.h"
#include "core/fit/rescale_previous.h"
#include "core/fit/whitened_samples.h"

namespace shadowfit {
namespace {

/// The dual cone without its rim. Valid axes (alpha, beta, 1) are the interior of the hull's polar dual, a
/// convex polygon around the origin: along a direction d they reach to 1 / max(-d.v). The chart y = d (-ln(1
/// - t)), t the share of that reach, maps it onto the whole plane: rings around the
/// origin are even choices, and a step means the same factor of smallest w everywhere.
class AxisChart {
 public:
  explicit AxisChart(const std::vector<glm::dvec2>& hull) : hull_(hull) {}

  glm::dvec2 AxisAt(const glm::dvec2& y) const {
    const double radius = glm::length(y);
    if (!(radius > 0.0)) return glm::dvec2(0.0);
    const glm::dvec2 d = y / radius;
    return d * (Reach(d) * -std::expm1(-radius));
  }

 private:
  double Reach(const glm::dvec2& d) const {
    double most = 1e-9;
    for (const glm::dvec2& v : hull_) most = std::max(most, -glm::dot(d, v));
    return 1.0 / most;
  }
  const std::vector<glm::dvec2>& hull_;
};

/// Half angle in radians (80 degrees) of the widest cone that a single map is of use for: at the rim of a map
/// straight along its axis, texels are 33 times as wide as in its middle.
constexpr double kWidestHalfAngle = 1.3962634015954636;

constexpr size_t kParameters = std::tuple_size_v<EdgeObjective::Parameters>;
using Point = DescentPoint<kParameters>;

/// A parallelogram at an axis as the start of a descent.
Point StartAt(const glm::dvec2& axis, const AffineShape& shape, const EdgeObjective& objective) {
  // First steps are a tenth of a radian and of a factor e where the cost changes by one.
  constexpr double kFirstStep = 0.1;
  Point start;
  start.at = EdgeObjective::ParametersOf(axis, shape);
  for (size_t i = 0; i < kParameters; ++i) start.inverse_hessian[i][i] = kFirstStep;
  glm::dmat2 metric = objective.AxisMetric(axis);
  metric = glm::inverse(metric + 1e-6 * (metric[0][0] + metric[1][1]) * glm::dmat2(1.0));
  for (glm::length_t i = 0; i < 2; ++i) {
    for (glm::length_t j = 0; j < 2; ++j) {
      start.inverse_hessian[static_cast<size_t>(i)][static_cast<size_t>(j)] = kFirstStep * metric[i][j];
    }
  }
  return start;
}

/// Descends over the axis and the parallelogram together.
Point Descend(EdgeObjective& objective, Point start, int most_evaluations, double tolerance) {
  start.value = objective.Evaluate(start.at, &start.gradient);
  if (!std::isfinite(start.value)) return start;
  const auto evaluate = [&](const EdgeObjective::Parameters& at, EdgeObjective::Parameters* gradient) {
    return objective.Evaluate(at, gradient);
  };
  return DescendQuasiNewton(evaluate, start, most_evaluations, tolerance);
}

}  // namespace

SingleMapFit FitSingleMap(const LightProblem& problem, const DefaultOptions& options) {
  RayHull hull = MakeRayHull(problem, /*with_footprints=*/true);
  if (!hull.complete) {
    RayHull tight = MakeRayHull(problem, /*with_footprints=*/false);
    if (tight.complete) hull = std::move(tight);
  }
  const WhitenedSamples samples = Whiten(problem, hull);
  const WhitenedSamples probes = Thin(samples, options.search_samples);
  const AxisChart chart(samples.hull);
  EdgeFit search(probes, problem.map_size, options.free_aspect);

  // A ring search over the chart, then descents from the best of it.
  struct Start {
    glm::dvec2 axis;
    EdgeFit::Result result;
  };
  std::vector<Start> starts;
  const auto add = [&](const glm::dvec2& axis) {
    starts.push_back({axis, search.Evaluate(axis, EdgeFit::kCoarse)});
  };
  add(glm::dvec2(0.0));
  for (const double radius : {1.0, 2.2}) {
    for (int k = 0; k < options.search_directions; ++k) {
      const double angle = 2.0 * std::numbers::pi * (k + 0.5 * (radius > 2.0)) / options.search_directions;
      add(chart.AxisAt(radius * glm::dvec2(std::cos(angle), std::sin(angle))));
    }
  }
  if (problem.previous != nullptr) {
    // A row vector h of ray space is h T^-1 in whitened coordinates.
    const glm::dvec3 axis =
        glm::transpose(glm::inverse(samples.whitened_from_ray)) * problem.previous->Axis();
    if (axis.z > 0.0) add(glm::dvec2(axis) / axis.z);
  }
  std::sort(starts.begin(), starts.end(),
            [](const Start& a, const Start& b) { return a.result.cost < b.result.cost; });
  EdgeObjective probe_objective(probes, problem.map_size, options.free_aspect);
  EdgeObjective objective(samples, problem.map_size, options.free_aspect);
  Point best;
  const size_t descents = std::min(starts.size(), static_cast<size_t>(options.descents));
  for (size_t i = 0; i < descents; ++i) {
    const Point start = StartAt(starts[i].axis, starts[i].result.shape, probe_objective);
    const Point found = Descend(probe_objective, start, options.evaluations_per_descent, 1e-3);
    if (i == 0 || found.value < best.value) best = found;
  }
  best = Descend(objective, best, options.evaluations_to_polish, 2e-4);
  const glm::dvec2 axis = EdgeObjective::AxisOf(best.at);
  const AffineShape shape = EdgeObjective::ShapeOf(best.at);

  SingleMapFit fit;
  fit.complete = hull.complete;
  const double cost = std::exp(best.value);
  // Sums of costs stay finite.
  constexpr double kMostCost = 1e60;
  fit.usable = fit.complete && cost < kMostCost && hull.cos_half_angle > std::cos(kWidestHalfAngle);
  fit.cost = std::min(cost, kMostCost);
  for (const BoundarySamples* boundary : {&problem.samples->boundary, &problem.samples->rough_boundary}) {
    for (const double length : boundary->length) fit.edge_length += length;
  }
  fit.evaluations = search.evaluations() + probe_objective.evaluations() + objective.evaluations();
  fit.projection.size = search.SizeOf(shape);
  fit.projection.texel_from_ray =
      WithUnitAxis(search.TexelFromWhitened(axis, shape, fit.projection.size) * samples.whitened_from_ray);
  return fit;
}

}  // namespace shadowfit
