#include "core/fit/dividing_lines.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <span>

#include "core/fit/texel_shares.h"
#include "core/math/convex_hull.h"

namespace shadowfit {
namespace {

constexpr int kDirections = 12;
constexpr double kBetweenDirections = std::numbers::pi / kDirections;
constexpr size_t kMostPromising = 8;
/// Lines of a direction are even over the extent, which finds gaps, and over the points, which serves wide
/// maps, that hold most of them in a few texels.
constexpr int kEvenOffsets = 7;
constexpr std::array<double, 3> kQuantiles = {0.25, 0.5, 0.75};

using Points = std::vector<glm::dvec2>;

Points HullOf(std::span<const glm::dvec2> points) {
  Points hull;
  for (const int i : ConvexHull2(points)) hull.push_back(points[static_cast<size_t>(i)]);
  return hull;
}

double AreaOf(const Points& hull) {
  double area = 1.0;  // A texel: what no map can go below.
  for (size_t i = 2; i < hull.size(); ++i) {
    const glm::dvec2 a = hull[i - 1] - hull[0];
    const glm::dvec2 b = hull[i] - hull[0];
    area += 0.5 * (a.x * b.y - a.y * b.x);
  }
  return area;
}

}  // namespace

struct DividingLines::Choice {
  double cost = std::numeric_limits<double>::infinity();
  DividingLine line;
};

DividingLines::DividingLines(const LightSamples& samples, const glm::dmat3& texel_from_ray)
    : texel_from_ray_(texel_from_ray) {
  constexpr size_t kMostPoints = 400;
  const size_t stride = samples.hull_rays.size() / kMostPoints + 1;
  for (size_t i = 0; i < samples.hull_rays.size(); i += stride) {
    const glm::dvec3 u = texel_from_ray * samples.hull_rays[i];
    if (u.z > 0.0) points_.push_back(glm::dvec2(u) / u.z);
  }
  for (const glm::dvec2& point : points_) middle_ += point / static_cast<double>(points_.size());
}

DividingLines::Choice DividingLines::BestOf(double angle) const {
  Choice best;
  best.line.angle = angle;
  const glm::dvec2 normal = best.line.Normal();
  struct Along {
    double at;
    glm::dvec2 point;
  };
  std::vector<Along> sorted;
  sorted.reserve(points_.size());
  for (const glm::dvec2& point : points_) sorted.push_back({glm::dot(normal, point), point});
  std::sort(sorted.begin(), sorted.end(), [](const Along& a, const Along& b) { return a.at < b.at; });
  Points points;
  points.reserve(sorted.size());
  for (const Along& along : sorted) points.push_back(along.point);

  std::vector<double> offsets;
  for (int i = 1; i <= kEvenOffsets; ++i) {
    offsets.push_back(glm::mix(sorted.front().at, sorted.back().at, i / (kEvenOffsets + 1.0)));
  }
  for (const double share : kQuantiles) {
    offsets.push_back(sorted[static_cast<size_t>(share * static_cast<double>(sorted.size()))].at);
  }
  std::sort(offsets.begin(), offsets.end());
  // Slab k lies between lines k - 1 and k; the hull of all up to a line grows by one slab's hull after the
  // other, from either end.
  const size_t lines = offsets.size();
  std::vector<size_t> first(lines + 2, 0);
  for (size_t k = 0; k < lines; ++k) {
    first[k + 1] = static_cast<size_t>(std::upper_bound(sorted.begin(), sorted.end(), offsets[k],
                                                        [](double at, const Along& a) { return at < a.at; }) -
                                       sorted.begin());
  }
  first[lines + 1] = points.size();
  std::vector<Points> slab_hulls;
  for (size_t k = 0; k <= lines; ++k) {
    slab_hulls.push_back(HullOf({points.data() + first[k], points.data() + first[k + 1]}));
  }
  const auto grow = [&](Points* hull, size_t slab) {
    hull->insert(hull->end(), slab_hulls[slab].begin(), slab_hulls[slab].end());
    *hull = HullOf(*hull);
  };
  std::vector<double> areas_below(lines);
  Points hull;
  for (size_t k = 0; k < lines; ++k) {
    grow(&hull, k);
    areas_below[k] = AreaOf(hull);
  }
  hull.clear();
  for (size_t k = lines; k-- > 0;) {
    grow(&hull, k + 1);
    const auto below = static_cast<double>(first[k + 1]);
    const std::array<double, 2> costs = {
        below * std::sqrt(areas_below[k]),
        (static_cast<double>(points.size()) - below) * std::sqrt(AreaOf(hull))};
    if (const double cost = CostAtBestShares(costs); cost < best.cost) {
      best.cost = cost;
      best.line.offset = offsets[k];
    }
  }
  return best;
}

std::vector<DividingLine> DividingLines::Promising() const {
  constexpr size_t kFewestPoints = 8;
  if (points_.size() < kFewestPoints) return {};
  std::vector<Choice> choices;
  choices.reserve(kDirections);
  for (int k = 0; k < kDirections; ++k) choices.push_back(BestOf(k * kBetweenDirections));
  std::sort(choices.begin(), choices.end(), [](const Choice& a, const Choice& b) { return a.cost < b.cost; });
  std::vector<DividingLine> lines;
  lines.reserve(kMostPromising);
  for (size_t i = 0; i < kMostPromising; ++i) lines.push_back(choices[i].line);
  return lines;
}

std::array<DividingLine, 4> DividingLines::Near(const DividingLine& line, double step) const {
  const glm::dvec2 normal = line.Normal();
  double low = std::numeric_limits<double>::infinity();
  double high = -low;
  for (const glm::dvec2& point : points_) {
    low = std::min(low, glm::dot(normal, point));
    high = std::max(high, glm::dot(normal, point));
  }
  // Turned about the point of the line that is nearest to the middle.
  const glm::dvec2 pivot = middle_ + normal * (line.offset - glm::dot(normal, middle_));
  const auto turned = [&](double by) {
    DividingLine near{line.angle + by, 0.0};
    near.offset = glm::dot(near.Normal(), pivot);
    return near;
  };
  const double turn = step * kBetweenDirections;
  const double shift = step * (high - low) / (kEvenOffsets + 1.0);
  return {turned(-turn), turned(turn), {line.angle, line.offset - shift}, {line.angle, line.offset + shift}};
}

glm::dvec3 DividingLines::Covector(const DividingLine& line) const {
  return glm::dvec3(line.Normal(), -line.offset) * texel_from_ray_;
}

}  // namespace shadowfit
