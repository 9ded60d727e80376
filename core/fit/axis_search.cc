#include "core/fit/axis_search.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace shadowfit {
namespace {

constexpr size_t kParameters = std::tuple_size_v<EdgeObjective::Parameters>;
using Point = DescentPoint<kParameters>;

bool ByValue(const Point& a, const Point& b) { return a.value < b.value; }

/// Gains of the cost's logarithm, step by step, below which a descent ends.
constexpr double kSearchTolerance = 1e-3;
constexpr double kTolerance = 2e-4;

/// An axis gets a descent where its coarse search ends within this factor of what is to be beaten. Of 530
/// lights (plaza, Sterngarten and hall, four views each) the best axis begins within 1.05 of its descent's
/// end in the median and within 1.22 in 95 of a hundred.
constexpr double kWorthADescent = 1.2;

/// Its coarse search is refined where the first step ends within this factor of that.
constexpr double kWorthRefining = 1.25;

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

/// Descends over the axis and the parallelogram together, from a point of this objective.
Point DescendFrom(EdgeObjective& objective, const Point& from, int most_evaluations, double tolerance) {
  const auto evaluate = [&](const EdgeObjective::Parameters& at, EdgeObjective::Parameters* gradient) {
    return objective.Evaluate(at, gradient);
  };
  return DescendQuasiNewton(evaluate, from, most_evaluations, tolerance);
}

/// The same where value and gradient are another objective's, or not known; where the point is not allowed
/// there is no way down.
Point DescendAnew(EdgeObjective& objective, Point from, int most_evaluations, double tolerance) {
  from.gradient = {};
  from.value = objective.Evaluate(from.at, &from.gradient);
  return DescendFrom(objective, from, most_evaluations, tolerance);
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

AxisSearch::AxisSearch(const WhitenedSamples& probes, MapSize size, const DefaultOptions& options)
    : probes_(probes),
      size_(size),
      options_(options),
      rings_(probes, size, options.free_aspect),
      objective_(probes, size, options.free_aspect) {}

double AxisSearch::Survey(const std::optional<glm::dvec2>& previous_axis, double to_beat) {
  struct Start {
    glm::dvec2 axis;
    EdgeFit::Result result;
  };
  std::vector<Start> starts;
  const double worth = kWorthADescent * to_beat;
  const auto add = [&](const glm::dvec2& axis) {
    starts.push_back({axis, rings_.Evaluate(axis, EdgeFit::kCoarse, kWorthRefining * worth)});
  };
  add(glm::dvec2(0.0));
  for (const double radius : {1.0, 2.2}) {
    for (int k = 0; k < options_.search_directions; ++k) {
      const double angle = 2.0 * std::numbers::pi * (k + 0.5 * (radius > 2.0)) / options_.search_directions;
      add(AxisAt(probes_.hull, radius * glm::dvec2(std::cos(angle), std::sin(angle))));
    }
  }
  if (previous_axis) add(*previous_axis);
  std::sort(starts.begin(), starts.end(),
            [](const Start& a, const Start& b) { return a.result.cost < b.result.cost; });
  starts.resize(std::min(starts.size(), static_cast<size_t>(options_.starts)));
  // The best one always: some lights' axes all begin badly.
  while (starts.size() > 1 && starts.back().result.cost > worth) starts.pop_back();
  for (const Start& start : starts) {
    points_.push_back(DescendAnew(objective_, StartAt(start.axis, start.result.shape, objective_),
                                  options_.evaluations_per_start, kSearchTolerance));
  }
  std::sort(points_.begin(), points_.end(), ByValue);
  return std::exp(points_[0].value);
}

AxisSearchResult AxisSearch::Descend(const WhitenedSamples& samples) {
  points_.resize(std::min(points_.size(), static_cast<size_t>(options_.descents)));
  for (Point& point : points_) {
    point = DescendFrom(objective_, point, options_.evaluations_per_descent, kSearchTolerance);
  }
  return Polish(samples, *std::min_element(points_.begin(), points_.end(), ByValue));
}

AxisSearchResult AxisSearch::DescendFromMap(const ShadowProjection& map) {
  const std::optional<TexelGrid> grid = GridOf(map.texel_from_ray * glm::inverse(probes_.whitened_from_ray));
  if (!grid) return {};
  const double stretch = options_.free_aspect ? double(map.size.width) / size_.width : 1.0;
  const AffineShape shape{glm::normalize(grid->step1), glm::normalize(grid->step2), stretch};
  return Polish(probes_, StartAt(grid->axis, shape, objective_));
}

AxisSearchResult AxisSearch::Polish(const WhitenedSamples& samples, const Point& from) {
  const auto matrix_at = [&](const Point& point) {
    const AffineShape shape = EdgeObjective::ShapeOf(point.at);
    return rings_.TexelFromWhitened(EdgeObjective::AxisOf(point.at), shape, rings_.SizeOf(shape));
  };
  // From afar every sample pulls by its whole displacement, near the end by what an edge can show of it.
  const WhitenedSamples tangent = TangentAt(samples, *GridOf(matrix_at(from)));
  EdgeObjective objective(tangent, size_, options_.free_aspect);
  const Point best = DescendAnew(objective, from, options_.evaluations_to_polish, kTolerance);
  polish_evaluations_ = objective.evaluations();

  AxisSearchResult result;
  result.size = rings_.SizeOf(EdgeObjective::ShapeOf(best.at));
  result.texel_from_whitened = matrix_at(best);
  EdgeObjective::Parameters slopes;
  result.cost = std::exp(EdgeObjective(samples, size_, options_.free_aspect).Evaluate(best.at, &slopes));
  return result;
}

}  // namespace shadowfit
