#include "core/fit/axis_search.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <tuple>
#include <vector>

#include "core/fit/edge_fit.h"
#include "core/fit/edge_objective.h"
#include "core/fit/quasi_newton.h"

namespace shadowfit {
namespace {

constexpr size_t kParameters = std::tuple_size_v<EdgeObjective::Parameters>;
using Point = DescentPoint<kParameters>;

bool ByValue(const Point& a, const Point& b) { return a.value < b.value; }

/// Gains of the cost's logarithm, step by step, below which a descent ends.
constexpr double kSearchTolerance = 1e-3;
constexpr double kTolerance = 2e-4;

/// A parallelogram at an axis as the start of a descent.
Point StartAt(const glm::dvec2& axis, const AffineShape& shape, const EdgeObjective& objective) {
  // First steps are a tenth of a radian and of a factor e where the cost changes by one.
  constexpr double kFirstStep = 0.1;
  Point start;
  start.at = EdgeObjective::ParametersOf(axis, shape);
  for (size_t i = 0; i < kParameters; ++i) start.inverse_hessian[i][i] = kFirstStep;
  glm::dmat2 metric = objective.AxisMetric(axis);
  // A hull that is a line or a point has no measure of its own for all directions.
  metric = glm::inverse(metric + (1e-6 * (metric[0][0] + metric[1][1]) + 1e-12) * glm::dmat2(1.0));
  for (glm::length_t i = 0; i < 2; ++i) {
    for (glm::length_t j = 0; j < 2; ++j) {
      start.inverse_hessian[static_cast<size_t>(i)][static_cast<size_t>(j)] = kFirstStep * metric[i][j];
    }
  }
  return start;
}

/// The point as another objective sees it; where that is infinite there is no way down.
Point Seen(EdgeObjective& objective, Point point) {
  point.gradient = {};
  point.value = objective.Evaluate(point.at, &point.gradient);
  return point;
}

/// Descends over the axis and the parallelogram together, from a point of this objective.
Point Descend(EdgeObjective& objective, const Point& from, int most_evaluations, double tolerance) {
  const auto evaluate = [&](const EdgeObjective::Parameters& at, EdgeObjective::Parameters* gradient) {
    return objective.Evaluate(at, gradient);
  };
  return DescendQuasiNewton(evaluate, from, most_evaluations, tolerance);
}

struct Start {
  glm::dvec2 axis;
  EdgeFit::Result result;
};

/// Axes at the hull's centroid and on rings around it, with their best parallelograms, the best axis first.
std::vector<Start> SearchRings(EdgeFit& fit, const std::vector<glm::dvec2>& hull, int directions,
                               const std::optional<glm::dvec2>& previous_axis) {
  std::vector<Start> starts;
  const auto add = [&](const glm::dvec2& axis) {
    starts.push_back({axis, fit.Evaluate(axis, EdgeFit::kCoarse)});
  };
  add(glm::dvec2(0.0));
  for (const double radius : {1.0, 2.2}) {
    for (int k = 0; k < directions; ++k) {
      const double angle = 2.0 * std::numbers::pi * (k + 0.5 * (radius > 2.0)) / directions;
      add(AxisAt(hull, radius * glm::dvec2(std::cos(angle), std::sin(angle))));
    }
  }
  if (previous_axis) add(*previous_axis);
  std::sort(starts.begin(), starts.end(),
            [](const Start& a, const Start& b) { return a.result.cost < b.result.cost; });
  return starts;
}

}  // namespace

glm::dvec2 AxisAt(const std::vector<glm::dvec2>& hull, const glm::dvec2& y) {
  const double radius = glm::length(y);
  if (!(radius > 0.0)) return glm::dvec2(0.0);
  const glm::dvec2 d = y / radius;
  double most = 1e-9;
  for (const glm::dvec2& v : hull) most = std::max(most, -glm::dot(d, v));
  const double reach = 1.0 / most;
  return d * (reach * -std::expm1(-radius));
}

AxisSearchResult SearchAxis(const WhitenedSamples& samples, MapSize size, const DefaultOptions& options,
                            const std::optional<glm::dvec2>& previous_axis) {
  const WhitenedSamples probes = Thin(samples, options.search_samples);
  EdgeFit rings(probes, size, options.free_aspect);
  std::vector<Start> starts = SearchRings(rings, samples.hull, options.search_directions, previous_axis);
  starts.resize(std::min(starts.size(), static_cast<size_t>(options.starts)));

  EdgeObjective probe_objective(probes, size, options.free_aspect);
  std::vector<Point> points;
  for (const Start& start : starts) {
    const Point at = StartAt(start.axis, start.result.shape, probe_objective);
    points.push_back(
        Descend(probe_objective, Seen(probe_objective, at), options.evaluations_per_start, kSearchTolerance));
  }
  std::sort(points.begin(), points.end(), ByValue);
  points.resize(std::min(points.size(), static_cast<size_t>(options.descents)));
  for (Point& point : points) {
    point = Descend(probe_objective, point, options.evaluations_per_descent, kSearchTolerance);
  }
  const Point& best_of_probes = *std::min_element(points.begin(), points.end(), ByValue);
  const auto matrix_at = [&](const Point& point) {
    const AffineShape shape = EdgeObjective::ShapeOf(point.at);
    return rings.TexelFromWhitened(EdgeObjective::AxisOf(point.at), shape, rings.SizeOf(shape));
  };
  // From afar every sample pulls by its whole displacement, near the end by what an edge can show of it.
  const WhitenedSamples tangent = TangentAt(samples, matrix_at(best_of_probes));
  EdgeObjective objective(tangent, size, options.free_aspect);
  const Point best =
      Descend(objective, Seen(objective, best_of_probes), options.evaluations_to_polish, kTolerance);
  EdgeObjective whole(samples, size, options.free_aspect);

  AxisSearchResult result;
  result.size = rings.SizeOf(EdgeObjective::ShapeOf(best.at));
  result.texel_from_whitened = matrix_at(best);
  result.cost = std::exp(Seen(whole, best).value);
  result.evaluations = rings.evaluations() + probe_objective.evaluations() + objective.evaluations();
  return result;
}

}  // namespace shadowfit
