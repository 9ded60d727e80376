#pragma once

#include <array>
#include <glm/glm.hpp>
#include <vector>

#include "core/fit/edge_fit.h"
#include "core/fit/whitened_samples.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

/// The samples' sum of l y (metric.h), the pixels that edges are displaced by, as a function of all that a
/// map's matrix is free in once it encloses the hull, with its gradient: what a descent over axis and
/// parallelogram together needs. One pass over the samples, where EdgeFit takes one and then searches.
///
/// It has a kink wherever a side passes from one vertex of the hull to another, and is smooth between those:
/// the two branches of s/4 + t^2/(12 s) have the same slopes where s = t.
class EdgeObjective {
 public:
  /// The axis (alpha, beta) of whitened coordinates, the angles of the sides along map x and y in radians,
  /// and the logarithm of AffineShape::stretch, beyond kMostStretch the same as at it.
  using Parameters = std::array<double, 5>;

  /// Borrows `samples`. Unless the aspect is free the slope along the last parameter is 0.
  EdgeObjective(const WhitenedSamples& samples, MapSize size, bool free_aspect);

  static Parameters ParametersOf(const glm::dvec2& axis, const AffineShape& shape);
  static glm::dvec2 AxisOf(const Parameters& at) { return {at[0], at[1]}; }
  static AffineShape ShapeOf(const Parameters& at);

  /// The natural logarithm of the displaced pixels, so that steps and tolerances mean the same
  /// for all lights, and its slopes; infinite (and `gradient` untouched) where the axis does not see the
  /// hull, the parallelogram is a sliver (EdgeFit's limits) or the cost overflows. Without any edge it is
  /// that of a least cost.
  double Evaluate(const Parameters& at, Parameters* gradient);

  /// The displaced pixels of any map.
  double CostOf(const TexelGrid& grid);

  /// Lengths of the axis are measured by what they do to w over the hull: the matrix M of the quadratic form
  /// sum (dw / w)^2 / n over the hull's vertices. Scales a descent's first step.
  glm::dmat2 AxisMetric(const glm::dvec2& axis) const;

  int evaluations() const { return evaluations_; }

 private:
  const WhitenedSamples& samples_;
  MapSize size_;
  bool free_aspect_;
  int evaluations_ = 0;
  std::vector<float> hull_x_;  ///< Padded to the kernels' lanes.
  std::vector<float> hull_y_;
};

}  // namespace shadowfit
