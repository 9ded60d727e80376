#include "core/fit/minimum_area_fit.h"

#include <algorithm>
#include <cmath>

namespace shadowfit {
namespace {

constexpr double kSteepestShear = 10.0;

/// A sheared rectangle: x' = e.p + shear * (n.p - bottom) in [low, high], y = n.p in [bottom, top].
struct ShearedRectangle {
  glm::dvec2 e{1.0, 0.0};
  double shear = 0.0;
  double low = 0.0;
  double high = 0.0;
  double bottom = 0.0;
  double top = 0.0;

  glm::dvec2 Normal() const { return {-e.y, e.x}; }
  double Area() const { return (high - low) * (top - bottom); }
};

ShearedRectangle Enclose(std::span<const glm::dvec2> polygon, const glm::dvec2& e, double bottom,
                         double shear) {
  ShearedRectangle box{e, shear, 1e300, -1e300, 1e300, -1e300};
  const glm::dvec2 n = box.Normal();
  for (const glm::dvec2& p : polygon) {
    const double y = glm::dot(n, p);
    const double x = glm::dot(e, p) + shear * (y - bottom);
    box.low = std::min(box.low, x);
    box.high = std::max(box.high, x);
    box.bottom = std::min(box.bottom, y);
    box.top = std::max(box.top, y);
  }
  return box;
}

/// Figure 3: where both extents of the points off the bottom edge lie to one side of the edge's own extents,
/// the shear that brings the extreme point of that side into line with the edge's end. 0 where they do not.
double HeuristicShear(std::span<const glm::dvec2> polygon, size_t edge, const glm::dvec2& e, double bottom) {
  const glm::dvec2 n(-e.y, e.x);
  const size_t next = (edge + 1) % polygon.size();
  const double edge_low = glm::dot(e, polygon[edge]);
  const double edge_high = glm::dot(e, polygon[next]);
  double low = 1e300;
  double high = -1e300;
  double height_at_low = 1.0;
  double height_at_high = 1.0;
  for (size_t i = 0; i < polygon.size(); ++i) {
    if (i == edge || i == next) continue;
    const double x = glm::dot(e, polygon[i]);
    const double height = glm::dot(n, polygon[i]) - bottom;
    if (x < low) {
      low = x;
      height_at_low = height;
    }
    if (x > high) {
      high = x;
      height_at_high = height;
    }
  }
  if (polygon.size() < 3) return 0.0;
  if (low < edge_low && high < edge_high && height_at_low > 0.0) return (edge_low - low) / height_at_low;
  if (low > edge_low && high > edge_high && height_at_high > 0.0) return (edge_high - high) / height_at_high;
  return 0.0;
}

}  // namespace

TexelFromPlane FitMinimumArea(std::span<const glm::dvec2> polygon, MapSize size, bool skew, double border) {
  ShearedRectangle best = Enclose(polygon, {1.0, 0.0}, 0.0, 0.0);
  double best_area = polygon.size() < 2 ? 0.0 : 1e300;
  for (size_t i = 0; polygon.size() >= 2 && i < polygon.size(); ++i) {
    const glm::dvec2 edge = polygon[(i + 1) % polygon.size()] - polygon[i];
    const double length = glm::length(edge);
    if (!(length > 0.0)) continue;
    const glm::dvec2 e = edge / length;
    const double bottom = glm::dot(glm::dvec2(-e.y, e.x), polygon[i]);
    const ShearedRectangle upright = Enclose(polygon, e, bottom, 0.0);
    if (upright.Area() < best_area) {
      best = upright;
      best_area = upright.Area();
    }
    if (!skew) continue;
    const double shear = HeuristicShear(polygon, i, e, bottom);
    // Steeper than this only occurs where the polygon is almost a line, whose area says nothing.
    if (shear == 0.0 || std::abs(shear) > kSteepestShear) continue;
    ShearedRectangle sheared = Enclose(polygon, e, bottom, shear);
    if (sheared.Area() < best_area) {
      // Enclose measured the shear from `bottom`; the box's own lowest point is that edge up to rounding.
      sheared.low += shear * (bottom - sheared.bottom);
      sheared.high += shear * (bottom - sheared.bottom);
      best = sheared;
      best_area = sheared.Area();
    }
  }

  // Widen what has no area: to a thousandth of the other side, and never below what doubles resolve with
  // ease.
  double width = best.high - best.low;
  double height = best.top - best.bottom;
  const double least = std::max(1e-3 * std::max(width, height), 1e-6);
  if (width < least) {
    best.low -= 0.5 * (least - width);
    width = least;
  }
  if (height < least) {
    const double lowered = 0.5 * (least - height);
    best.bottom -= lowered;
    best.low += best.shear * lowered;  // The shear is measured from the bottom.
    height = least;
  }

  const glm::dvec2 n = best.Normal();
  const glm::dvec2 x_row = best.e + best.shear * n;
  const double x_offset = -best.low - best.shear * best.bottom;
  const double y_offset = -best.bottom;
  const bool turn = (width >= height) != (size.width >= size.height);
  const double inner = 1.0 - 2.0 * border;
  const glm::dvec2 texels(size.width, size.height);
  glm::dvec2 row1;
  glm::dvec2 row2;
  glm::dvec2 offset;
  if (!turn) {
    row1 = x_row / width;
    row2 = n / height;
    offset = {x_offset / width, y_offset / height};
  } else {
    // A quarter turn: (u1, u2) = (1 - y, x).
    row1 = -n / height;
    row2 = x_row / width;
    offset = {1.0 - y_offset / height, x_offset / width};
  }
  row1 *= inner * texels.x;
  row2 *= inner * texels.y;
  offset = (offset * inner + border) * texels;
  return {glm::transpose(glm::dmat2(row1, row2)), offset};
}

glm::dmat3 TexelFromRay(const TexelFromPlane& affine, const glm::dvec3& b1, const glm::dvec3& b2,
                        const glm::dvec3& axis) {
  const glm::dmat2 rows = glm::transpose(affine.linear);
  const glm::dvec3 h1 = rows[0].x * b1 + rows[0].y * b2 + affine.offset.x * axis;
  const glm::dvec3 h2 = rows[1].x * b1 + rows[1].y * b2 + affine.offset.y * axis;
  return glm::transpose(glm::dmat3(h1, h2, axis));
}

}  // namespace shadowfit
