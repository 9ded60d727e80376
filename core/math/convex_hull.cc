#include "core/math/convex_hull.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace shadowfit {
namespace {

/// Below this many points sorting all of them is cheaper than filtering.
constexpr size_t kFilterFrom = 32;

/// Twice the signed area of the triangle (a, b, c), positive where it turns left.
double Turn(const glm::dvec2& a, const glm::dvec2& b, const glm::dvec2& c) {
  const glm::dvec2 ab = b - a;
  const glm::dvec2 ac = c - a;
  return ab.x * ac.y - ab.y * ac.x;
}

/// Half planes n.p > c whose intersection lies inside the hull: the edges of the octagon through the points
/// that are extreme in eight directions.
class InnerOctagon {
 public:
  explicit InnerOctagon(std::span<const glm::dvec2> points) {
    // Extremes of x, x+y, y, y-x, -x, ... in counter-clockwise order.
    std::array<size_t, 8> extreme{};
    std::array<double, 8> best;
    best.fill(-HUGE_VAL);
    double largest = 0.0;
    for (size_t i = 0; i < points.size(); ++i) {
      const glm::dvec2 p = points[i];
      const double keys[4] = {p.x, p.x + p.y, p.y, p.y - p.x};
      largest = std::max({largest, std::abs(p.x), std::abs(p.y)});
      for (size_t k = 0; k < 4; ++k) {
        if (keys[k] > best[k]) best[k] = keys[k], extreme[k] = i;
        if (-keys[k] > best[k + 4]) best[k + 4] = -keys[k], extreme[k + 4] = i;
      }
    }
    for (size_t k = 0; k < 8; ++k) {
      const glm::dvec2 a = points[extreme[k]];
      const glm::dvec2 edge = points[extreme[(k + 1) % 8]] - a;
      const double length = std::abs(edge.x) + std::abs(edge.y);
      if (length == 0.0) continue;
      // The margin keeps every point whose side rounding could decide: the filter never changes the hull.
      const glm::dvec2 inward(-edge.y, edge.x);
      half_planes_[count_++] = {inward, glm::dot(inward, a) + 1e-14 * length * largest};
    }
  }

  bool Contains(const glm::dvec2& p) const {
    for (size_t k = 0; k < count_; ++k) {
      if (!(glm::dot(half_planes_[k].inward, p) > half_planes_[k].offset)) return false;
    }
    return count_ >= 3;
  }

 private:
  struct HalfPlane {
    glm::dvec2 inward;
    double offset;
  };
  std::array<HalfPlane, 8> half_planes_;
  size_t count_ = 0;
};

}  // namespace

void ConvexHull2(std::span<const glm::dvec2> points, ConvexHullScratch* scratch, std::vector<int>* hull) {
  std::vector<int>& order = scratch->order;
  order.clear();
  hull->clear();
  const auto at = [points](int i) { return points[static_cast<size_t>(i)]; };
  const int count = static_cast<int>(points.size());
  if (points.size() >= kFilterFrom) {
    const InnerOctagon inner(points);
    for (int i = 0; i < count; ++i) {
      if (!inner.Contains(at(i))) order.push_back(i);
    }
  } else {
    for (int i = 0; i < count; ++i) order.push_back(i);
  }
  std::sort(order.begin(), order.end(), [at](int i, int j) {
    const glm::dvec2 a = at(i);
    const glm::dvec2 b = at(j);
    return a.x != b.x ? a.x < b.x : a.y != b.y ? a.y < b.y : i < j;
  });
  order.erase(std::unique(order.begin(), order.end(), [at](int i, int j) { return at(i) == at(j); }),
              order.end());
  if (order.size() < 3) {
    hull->assign(order.begin(), order.end());
    return;
  }

  // The lower chain from left to right, then the upper one from right to left. The upper one may not eat
  // into the lower: `floor` is the size that must remain.
  const auto append = [&](int i, size_t floor) {
    while (hull->size() > floor && Turn(at((*hull)[hull->size() - 2]), at(hull->back()), at(i)) <= 0.0) {
      hull->pop_back();
    }
    hull->push_back(i);
  };
  for (const int i : order) append(i, 1);
  const size_t lower = hull->size();
  for (size_t k = order.size() - 1; k-- > 0;) append(order[k], lower);
  hull->pop_back();  // The first vertex again.
}

std::vector<int> ConvexHull2(std::span<const glm::dvec2> points) {
  ConvexHullScratch scratch;
  std::vector<int> hull;
  ConvexHull2(points, &scratch, &hull);
  return hull;
}

}  // namespace shadowfit
