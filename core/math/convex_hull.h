#pragma once

#include <glm/glm.hpp>
#include <span>
#include <vector>

namespace shadowfit {

/// Working memory of ConvexHull2, kept by callers in hot loops.
struct ConvexHullScratch {
  std::vector<int> order;
  std::vector<int> side_of;
};

/// The convex hull of points in the plane: indices of its vertices, counter-clockwise, beginning with the
/// leftmost (lowest among equals). No vertex is repeated and none lies on the line through its neighbours, as
/// far as doubles tell: a set of equal points has a hull of one vertex, a collinear set one of two, an empty
/// set none. Among equal points the one of least index stands for all.
///
/// Points must be finite. O(n) for points inside a polygon of up to 64 of them, begun as the octagon of the
/// extreme ones (S. G. Akl, G. T. Toussaint, "A fast convex hull algorithm", 1978; W. F. Eddy, "A new convex
/// hull algorithm for planar sets", 1977), O(m log m) for the m others (A. M. Andrew, "Another efficient
/// algorithm for convex hulls in two dimensions", 1979).
std::vector<int> ConvexHull2(std::span<const glm::dvec2> points);

/// The same without allocation once `scratch` and `hull` have grown.
void ConvexHull2(std::span<const glm::dvec2> points, ConvexHullScratch* scratch, std::vector<int>* hull);

}  // namespace shadowfit
