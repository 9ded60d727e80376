#include "core/fit/map_partition.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <numbers>
#include <numeric>
#include <utility>

#include "core/fit/prediction.h"
#include "core/fit/ray_hull.h"
#include "core/math/convex_hull.h"

namespace shadowfit {
namespace {

/// Some of a light's samples, and the best single map of them at the texels of the whole light.
struct Part {
  LightSamples samples;
  SingleMapFit fit;
};

void Copy(const BoundarySamples& from, size_t i, BoundarySamples* to) {
  to->Add(from.Ray(i), from.RayDx1(i), from.RayDx2(i), from.q[i], {from.n1[i], from.n2[i]}, from.length[i]);
}

/// Deals samples out by their rays.
std::vector<LightSamples> Divide(const LightSamples& samples, size_t parts,
                                 const std::function<size_t(const glm::dvec3&)>& part_of) {
  std::vector<LightSamples> divided(parts);
  for (LightSamples& part : divided) {
    part.source = samples.source;
    part.pixels_per_sample = samples.pixels_per_sample;
    part.narrow_share = samples.narrow_share;
  }
  for (size_t i = 0; i < samples.boundary.size(); ++i) {
    Copy(samples.boundary, i, &divided[part_of(samples.boundary.Ray(i))].boundary);
  }
  for (size_t i = 0; i < samples.rough_boundary.size(); ++i) {
    Copy(samples.rough_boundary, i, &divided[part_of(samples.rough_boundary.Ray(i))].rough_boundary);
  }
  for (size_t i = 0; i < samples.hull_rays.size(); ++i) {
    LightSamples& part = divided[part_of(samples.hull_rays[i])];
    part.hull_rays.push_back(samples.hull_rays[i]);
    part.hull_along_ray.push_back(samples.hull_along_ray[i]);
    part.hull_in_shadow.push_back(samples.hull_in_shadow[i]);
    part.hull_rays_dx1.push_back(samples.hull_rays_dx1[i]);
    part.hull_rays_dx2.push_back(samples.hull_rays_dx2[i]);
  }
  return divided;
}

std::vector<LightSamples> DivideByPlane(const LightSamples& samples, const glm::dvec3& covector) {
  return Divide(samples, 2, [&](const glm::dvec3& r) { return size_t{glm::dot(covector, r) > 0.0}; });
}

size_t CubeFace(const glm::dvec3& r) {
  const glm::dvec3 a = glm::abs(r);
  const int axis = a.x >= a.y && a.x >= a.z ? 0 : a.y >= a.z ? 1 : 2;
  return 2 * static_cast<size_t>(axis) + (r[axis] < 0.0 ? 1 : 0);
}

/// The sum over parts of expected misclassified pixels at the best shares of the texels; see the header.
double Total(const std::vector<double>& costs) {
  double sum = 0.0;
  for (const double cost : costs) sum += std::cbrt(cost * cost);
  return sum * std::sqrt(sum);
}

std::vector<double> CostsOf(const std::vector<Part>& parts) {
  std::vector<double> costs;
  costs.reserve(parts.size());
  for (const Part& part : parts) costs.push_back(part.fit.cost);
  return costs;
}

class Partitioner {
 public:
  Partitioner(const LightProblem& problem, const DefaultOptions& options)
      : problem_(problem), options_(options), quick_(options) {
    // Enough to rank divisions; the maps that are kept are fitted in full.
    quick_.search_samples = 160;
    quick_.search_directions = 5;
    quick_.starts = 1;
    quick_.descents = 1;
    quick_.evaluations_per_start = 12;
    quick_.evaluations_per_descent = 0;
    quick_.evaluations_to_polish = 0;
  }

  MapPartition Partition() {
    const SingleMapFit single = Fit(*problem_.samples, problem_.map_size, options_);
    // Without an edge there is nothing to gain.
    const bool has_edges = problem_.samples->source == SampleSource::kShadowBoundary;
    const bool must = options_.divide_where_needed && !single.usable && !problem_.samples->hull_rays.empty();
    const bool may = options_.most_maps > 1 && single.usable && has_edges;
    if (!must && !may) return {{single}};
    std::vector<Part> parts = {{*problem_.samples, single}};
    const auto unusable = [](const Part& part) { return !part.fit.usable; };
    auto most = static_cast<size_t>(options_.most_maps);
    if (must) {
      if (most == 1) most = kMostMaps;
      while (parts.size() < most && std::any_of(parts.begin(), parts.end(), unusable)) {
        if (!DivideWorst(&parts)) break;
      }
    }
    while (has_edges && parts.size() < most && std::none_of(parts.begin(), parts.end(), unusable)) {
      if (!DivideWorst(&parts)) break;
    }
    // Planes one after the other leave long lunes of what surrounds the light: cube faces may do better.
    if (parts.size() > 1 && most == kMostMaps) {
      std::vector<Part> faces = CubeFaces();
      const bool still_unusable = std::any_of(parts.begin(), parts.end(), unusable);
      if (still_unusable || Total(CostsOf(faces)) < Total(CostsOf(parts))) parts = std::move(faces);
    }
    MapPartition partition = Finish(std::move(parts));
    // Divisions are chosen by quick fits of their parts alone; the maps as they are may not keep the promise.
    if (single.complete && has_edges && Predict(partition.maps) > Predict({single}))
      partition.maps = {single};
    return partition;
  }

