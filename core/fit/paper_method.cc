#include "core/fit/paper_method.h"

#include <cmath>
#include <numbers>
#include <utility>
#include <vector>

#include "core/fit/frobenius_moments.h"
#include "core/fit/metric.h"
#include "core/fit/minimum_area_fit.h"
#include "core/fit/ray_hull.h"
#include "core/fit/rescale_previous.h"

namespace shadowfit {
namespace {

/// One light's search: everything that stays the same while the axis turns.
class AxisDescent {
 public:
  AxisDescent(const LightProblem& problem, const PaperOptions& options, RayHull hull)
      : options_(options), map_size_(problem.map_size), hull_(std::move(hull)) {
    const BoundarySamples& all = problem.samples->boundary;
    moments_ = FrobeniusMoments(hull_.complete ? all : Kept(all), hull_.normalized_from_ray);
    polygon_.resize(hull_.vertices.size());
  }

  /// The smallest w = axis . r of the hull's unit rays; the axis sees them all where this is positive.
  double SmallestCosine(const glm::dvec3& axis) const {
    double smallest = 1.0;
    for (const glm::dvec3& r : hull_.vertices)
      smallest = std::min(smallest, glm::dot(axis, r) / glm::length(r));
    return smallest;
  }

  /// Step 4.b.ii: the affine part for an axis.
  glm::dmat3 FitAffine(const glm::dvec3& axis) {
    const ImagePlane plane = ImagePlane::About(axis);
    for (size_t i = 0; i < polygon_.size(); ++i) polygon_[i] = plane.Project(hull_.vertices[i]);
    return TexelFromRay(FitMinimumArea(polygon_, map_size_, options_.skew, options_.border), plane.b1,
                        plane.b2, axis);
  }

  /// Steps 4.a and 4.b: the best matrix from `axis` on, and how often the objective was evaluated.
  glm::dmat3 Descend(glm::dvec3 axis, int* evaluations) {
    glm::dmat3 best = FitAffine(axis);
    double best_h = moments_.Value(best);
    *evaluations = 1;
    for (int iteration = 0; iteration < options_.iterations; ++iteration) {
      axis = glm::transpose(best)[2];
      const glm::dvec3 gradient = moments_.AxisGradient(best);
      // The axis turns about h3 x (-grad h): towards the negative gradient.
      const glm::dvec3 turn = glm::cross(axis, -gradient);
      const double length = glm::length(turn);
      if (!(length > 0.0) || !std::isfinite(length)) break;
      bool improved = false;
      for (const double degrees : options_.angles_degrees) {
        const glm::dvec3 candidate = Rotate(axis, turn / length, degrees * std::numbers::pi / 180.0);
        // An axis that leaves the dual cone has samples behind it: no map.
        if (SmallestCosine(candidate) <= kSmallestCosine) continue;
        const glm::dmat3 matrix = FitAffine(candidate);
        const double h = moments_.Value(matrix);
        ++*evaluations;
        if (h < best_h) {
          best_h = h;
          best = matrix;
          improved = true;
        }
      }
      if (!improved) break;
    }
    return best;
  }

  const RayHull& hull() const { return hull_; }

  static constexpr double kSmallestCosine = 1e-4;

 private:
  /// The samples that a reduced hull keeps.
  BoundarySamples Kept(const BoundarySamples& all) const {
    BoundarySamples kept;
    for (size_t i = 0; i < all.size(); ++i) {
      if (!hull_.Keeps(hull_.normalized_from_ray * all.Ray(i))) continue;
      kept.Add(all.Ray(i), all.RayDx1(i), all.RayDx2(i), all.q[i], {all.n1[i], all.n2[i]}, all.length[i]);
    }
    return kept;
  }

  static glm::dvec3 Rotate(const glm::dvec3& axis, const glm::dvec3& about, double angle) {
    // `about` is perpendicular to `axis`.
    return glm::normalize(std::cos(angle) * axis + std::sin(angle) * glm::cross(about, axis));
  }

  const PaperOptions& options_;
  MapSize map_size_;
  RayHull hull_;
  FrobeniusMoments moments_;
  std::vector<glm::dvec2> polygon_;
};

}  // namespace

absl::StatusOr<LightFit> PaperMethod::Fit(const LightProblem& problem) const {
  AxisDescent descent(problem, options_, MakeRayHull(problem, HullOf::kSamples));
  const RayHull& hull = descent.hull();
  const glm::dmat3 ray_from_normalized = glm::inverse(hull.normalized_from_ray);

  LightFit fit;
  fit.projection.size = problem.map_size;
  if (!hull.complete) {
    fit.outcome = FitOutcome::kFallback;
    fit.note =
        "receivers span a half space or more as seen from the light; the map holds the part around its axis";
  }

  glm::dvec3 start = hull.axis;
  std::optional<ShadowProjection> previous;
  if (problem.previous != nullptr && hull.complete) {
    previous =
        RescaleToHold(*problem.previous, problem.map_size, problem.samples->hull_rays, options_.border);
    if (previous) {
      // A row vector h of ray space is h N^-1 in normalised coordinates.
      const glm::dvec3 axis = glm::normalize(glm::transpose(ray_from_normalized) * previous->Axis());
      if (descent.SmallestCosine(axis) > AxisDescent::kSmallestCosine) start = axis;
    }
  }
  const glm::dmat3 normalized = descent.Descend(start, &fit.evaluations);
  fit.projection.texel_from_ray = WithUnitAxis(normalized * hull.normalized_from_ray);

  // Step 5, the 80 % median rule.
  if (previous && options_.sufficient_improvement > 0.0) {
    std::vector<double> scratch;
    const BoundarySamples& boundary = problem.samples->boundary;
    const double fresh_median = FrobeniusMedian(boundary, fit.projection.texel_from_ray, &scratch);
    const double kept_median = FrobeniusMedian(boundary, previous->texel_from_ray, &scratch);
    if (!(fresh_median < options_.sufficient_improvement * kept_median)) {
      fit.projection = *previous;
      fit.outcome = FitOutcome::kKeptPrevious;
    }
  }
  return fit;
}

}  // namespace shadowfit
