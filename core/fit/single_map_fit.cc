#include "core/fit/single_map_fit.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>
#include <vector>

#include "core/fit/edge_fit.h"
#include "core/fit/metric.h"
#include "core/fit/ray_hull.h"
#include "core/fit/rescale_previous.h"
#include "core/fit/whitened_samples.h"

namespace shadowfit {
namespace {

/// The dual cone without its rim. Valid axes (alpha, beta, 1) are the interior of the hull's polar dual, a
/// convex polygon around the origin: along a direction d they reach to 1 / max(-d.v). The chart y = d (-ln(1
/// - t)), t the share of that reach, maps it onto the whole plane: a search needs no constraints, and a step
/// means the same factor of smallest w everywhere.
class AxisChart {
 public:
  explicit AxisChart(const std::vector<glm::dvec2>& hull) : hull_(hull) {}

  glm::dvec2 AxisAt(const glm::dvec2& y) const {
    const double radius = glm::length(y);
    if (!(radius > 0.0)) return glm::dvec2(0.0);
    const glm::dvec2 d = y / radius;
    return d * (Reach(d) * -std::expm1(-radius));
  }
  /// Axes beyond the cone's rim come out just within it.
  glm::dvec2 ChartOf(const glm::dvec2& axis) const {
    const double length = glm::length(axis);
    if (!(length > 0.0)) return glm::dvec2(0.0);
    const glm::dvec2 d = axis / length;
    const double t = std::min(length / Reach(d), 0.999);
    return d * -std::log1p(-t);
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

struct Candidate {
  glm::dvec2 y{0.0};
  EdgeFit::Result result;
};

bool ByCost(const Candidate& a, const Candidate& b) { return a.result.cost < b.result.cost; }

/// Nelder and Mead's simplex in the plane, from one candidate on, with the affine search warm-started from
/// the best vertex and as fine as `steps` (EdgeFit).
Candidate Descend(EdgeFit& fit, int steps, const AxisChart& chart, const Candidate& start, double size,
                  int most_evaluations, double tolerance) {
  const auto evaluate = [&](const glm::dvec2& y, const AffineShape& shape) {
    return Candidate{y, fit.EvaluateNear(chart.AxisAt(y), shape, steps)};
  };
  std::array<Candidate, 3> simplex = {start, evaluate(start.y + glm::dvec2(size, 0.0), start.result.shape),
                                      evaluate(start.y + glm::dvec2(0.0, size), start.result.shape)};
  for (int used = 2; used < most_evaluations;) {
    std::sort(simplex.begin(), simplex.end(), ByCost);
    const double spread = simplex[2].result.cost - simplex[0].result.cost;
    if (spread <= tolerance * simplex[0].result.cost) break;
    const glm::dvec2 middle = 0.5 * (simplex[0].y + simplex[1].y);
    const glm::dvec2 away = middle - simplex[2].y;
    const AffineShape& shape = simplex[0].result.shape;
    const Candidate reflected = evaluate(middle + away, shape);
    ++used;
    if (reflected.result.cost < simplex[0].result.cost) {
      const Candidate expanded = evaluate(middle + 2.0 * away, shape);
      ++used;
      simplex[2] = std::min(expanded, reflected, ByCost);
    } else if (reflected.result.cost < simplex[1].result.cost) {
      simplex[2] = reflected;
    } else {
      const bool outside = reflected.result.cost < simplex[2].result.cost;
      const Candidate contracted = evaluate(middle + (outside ? 0.5 : -0.5) * away, shape);
      ++used;
      if (contracted.result.cost < std::min(reflected.result.cost, simplex[2].result.cost)) {
        simplex[2] = contracted;
      } else {
        for (size_t i = 1; i < 3; ++i) {
          simplex[i] = evaluate(0.5 * (simplex[0].y + simplex[i].y), shape);
          ++used;
        }
      }
    }
  }
  return *std::min_element(simplex.begin(), simplex.end(), ByCost);
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
  std::vector<Candidate> starts;
  starts.push_back({glm::dvec2(0.0), search.Evaluate(glm::dvec2(0.0), EdgeFit::kCoarse)});
  for (const double radius : {1.0, 2.2}) {
    for (int k = 0; k < options.search_directions; ++k) {
      const double angle = 2.0 * std::numbers::pi * (k + 0.5 * (radius > 2.0)) / options.search_directions;
      const glm::dvec2 y = radius * glm::dvec2(std::cos(angle), std::sin(angle));
      starts.push_back({y, search.Evaluate(chart.AxisAt(y), EdgeFit::kCoarse)});
    }
  }
  if (problem.previous != nullptr) {
    // A row vector h of ray space is h T^-1 in whitened coordinates.
    const glm::dvec3 axis =
        glm::transpose(glm::inverse(samples.whitened_from_ray)) * problem.previous->Axis();
    if (axis.z > 0.0) {
      const glm::dvec2 y = chart.ChartOf(glm::dvec2(axis) / axis.z);
      starts.push_back({y, search.Evaluate(chart.AxisAt(y), EdgeFit::kCoarse)});
    }
  }
  std::sort(starts.begin(), starts.end(), ByCost);
  EdgeFit final_fit(samples, problem.map_size, options.free_aspect);
  Candidate best;
  const size_t descents = std::min(starts.size(), static_cast<size_t>(options.descents));
  for (size_t i = 0; i < descents; ++i) {
    Candidate found =
        Descend(search, EdgeFit::kMedium, chart, starts[i], 0.5, options.evaluations_per_descent, 2e-3);
    found.result = final_fit.EvaluateNear(chart.AxisAt(found.y), found.result.shape);
    if (i == 0 || found.result.cost < best.result.cost) best = found;
  }
  if (options.evaluations_to_polish > 0) {
    best = Descend(final_fit, EdgeFit::kFine, chart, best, 0.1, options.evaluations_to_polish, 5e-4);
  }

  SingleMapFit fit;
  fit.complete = hull.complete;
  // Sums of costs stay finite.
  constexpr double kMostCost = 1e60;
  fit.usable =
      fit.complete && best.result.cost < kMostCost && hull.cos_half_angle > std::cos(kWidestHalfAngle);
  fit.cost = std::min(best.result.cost, kMostCost);
  for (const BoundarySamples* boundary : {&problem.samples->boundary, &problem.samples->rough_boundary}) {
    for (const double length : boundary->length) fit.edge_length += length;
  }
  fit.evaluations = search.evaluations() + final_fit.evaluations();
  fit.projection.size = final_fit.SizeOf(best.result.shape);
  fit.projection.texel_from_ray =
      WithUnitAxis(final_fit.TexelFromWhitened(chart.AxisAt(best.y), best.result.shape, fit.projection.size) *
                   samples.whitened_from_ray);
  return fit;
}

}  // namespace shadowfit
