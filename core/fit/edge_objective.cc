#include "core/fit/edge_objective.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/fit/edge_kernels.h"

namespace shadowfit {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

const double kMostLogStretch = std::log(kMostStretch);

// Stands for the cost of a light without edges, and for the extent of a hull without width.
constexpr double kLeastCost = 1e-30;
constexpr double kLeastExtent = 1e-6;

glm::dvec2 Across(const glm::dvec2& side) { return {-side.y, side.x}; }

/// How wide the hull is across a side, its logarithm's slope as the side turns, and those along the axis.
struct Extent {
  double width;
  double per_angle;
  glm::dvec2 per_axis;
};

/// The points are p = v / w, so that dp/dalpha = -p p.x and dp/dbeta = -p p.y.
Extent ExtentOf(const glm::dvec2& side, const HullSupport& support) {
  const glm::dvec2 low(support.low[0], support.low[1]);
  const glm::dvec2 high(support.high[0], support.high[1]);
  const glm::dvec2 normal = Across(side);
  const double width = glm::dot(normal, high - low);
  if (!(width > kLeastExtent)) return {kLeastExtent, 0.0, glm::dvec2(0.0)};
  return {width, -glm::dot(side, high - low) / width,
          (glm::dot(normal, low) * low - glm::dot(normal, high) * high) / width};
}

}  // namespace

EdgeObjective::EdgeObjective(const WhitenedSamples& samples, MapSize size, bool free_aspect)
    : samples_(samples), size_(size), free_aspect_(free_aspect) {
  const size_t count = samples.hull.size();
  const size_t padded = PaddedToEdgeLanes(count);
  hull_x_.resize(padded);
  hull_y_.resize(padded);
  for (size_t i = 0; i < padded; ++i) {
    const glm::dvec2& v = samples.hull[std::min(i, count - 1)];
    hull_x_[i] = static_cast<float>(v.x);
    hull_y_[i] = static_cast<float>(v.y);
  }
}

EdgeObjective::Parameters EdgeObjective::ParametersOf(const glm::dvec2& axis, const AffineShape& shape) {
  return {axis.x, axis.y, std::atan2(shape.side1.y, shape.side1.x), std::atan2(shape.side2.y, shape.side2.x),
          std::log(shape.stretch)};
}

AffineShape EdgeObjective::ShapeOf(const Parameters& at) {
  return {{std::cos(at[2]), std::sin(at[2])},
          {std::cos(at[3]), std::sin(at[3])},
          std::exp(std::clamp(at[4], -kMostLogStretch, kMostLogStretch))};
}

double EdgeObjective::Evaluate(const Parameters& at, Parameters* gradient) {
  ++evaluations_;
  const AffineShape shape = ShapeOf(at);
  const double sine = shape.side1.x * shape.side2.y - shape.side1.y * shape.side2.x;
  if (!IsAllowed(shape)) return kInfinity;
  const float axis[2] = {static_cast<float>(at[0]), static_cast<float>(at[1])};
  const HullView hull = ViewHull(hull_x_.data(), hull_y_.data(), hull_x_.size(), axis,
                                 Rounded(Across(shape.side1)).data(), Rounded(Across(shape.side2)).data());
  if (!(hull.least_w > kLeastRatioOfW * hull.most_w)) return kInfinity;

  // One step of a texel along map x is a step b1 = k1 side1, k1 = extent2 / (|sine| width stretch), the
  // extent that across the other side; along map y likewise.
  const Extent extent1 = ExtentOf(shape.side1, hull.across1);
  const Extent extent2 = ExtentOf(shape.side2, hull.across2);
  const glm::dvec2 b1 = shape.side1 * (extent2.width / (std::abs(sine) * size_.width * shape.stretch));
  const glm::dvec2 b2 = shape.side2 * (extent1.width * shape.stretch / (std::abs(sine) * size_.height));
  const EdgeSlopes slopes =
      EdgeCostAndSlopes(samples_.x.data(), samples_.y.data(), samples_.e1.data(), samples_.e2.data(),
                        samples_.e3.data(), samples_.x.size(), axis, Rounded(b1).data(), Rounded(b2).data());
  const double cost = static_cast<double>(slopes.cost);
  if (!std::isfinite(cost)) return kInfinity;
  if (!(cost > kLeastCost)) {
    gradient->fill(0.0);
    return std::log(kLeastCost);
  }

  // With F_k = df/db_k, db_1 = Across(b_1) dangle_1 + b_1 dln k_1, and
  //   dln k_1 = dln extent2 - dln|sine| - dln stretch,  dln k_2 = dln extent1 - dln|sine| + dln stretch,
  //   dln|sine| = cot (dangle_2 - dangle_1).
  const glm::dvec2 f1(slopes.per_b1[0], slopes.per_b1[1]);
  const glm::dvec2 f2(slopes.per_b2[0], slopes.per_b2[1]);
  const double a1 = glm::dot(f1, b1);
  const double a2 = glm::dot(f2, b2);
  const double cotangent = glm::dot(shape.side1, shape.side2) / sine;
  const glm::dvec2 per_axis =
      glm::dvec2(slopes.per_axis[0], slopes.per_axis[1]) + a1 * extent2.per_axis + a2 * extent1.per_axis;
  *gradient = {per_axis.x, per_axis.y,
               glm::dot(f1, Across(b1)) + a2 * extent1.per_angle + (a1 + a2) * cotangent,
               glm::dot(f2, Across(b2)) + a1 * extent2.per_angle - (a1 + a2) * cotangent,
               free_aspect_ && std::abs(at[4]) <= kMostLogStretch ? a2 - a1 : 0.0};
  for (double& slope : *gradient) slope /= cost;
  return std::log(cost);
}

double EdgeObjective::CostOf(const TexelGrid& grid) {
  ++evaluations_;
  return static_cast<double>(EdgeCostAndSlopes(samples_.x.data(), samples_.y.data(), samples_.e1.data(),
                                               samples_.e2.data(), samples_.e3.data(), samples_.x.size(),
                                               Rounded(grid.axis).data(), Rounded(grid.step1).data(),
                                               Rounded(grid.step2).data())
                                 .cost);
}

glm::dmat2 EdgeObjective::AxisMetric(const glm::dvec2& axis) const {
  glm::dmat2 sum(0.0);
  for (const glm::dvec2& v : samples_.hull) {
    const glm::dvec2 p = v / (1.0 + glm::dot(axis, v));
    sum += glm::outerProduct(p, p);
  }
  return sum / static_cast<double>(samples_.hull.size());
}

}  // namespace shadowfit