 private:
  bool Cancelled() const { return problem_.cancellation != nullptr && problem_.cancellation->Requested(); }

  SingleMapFit Fit(const LightSamples& samples, MapSize size, const DefaultOptions& options) {
    LightProblem problem = problem_;
    // The previous frame's map is one of the whole light.
    if (&samples != problem_.samples) problem.previous = nullptr;
    problem.samples = &samples;
    problem.map_size = size;
    SingleMapFit fit = FitSingleMap(problem, options);
    evaluations_ += fit.evaluations;
    return fit;
  }

  /// Covectors of planes to try on a part that no map holds: through the middles of a cube's faces, edges and
  /// corners.
  static std::vector<glm::dvec3> WidePlanes() {
    std::vector<glm::dvec3> planes;
    for (int i = 14; i < 27; ++i)
      planes.push_back(glm::normalize(glm::dvec3(i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1)));
    return planes;
  }

  /// Covectors of the most promising planes through a part that one map holds, best first. In the plane of
  /// the part's own map, whose texels its fit has made as even as it can, a part's cost is about its edges'
  /// cost times the side of the square that holds it: the root of the area of its hull.
  std::vector<glm::dvec3> NarrowPlanes(const Part& part) const {
    const glm::dmat3& texel_from_ray = part.fit.projection.texel_from_ray;
    struct Point {
      glm::dvec2 texel;
      double weight;
    };
    constexpr size_t kMostPoints = 400;
    std::vector<Point> points;
    const auto add = [&](const std::vector<glm::dvec3>& rays, double weight) {
      const size_t stride = rays.size() / kMostPoints + 1;
      for (size_t i = 0; i < rays.size(); i += stride) {
        const glm::dvec3 u = texel_from_ray * rays[i];
        if (u.z > 0.0) points.push_back({glm::dvec2(u) / u.z, weight * static_cast<double>(stride)});
      }
    };
    add(part.samples.hull_rays, 1.0);
    if (points.size() < 8) return {};

    struct Choice {
      double cost;
      glm::dvec3 covector;
    };
    std::vector<Choice> choices;
    constexpr int kDirections = 12;
    std::vector<double> along(points.size());
    std::vector<glm::dvec2> sides[2];
    for (int k = 0; k < kDirections; ++k) {
      const double angle = std::numbers::pi * k / kDirections;
      const glm::dvec2 normal(std::cos(angle), std::sin(angle));
      for (size_t i = 0; i < points.size(); ++i) along[i] = glm::dot(normal, points[i].texel);
      // Offsets even over the extent, which finds gaps, and over the points, which serves wide parts, whose
      // maps hold most of them in a few texels.
      std::vector<double> sorted = along;
      std::sort(sorted.begin(), sorted.end());
      std::vector<double> offsets;
      for (const double share : {0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875}) {
        offsets.push_back(glm::mix(sorted.front(), sorted.back(), share));
      }
      for (const double share : {0.25, 0.5, 0.75}) {
        offsets.push_back(sorted[static_cast<size_t>(share * static_cast<double>(sorted.size()))]);
      }
      for (const double offset : offsets) {
        double weight[2] = {0.0, 0.0};
        for (std::vector<glm::dvec2>& side : sides) side.clear();
        for (size_t i = 0; i < points.size(); ++i) {
          const size_t side = along[i] > offset ? 1 : 0;
          sides[side].push_back(points[i].texel);
          weight[side] += points[i].weight;
        }
        std::vector<double> costs;
        for (size_t side = 0; side < 2; ++side)
          costs.push_back(weight[side] * std::sqrt(HullArea(sides[side])));
        // The line normal . u = offset, as a covector on rays.
        const glm::dvec3 line(normal, -offset);
        choices.push_back({Total(costs), line * texel_from_ray});
      }
    }
    std::sort(choices.begin(), choices.end(),
              [](const Choice& a, const Choice& b) { return a.cost < b.cost; });
    std::vector<glm::dvec3> planes;
    constexpr size_t kMostPlanes = 6;
    for (size_t i = 0; i < std::min(kMostPlanes, choices.size()); ++i) planes.push_back(choices[i].covector);
    return planes;
  }

  static double HullArea(const std::vector<glm::dvec2>& points) {
    const std::vector<int> hull = ConvexHull2(points);
    double area = 1.0;  // A texel: what no map can go below.
    for (size_t i = 2; i < hull.size(); ++i) {
      const glm::dvec2 a = points[static_cast<size_t>(hull[i - 1])] - points[static_cast<size_t>(hull[0])];
      const glm::dvec2 b = points[static_cast<size_t>(hull[i])] - points[static_cast<size_t>(hull[0])];
      area += 0.5 * (a.x * b.y - a.y * b.x);
    }
    return area;
  }

