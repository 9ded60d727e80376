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

/// Rounds of refinement, each of which splits the polygon's sides in two.
constexpr int kRounds = 3;
constexpr size_t kMostSides = 8 << kRounds;

/// Fewer points than this are sorted sooner than they are filtered once more.
constexpr size_t kFew = 48;

/// Points that may be vertices of the hull: those outside a polygon of points, the octagon of the extreme
/// ones at first. The farthest point outside each side becomes a corner, too, and what lies in the triangle
/// between is dropped (Eddy); what is left after a few rounds is no more than a few for each side.
class OuterPoints {
 public:
  /// Both lists are filled by Find(): the points' indices, and of each the side that it lies outside of.
  OuterPoints(std::span<const glm::dvec2> points, std::vector<int>* outer, std::vector<int>* side_of)
      : points_(points), outer_(*outer), side_of_(*side_of) {}

  void Find() {
    MakeOctagon();
    outer_.clear();
    side_of_.clear();
    for (size_t i = 0; i < points_.size(); ++i) {
      const int side = SideOutside(points_[i]);
      if (side < 0) continue;
      outer_.push_back(static_cast<int>(i));
      side_of_.push_back(side);
    }
    for (int round = 0; round < kRounds && outer_.size() >= kFew; ++round) Refine();
  }

 private:
  /// From corner `a` to corner `b`, counter-clockwise: points are inside where their Depth() is above
  /// `inside`, outside where it is below `outside`. What is between may be either, by rounding, and is kept:
  /// the filter never changes the hull.
  struct Side {
    glm::dvec2 a, b;
    glm::dvec2 inward;
    double inside, outside;

    Side() = default;
    Side(const glm::dvec2& from, const glm::dvec2& to, double largest)
        : a(from), b(to), inward(a.y - b.y, b.x - a.x) {
      const double offset = glm::dot(inward, a);
      const double margin = 1e-14 * (std::abs(inward.x) + std::abs(inward.y)) * largest;
      inside = offset + margin;
      outside = offset - margin;
    }
    double Depth(const glm::dvec2& p) const { return glm::dot(inward, p); }
  };

  void MakeOctagon() {
    // Extremes of x, x+y, y, y-x, -x, ... in counter-clockwise order.
    std::array<size_t, 8> extreme{};
    std::array<double, 8> best;
    best.fill(-HUGE_VAL);
    for (size_t i = 0; i < points_.size(); ++i) {
      const glm::dvec2 p = points_[i];
      const double keys[4] = {p.x, p.x + p.y, p.y, p.y - p.x};
      largest_ = std::max({largest_, std::abs(p.x), std::abs(p.y)});
      for (size_t k = 0; k < 4; ++k) {
        if (keys[k] > best[k]) best[k] = keys[k], extreme[k] = i;
        if (-keys[k] > best[k + 4]) best[k + 4] = -keys[k], extreme[k + 4] = i;
      }
    }
    for (size_t k = 0; k < 8; ++k) {
      const glm::dvec2 a = points_[extreme[k]];
      const glm::dvec2 b = points_[extreme[(k + 1) % 8]];
      if (a != b) sides_[count_++] = Side(a, b, largest_);
    }
  }

  /// The first side of the octagon that a point is not surely inside of; -1 inside of all.
  int SideOutside(const glm::dvec2& p) const {
    for (size_t k = 0; k < count_; ++k) {
      if (!(sides_[k].Depth(p) > sides_[k].inside)) return static_cast<int>(k);
    }
    // Points on a line have no inside.
    return count_ >= 3 ? -1 : 0;
  }

  void Refine() {
    if (count_ < 3) return;
    std::array<int, kMostSides> farthest;
    std::array<double, kMostSides> least;
    for (size_t k = 0; k < count_; ++k) {
      farthest[k] = -1;
      least[k] = sides_[k].outside;
    }
    for (size_t n = 0; n < outer_.size(); ++n) {
      const auto k = static_cast<size_t>(side_of_[n]);
      const double depth = sides_[k].Depth(points_[static_cast<size_t>(outer_[n])]);
      if (depth < least[k]) least[k] = depth, farthest[k] = outer_[n];
    }
    const std::array<Side, kMostSides> before = sides_;
    std::array<int, kMostSides> first_half;
    const size_t sides = count_;
    count_ = 0;
    for (size_t k = 0; k < sides; ++k) {
      first_half[k] = static_cast<int>(count_);
      if (farthest[k] < 0) {
        sides_[count_++] = before[k];
        continue;
      }
      const glm::dvec2 corner = points_[static_cast<size_t>(farthest[k])];
      sides_[count_++] = Side(before[k].a, corner, largest_);
      sides_[count_++] = Side(corner, before[k].b, largest_);
    }
    size_t kept = 0;
    for (size_t n = 0; n < outer_.size(); ++n) {
      const glm::dvec2 p = points_[static_cast<size_t>(outer_[n])];
      const auto k = static_cast<size_t>(side_of_[n]);
      int side = first_half[k];
      if (farthest[k] >= 0) {
        const Side* halves = &sides_[static_cast<size_t>(side)];
        const bool in_first = halves[0].Depth(p) > halves[0].inside;
        const bool in_second = halves[1].Depth(p) > halves[1].inside;
        // Outside of the old side and inside of both new ones: in their triangle.
        if (in_first && in_second && before[k].Depth(p) < before[k].outside) continue;
        if (in_first) ++side;
      }
      outer_[kept] = outer_[n];
      side_of_[kept] = side;
      ++kept;
    }
    outer_.resize(kept);
    side_of_.resize(kept);
  }

  std::span<const glm::dvec2> points_;
  std::vector<int>& outer_;
  std::vector<int>& side_of_;
  std::array<Side, kMostSides> sides_;
  size_t count_ = 0;
  double largest_ = 0.0;
};

}  // namespace

void ConvexHull2(std::span<const glm::dvec2> points, ConvexHullScratch* scratch, std::vector<int>* hull) {
  std::vector<int>& order = scratch->order;
  order.clear();
  hull->clear();
  const auto at = [points](int i) { return points[static_cast<size_t>(i)]; };
  const int count = static_cast<int>(points.size());
  if (points.size() >= kFilterFrom) {
    OuterPoints(points, &order, &scratch->side_of).Find();
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
