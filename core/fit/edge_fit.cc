#include "core/fit/edge_fit.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/fit/edge_kernels.h"

namespace shadowfit {
namespace {

// Sides closer to parallel than this make slivers that no metric asks for.
constexpr double kLeastSine = 0.08;

/// Rotations by pi/16 * 2^-k, the steps of the pattern search.
struct Rotation {
  double cosine;
  double sine;
  double angle;
};
const std::array<Rotation, EdgeFit::kFine>& Steps() {
  static const std::array<Rotation, EdgeFit::kFine> steps = [] {
    std::array<Rotation, EdgeFit::kFine> all;
    double angle = std::numbers::pi / 16.0;
    for (Rotation& step : all) {
      step = {std::cos(angle), std::sin(angle), angle};
      angle *= 0.5;
    }
    return all;
  }();
  return steps;
}

/// The directions of the first search.
struct CoarseDirections {
  glm::dvec2 exact[kCoarseDirections];
  float rounded[kCoarseDirections][2];
};
const CoarseDirections& CoarseSides() {
  static const CoarseDirections sides = [] {
    CoarseDirections all;
    for (size_t i = 0; i < kCoarseDirections; ++i) {
      const double angle = std::numbers::pi * static_cast<double>(i) / kCoarseDirections;
      all.exact[i] = {std::cos(angle), std::sin(angle)};
      all.rounded[i][0] = static_cast<float>(all.exact[i].x);
      all.rounded[i][1] = static_cast<float>(all.exact[i].y);
    }
    return all;
  }();
  return sides;
}

glm::dvec2 Rotate(const glm::dvec2& v, const Rotation& by, double sign) {
  return {v.x * by.cosine - sign * v.y * by.sine, sign * v.x * by.sine + v.y * by.cosine};
}

double SineBetweenSides(const AffineShape& shape) {
  return std::abs(shape.side1.x * shape.side2.y - shape.side1.y * shape.side2.x);
}

}  // namespace

bool IsAllowed(const AffineShape& shape) {
  constexpr double kMost = kMostStretch * (1.0 + 1e-9);
  return SineBetweenSides(shape) >= kLeastSine && shape.stretch <= kMost && shape.stretch * kMost >= 1.0;
}

EdgeFit::EdgeFit(const WhitenedSamples& samples, MapSize size, bool free_aspect)
    : samples_(samples), size_(size), free_aspect_(free_aspect) {
  covector_x_.resize(samples.x.size());
  covector_y_.resize(samples.x.size());
  covector_bin_.resize(samples.x.size());
  hull_x_.resize(PaddedToEdgeLanes(samples.hull.size()));
  hull_y_.resize(PaddedToEdgeLanes(samples.hull.size()));
}

bool EdgeFit::ProjectHull(const glm::dvec2& axis) {
  double least = 1e300;
  double most = 0.0;
  const size_t count = samples_.hull.size();
  for (size_t i = 0; i < hull_x_.size(); ++i) {
    const glm::dvec2& v = samples_.hull[std::min(i, count - 1)];
    const double w = 1.0 + axis.x * v.x + axis.y * v.y;
    least = std::min(least, w);
    most = std::max(most, w);
    hull_x_[i] = static_cast<float>(v.x / w);
    hull_y_[i] = static_cast<float>(v.y / w);
  }
  return least > kLeastRatioOfW * most;
}

void EdgeFit::Gather(const glm::dvec2& axis) {
  const size_t count = samples_.x.size();
  EdgeCovectors(samples_.x.data(), samples_.y.data(), samples_.e1.data(), samples_.e2.data(),
                samples_.e3.data(), count, static_cast<float>(axis.x), static_cast<float>(axis.y),
                static_cast<int>(kBins), covector_x_.data(), covector_y_.data(), covector_bin_.data());
  std::array<float, kBins> sum_x{};
  std::array<float, kBins> sum_y{};
  for (size_t i = 0; i < count; ++i) {
    const auto bin = static_cast<size_t>(covector_bin_[i]);
    sum_x[bin] += covector_x_[i];
    sum_y[bin] += covector_y_[i];
  }
  gathered_ = 0;
  for (size_t bin = 0; bin < kBins; ++bin) {
    if (sum_x[bin] == 0.0f && sum_y[bin] == 0.0f) continue;
    gx_[gathered_] = sum_x[bin];
    gy_[gathered_] = sum_y[bin];
    ++gathered_;
  }
  while (gathered_ % kEdgeLanes != 0) {
    gx_[gathered_] = gy_[gathered_] = 0.0f;
    ++gathered_;
  }
}

bool EdgeFit::MoveTo(const glm::dvec2& axis) {
  ++evaluations_;
  if (!ProjectHull(axis)) return false;
  Gather(axis);
  return true;
}

double EdgeFit::Cost(const AffineShape& shape) const {
  if (!IsAllowed(shape)) return 1e300;
  const double sine = SineBetweenSides(shape);
  // A side is as long as the hull is wide across the other side, over the sine between them.
  const float across2[2] = {static_cast<float>(-shape.side2.y), static_cast<float>(shape.side2.x)};
  const float across1[2] = {static_cast<float>(-shape.side1.y), static_cast<float>(shape.side1.x)};
  float extents[2];
  HullExtents(hull_x_.data(), hull_y_.data(), hull_x_.size(), across2, across1, extents);
  const double step1 = static_cast<double>(extents[0]) / (sine * size_.width * shape.stretch);
  const double step2 = static_cast<double>(extents[1]) * shape.stretch / (sine * size_.height);
  const float b1[2] = {static_cast<float>(shape.side1.x * step1), static_cast<float>(shape.side1.y * step1)};
  const float b2[2] = {static_cast<float>(shape.side2.x * step2), static_cast<float>(shape.side2.y * step2)};
  return static_cast<double>(EdgeCost(gx_.data(), gy_.data(), gathered_, b1, b2));
}

/// Pattern search: each side alone, both together and the aspect, both ways; the step is halved where nothing
/// improves.
void EdgeFit::Refine(int steps, Result* best) const {
  const auto attempt = [&](const AffineShape& shape) {
    const double cost = Cost(shape);
    if (cost >= best->cost) return false;
    *best = {cost, shape};
    return true;
  };
  constexpr int kMostRounds = 8;
  for (int k = 0; k < steps; ++k) {
    const Rotation& step = Steps()[static_cast<size_t>(k)];
    bool improved = true;
    for (int round = 0; improved && round < kMostRounds; ++round) {
      improved = false;
      for (const double sign : {1.0, -1.0}) {
        const auto turned = [&](const glm::dvec2& side) { return Rotate(side, step, sign); };
        improved |= attempt({turned(best->shape.side1), best->shape.side2, best->shape.stretch});
        improved |= attempt({best->shape.side1, turned(best->shape.side2), best->shape.stretch});
        improved |= attempt({turned(best->shape.side1), turned(best->shape.side2), best->shape.stretch});
        if (free_aspect_) {
          const double factor = 1.0 + 2.0 * step.angle;
          improved |= attempt({best->shape.side1, best->shape.side2,
                               sign > 0.0 ? best->shape.stretch * factor : best->shape.stretch / factor});
        }
      }
    }
  }
}

EdgeFit::Result EdgeFit::Evaluate(const glm::dvec2& axis, int steps, double worth) {
  Result best;
  if (!MoveTo(axis)) return best;
  float costs[kCoarseDirections][kCoarseDirections];
  EdgeCostsOfPairs(gx_.data(), gy_.data(), gathered_, hull_x_.data(), hull_y_.data(), hull_x_.size(),
                   CoarseSides().rounded, static_cast<float>(size_.width), static_cast<float>(size_.height),
                   costs);
  for (size_t i = 0; i < kCoarseDirections; ++i) {
    for (size_t j = 0; j < kCoarseDirections; ++j) {
      if (i == j || !(static_cast<double>(costs[i][j]) < best.cost)) continue;
      best = {static_cast<double>(costs[i][j]), {CoarseSides().exact[i], CoarseSides().exact[j], 1.0}};
    }
  }
  if (best.cost < worth) Refine(steps, &best);
  return best;
}

MapSize EdgeFit::SizeOf(const AffineShape& shape) const {
  if (!free_aspect_) return size_;
  const int width = std::max(1, static_cast<int>(std::lround(size_.width * shape.stretch)));
  return {width, std::max(1, static_cast<int>(std::floor(size_.texels() / width)))};
}

glm::dmat3 EdgeFit::TexelFromWhitened(const glm::dvec2& axis, const AffineShape& shape, MapSize size) const {
  // Rows of the inverse of [side1 side2]: coordinates along the sides.
  const glm::dvec2 d1 = shape.side1;
  glm::dvec2 d2 = shape.side2;
  if (d1.x * d2.y - d1.y * d2.x < 0.0) d2 = -d2;  // Never mirrored.
  const double det = d1.x * d2.y - d1.y * d2.x;
  const glm::dvec2 rows[2] = {glm::dvec2(d2.y, -d2.x) / det, glm::dvec2(-d1.y, d1.x) / det};
  const int texels[2] = {size.width, size.height};
  glm::dvec3 h[2];
  for (int k = 0; k < 2; ++k) {
    double low = 1e300;
    double high = -1e300;
    for (const glm::dvec2& v : samples_.hull) {
      const double along = glm::dot(rows[k], v) / (1.0 + glm::dot(axis, v));
      low = std::min(low, along);
      high = std::max(high, along);
    }
    // A hull without extent in this direction still needs a regular map.
    const double extent = std::max(high - low, 1e-6);
    low = 0.5 * (low + high) - 0.5 * extent;
    const double scale = texels[k] / extent;
    h[k] = glm::dvec3(rows[k] * scale, 0.0) - (low * scale) * glm::dvec3(axis, 1.0);
  }
  return glm::transpose(glm::dmat3(h[0], h[1], glm::dvec3(axis, 1.0)));
}

}  // namespace shadowfit