  /// Divides the part that gains most, or that no map holds; false where none gains.
  bool DivideWorst(std::vector<Part>* parts) {
    size_t worst = 0;
    for (size_t i = 1; i < parts->size(); ++i) {
      const Part& part = (*parts)[i];
      const Part& so_far = (*parts)[worst];
      if (part.fit.usable != so_far.fit.usable ? !part.fit.usable : part.fit.cost > so_far.fit.cost)
        worst = i;
    }
    Part& part = (*parts)[worst];
    const bool must = !part.fit.usable;
    std::vector<double> costs = CostsOf(*parts);
    const double before = Total(costs);

    double least = must ? std::numeric_limits<double>::infinity() : before * (1.0 - kLeastGain);
    int most_usable = -1;
    std::vector<Part> best;
    for (const glm::dvec3& plane : must ? WidePlanes() : NarrowPlanes(part)) {
      if (Cancelled()) return false;
      std::vector<LightSamples> halves = DivideByPlane(part.samples, plane);
      if (halves[0].hull_rays.empty() || halves[1].hull_rays.empty()) continue;
      std::vector<Part> tried(2);
      costs[worst] = 0.0;
      std::vector<double> with = costs;
      int usable = 0;
      for (size_t side = 0; side < 2; ++side) {
        tried[side].samples = std::move(halves[side]);
        tried[side].fit = Fit(tried[side].samples, problem_.map_size, quick_);
        with.push_back(tried[side].fit.cost);
        usable += tried[side].fit.usable ? 1 : 0;
      }
      const double total = Total(with);
      if (must ? usable > most_usable || (usable == most_usable && total < least)
               : usable == 2 && total < least) {
        most_usable = usable;
        least = total;
        best = std::move(tried);
      }
    }
    if (best.empty()) return false;
    part = std::move(best[0]);
    parts->push_back(std::move(best[1]));
    return true;
  }

  std::vector<Part> CubeFaces() {
    std::vector<Part> parts;
    for (LightSamples& samples : Divide(*problem_.samples, 6, CubeFace)) {
      if (samples.hull_rays.empty()) continue;
      Part part;
      part.samples = std::move(samples);
      part.fit = Fit(part.samples, problem_.map_size, quick_);
      parts.push_back(std::move(part));
    }
    return parts;
  }

  /// Shares the texels out and fits the parts in full.
  MapPartition Finish(std::vector<Part> parts) {
    MapPartition partition;
    if (parts.size() == 1) {
      partition.maps.push_back(parts[0].fit);
      return partition;
    }
    double sum = 0.0;
    // A part without an edge still needs a map.
    const auto share = [](const Part& part) { return std::cbrt(part.fit.cost * part.fit.cost) + 1e-6; };
    for (const Part& part : parts) sum += share(part);
    for (const Part& part : parts) {
      const double texels = problem_.map_size.texels() * share(part) / sum;
      const double aspect = static_cast<double>(problem_.map_size.width) / problem_.map_size.height;
      MapSize size;
      size.width = std::max(1, static_cast<int>(std::sqrt(texels * aspect)));
      size.height = std::max(1, static_cast<int>(texels / size.width));
      partition.maps.push_back(Fit(part.samples, size, options_));
    }
    Order(&partition.maps);
    partition.maps[0].evaluations +=
        evaluations_ -
        std::accumulate(partition.maps.begin(), partition.maps.end(), 0,
                        [](int total, const SingleMapFit& map) { return total + map.evaluations; });
    return partition;
  }

  double Predict(const std::vector<SingleMapFit>& maps) const {
    std::vector<ShadowProjection> projections;
    projections.reserve(maps.size());
    for (const SingleMapFit& map : maps) projections.push_back(map.projection);
    return PredictMisclassifiedPixels(*problem_.samples, projections);
  }

  /// Puts the maps into the order in which they judge best what several hold: the finest first, then
  /// neighbours change places while that helps. A map's far corners may hold other parts' samples, in texels
  /// much larger than theirs.
  void Order(std::vector<SingleMapFit>* maps) const {
    std::stable_sort(maps->begin(), maps->end(), [](const SingleMapFit& a, const SingleMapFit& b) {
      return a.cost * b.edge_length < b.cost * a.edge_length;
    });
    double least = Predict(*maps);
    for (size_t round = 1; round < maps->size(); ++round) {
      for (size_t i = 0; i + 1 < maps->size(); ++i) {
        std::swap((*maps)[i], (*maps)[i + 1]);
        if (const double predicted = Predict(*maps); predicted < least) {
          least = predicted;
        } else {
          std::swap((*maps)[i], (*maps)[i + 1]);
        }
      }
    }
  }

  const LightProblem& problem_;
  const DefaultOptions& options_;
  DefaultOptions quick_;
  int evaluations_ = 0;
};

}  // namespace

MapPartition PartitionMaps(const LightProblem& problem, const DefaultOptions& options) {
  return Partitioner(problem, options).Partition();
}

}  // namespace shadowfit
