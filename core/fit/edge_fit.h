#pragma once

#include <array>
#include <cstdint>
#include <glm/glm.hpp>
#include <limits>
#include <vector>

#include "core/fit/edge_kernels.h"
#include "core/fit/whitened_samples.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

/// A parallelogram grid over the image plane of an axis.
struct AffineShape {
  glm::dvec2 side1{1.0, 0.0};  ///< Unit direction of the side along map x.
  glm::dvec2 side2{0.0, 1.0};  ///< Unit direction of the side along map y; never parallel to the first.
  /// Factor by which the map is wider, and divisor by which it is lower, than asked for; 1 unless the aspect
  /// is free.
  double stretch = 1.0;
};

/// A free aspect goes up to maps seven times as long as wide.
inline constexpr double kMostStretch = 2.7;

/// False for slivers, that no metric asks for, and beyond kMostStretch.
bool IsAllowed(const AffineShape& shape);

/// Below this ratio of smallest to largest w over the hull the map's texels differ 250-fold in width across
/// it, and rounding in a renderer's 32-bit matrices begins to show.
inline constexpr double kLeastRatioOfW = 0.004;

/// The `edge` metric (metric.h) as a function of the axis alone: at each axis (alpha, beta, 1) the covectors
/// l g of all samples are gathered by direction, which serves every affine part at that axis, and the best
/// enclosing parallelogram is searched over the gathered directions. The metric is homogeneous in g and
/// nearly linear over a bin's 2.8 degrees, so that gathering changes its value by less than a thousandth.
class EdgeFit {
 public:
  /// Borrows `samples`. `free_aspect`: width and height are free at a fixed number of texels.
  EdgeFit(const WhitenedSamples& samples, MapSize size, bool free_aspect);

  struct Result {
    double cost = 1e300;  ///< Displaced pixels; 1e300 where the axis does not see the hull.
    AffineShape shape;
  };

  /// How closely sides are turned: to pi/16 in a first step, and to half of that in each one more.
  static constexpr int kCoarse = 2;  ///< 5.6 degrees; the cost is square in the error, but at creases.
  static constexpr int kFine = 6;    ///< 0.35 degrees.

  /// The best parallelogram at an axis, searched over all directions; roughly where even so none costs less
  /// than `worth`.
  Result Evaluate(const glm::dvec2& axis, int steps = kFine,
                  double worth = std::numeric_limits<double>::infinity());

  /// The homography of an axis and a shape over whitened coordinates, for a map of `size` texels, exactly
  /// around the hull.
  glm::dmat3 TexelFromWhitened(const glm::dvec2& axis, const AffineShape& shape, MapSize size) const;

  /// The size that a shape gives a map: the requested one unless the aspect is free.
  MapSize SizeOf(const AffineShape& shape) const;

  int evaluations() const { return evaluations_; }

 private:
  static constexpr size_t kBins = kMostGathered;

  /// False where the axis does not see the hull.
  bool MoveTo(const glm::dvec2& axis);
  void Gather(const glm::dvec2& axis);
  bool ProjectHull(const glm::dvec2& axis);
  double Cost(const AffineShape& shape) const;
  void Refine(int steps, Result* best) const;

  const WhitenedSamples& samples_;
  MapSize size_;
  bool free_aspect_;
  int evaluations_ = 0;

  // At the current axis.
  std::vector<float> covector_x_;
  std::vector<float> covector_y_;
  std::vector<int32_t> covector_bin_;
  std::array<float, kBins>
      gx_{};  ///< Sums of the covectors whose direction falls into a bin; empty bins left out.
  std::array<float, kBins> gy_{};
  size_t gathered_ = 0;  ///< Of them in use, padded to the kernels' lanes.
  std::vector<float> hull_x_;
  std::vector<float> hull_y_;
};

}  // namespace shadowfit
