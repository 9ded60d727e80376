#pragma once

#include <glm/glm.hpp>
#include <span>

namespace shadowfit {

/// A rectangle at any angle.
struct EnclosingRectangle {
  glm::dvec2 center{0.0};
  glm::dvec2 axis{1.0, 0.0};  ///< Unit vector along `width`; the height runs along (-axis.y, axis.x).
  double width = 0.0;
  double height = 0.0;

  double Area() const { return width * height; }
};

/// The smallest rectangle with the given axis (a unit vector) that contains all points. No points: an empty
/// rectangle at the origin. O(n).
EnclosingRectangle RectangleAlong(std::span<const glm::dvec2> points, const glm::dvec2& axis);

/// The rectangle of least area around a convex polygon whose vertices are given counter-clockwise without
/// repeats (as ConvexHull2 makes them); width >= height. One of its sides holds an edge of the polygon (H.
/// Freeman, R. Shapira, "Determining the minimum-area encasing rectangle for an arbitrary closed curve",
/// 1975), so all edges are tried with rotating calipers, O(n). One point or two: a rectangle without area
/// along them; none: an empty one at the origin.
EnclosingRectangle MinimumAreaRectangle(std::span<const glm::dvec2> convex_polygon);

}  // namespace shadowfit
