#include "core/math/enclosing_rectangle.h"

#include <cmath>
#include <cstddef>
#include <utility>

namespace shadowfit {
namespace {

glm::dvec2 Left(const glm::dvec2& v) { return {-v.y, v.x}; }

/// A pointer that walks around the polygon to the vertex extreme in a direction which only turns left.
class Caliper {
 public:
  Caliper(std::span<const glm::dvec2> polygon, const glm::dvec2& direction) : polygon_(polygon) {
    for (size_t i = 1; i < polygon.size(); ++i) {
      if (glm::dot(polygon[i] - polygon[at_], direction) > 0.0) at_ = i;
    }
  }

  /// Signed distance of the extreme vertex beyond `from`.
  double Reach(const glm::dvec2& direction, const glm::dvec2& from) {
    // Bounded by the number of vertices: rounding in nearly flat corners must not make it run in circles.
    for (size_t step = 0; step < polygon_.size(); ++step) {
      const size_t next = at_ + 1 < polygon_.size() ? at_ + 1 : 0;
      if (!(glm::dot(polygon_[next] - polygon_[at_], direction) > 0.0)) break;
      at_ = next;
    }
    return glm::dot(polygon_[at_] - from, direction);
  }

 private:
  std::span<const glm::dvec2> polygon_;
  size_t at_ = 0;
};

}  // namespace

EnclosingRectangle RectangleAlong(std::span<const glm::dvec2> points, const glm::dvec2& axis) {
  EnclosingRectangle rectangle;
  rectangle.axis = axis;
  if (points.empty()) return rectangle;
  const glm::dvec2 side = Left(axis);
  // Relative to one of the points, so that a small set far from the origin loses nothing.
  const glm::dvec2 from = points[0];
  glm::dvec2 low(0.0);
  glm::dvec2 high(0.0);
  for (const glm::dvec2& p : points) {
    const glm::dvec2 q(glm::dot(p - from, axis), glm::dot(p - from, side));
    low = glm::min(low, q);
    high = glm::max(high, q);
  }
  const glm::dvec2 middle = 0.5 * (low + high);
  rectangle.center = from + middle.x * axis + middle.y * side;
  rectangle.width = high.x - low.x;
  rectangle.height = high.y - low.y;
  return rectangle;
}

EnclosingRectangle MinimumAreaRectangle(std::span<const glm::dvec2> convex_polygon) {
  const size_t count = convex_polygon.size();
  if (count < 2) return RectangleAlong(convex_polygon, {1.0, 0.0});

  EnclosingRectangle best;
  double best_area = HUGE_VAL;
  const glm::dvec2 first_edge = convex_polygon[1] - convex_polygon[0];
  Caliper right(convex_polygon, first_edge);
  Caliper top(convex_polygon, Left(first_edge));
  Caliper left(convex_polygon, -first_edge);
  for (size_t i = 0; i < count; ++i) {
    const glm::dvec2 a = convex_polygon[i];
    const glm::dvec2 edge = convex_polygon[i + 1 < count ? i + 1 : 0] - a;
    const double length = std::hypot(edge.x, edge.y);
    if (!(length > 0.0)) continue;
    const glm::dvec2 axis = edge / length;
    const glm::dvec2 side = Left(axis);
    const double reach_right = right.Reach(axis, a);
    const double reach_top = top.Reach(side, a);
    const double reach_left = left.Reach(-axis, a);
    const double width = reach_right + reach_left;
    const double area = width * reach_top;
    if (area < best_area) {
      best_area = area;
      best.axis = axis;
      best.width = width;
      best.height = reach_top;
      best.center = a + 0.5 * (reach_right - reach_left) * axis + 0.5 * reach_top * side;
    }
  }
  if (best.height > best.width) {
    best.axis = Left(best.axis);
    std::swap(best.width, best.height);
  }
  return best;
}

}  // namespace shadowfit
