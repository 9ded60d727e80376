#include "core/fit/map_partition.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>
#include <utility>
#include <vector>

#include "core/fit/dividing_lines.h"
#include "core/fit/metric.h"
#include "core/fit/prediction.h"
#include "core/fit/sample_parts.h"
#include "core/fit/texel_shares.h"

namespace shadowfit {
namespace {

/// Some of a light's samples, and the best single map of them at the texels of the whole light.
struct Part {
  LightSamples samples;
  SingleMapFit fit;
};

std::vector<double> CostsOf(const std::vector<Part>& parts) {
  std::vector<double> costs;
  costs.reserve(parts.size());
  for (const Part& part : parts) costs.push_back(part.fit.cost);
  return costs;
}

std::vector<const SingleMapFit*> FitsOf(const std::vector<Part>& parts) {
  std::vector<const SingleMapFit*> fits;
  fits.reserve(parts.size());
  for (const Part& part : parts) fits.push_back(&part.fit);
  return fits;
}

bool IsUnusable(const Part& part) { return !part.fit.usable; }

/// How often the best line is turned and moved.
constexpr int kRefinements = 2;

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
    if (problem_.KnowsShadow()) {
      lit_ = problem_.sampler->LitSamples(*problem_.camera, *problem_.ray_space, problem_.light_in_frame);
    }
    std::vector<Part> parts = {{*problem_.samples, single}};
    auto most = static_cast<size_t>(options_.most_maps);
    if (must) {
      if (most == 1) most = kMostMaps;
      while (parts.size() < most && std::any_of(parts.begin(), parts.end(), IsUnusable)) {
        if (!DivideUnusable(&parts)) break;
      }
    }
    while (has_edges && parts.size() < most && std::none_of(parts.begin(), parts.end(), IsUnusable)) {
      if (!DivideForGain(&parts)) break;
    }
    // Planes one after the other leave long lunes of what surrounds the light: cube faces may do better.
    if (parts.size() > 1 && most == kMostMaps) {
      std::vector<Part> faces = CubeFaces();
      const bool still_unusable = std::any_of(parts.begin(), parts.end(), IsUnusable);
      if (still_unusable || PredictShared(FitsOf(faces)) < PredictShared(FitsOf(parts)))
        parts = std::move(faces);
    }
    MapPartition partition = Finish(std::move(parts));
    // Divisions are chosen by quick fits of their parts alone; the maps as they are may not keep the promise.
    if (single.complete && has_edges && PredictAll(partition.maps) > PredictAll({single}))
      partition.maps = {single};
    return partition;
  }

 private:
  bool Cancelled() const { return IsCancelled(problem_.cancellation); }

  SingleMapFit Fit(const LightSamples& samples, MapSize size, const DefaultOptions& options) {
    LightProblem problem = problem_;
    // The previous frame's map is one of the whole light, and so are the hulls.
    if (&samples != problem_.samples) {
      problem.previous = nullptr;
      problem.hulls = nullptr;
    }
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

  /// The half of a part on either side of a plane, with quick fits.
  using Halves = std::array<Part, 2>;

  /// None where one side is empty.
  std::optional<Halves> TryPlane(const LightSamples& samples, const glm::dvec3& covector) {
    std::vector<LightSamples> divided = DivideByPlane(samples, covector);
    if (divided[0].hull_rays.empty() || divided[1].hull_rays.empty()) return std::nullopt;
    Halves halves;
    for (size_t side = 0; side < 2; ++side) {
      Part& part = halves[side];
      part.samples = std::move(divided[side]);
      part.fit = Fit(part.samples, problem_.map_size, quick_);
    }
    return halves;
  }

  /// Divides the costliest part that no map holds, so that as many halves as possible have one; false where
  /// no plane divides it.
  bool DivideUnusable(std::vector<Part>* parts) {
    const auto part = std::max_element(parts->begin(), parts->end(), [](const Part& a, const Part& b) {
      return std::pair(IsUnusable(a), a.fit.cost) < std::pair(IsUnusable(b), b.fit.cost);
    });
    int most_usable = -1;
    double least = std::numeric_limits<double>::infinity();
    std::optional<Halves> best;
    for (const glm::dvec3& plane : WidePlanes()) {
      if (Cancelled()) return false;
      std::optional<Halves> halves = TryPlane(part->samples, plane);
      if (!halves) continue;
      const auto& [one, other] = *halves;
      const int usable = (one.fit.usable ? 1 : 0) + (other.fit.usable ? 1 : 0);
      const double cost = CostAtBestShares(std::array{one.fit.cost, other.fit.cost});
      if (usable > most_usable || (usable == most_usable && cost < least)) {
        most_usable = usable;
        least = cost;
        best = std::move(halves);
      }
    }
    if (!best) return false;
    *part = std::move(best->front());
    parts->push_back(std::move(best->back()));
    return true;
  }

  /// Divides the costliest part that gains enough by it; false where none does.
  bool DivideForGain(std::vector<Part>* parts) {
    std::stable_sort(parts->begin(), parts->end(),
                     [](const Part& a, const Part& b) { return a.fit.cost > b.fit.cost; });
    for (auto part = parts->begin(); part != parts->end(); ++part) {
      if (DivideForGain(parts, part)) return true;
    }
    return false;
  }

  /// Divides a part where the maps' prediction gains most; false where it gains too little.
  bool DivideForGain(std::vector<Part>* parts, std::vector<Part>::iterator part) {
    std::vector<const SingleMapFit*> fits = {&part->fit};
    for (const Part& other : *parts) {
      if (&other != &*part) fits.push_back(&other.fit);
    }
    double least = (1.0 - kLeastGain) * PredictShared(fits);
    const DividingLines lines(part->samples, part->fit.projection.texel_from_ray);
    fits.push_back(nullptr);
    DividingLine best_line;
    std::optional<Halves> best;
    const auto try_line = [&](const DividingLine& line) {
      if (Cancelled()) return false;
      std::optional<Halves> halves = TryPlane(part->samples, lines.Covector(line));
      if (!halves || std::any_of(halves->begin(), halves->end(), IsUnusable)) return false;
      fits.front() = &halves->front().fit;
      fits.back() = &halves->back().fit;
      const double predicted = PredictShared(fits);
      if (!(predicted < least)) return false;
      least = predicted;
      best_line = line;
      best = std::move(halves);
      return true;
    };
    for (const DividingLine& line : lines.Promising()) try_line(line);
    double step = 0.5;
    for (int round = 0; best && round < kRefinements; ++round) {
      bool improved = false;
      for (const DividingLine& line : lines.Near(best_line, step)) improved |= try_line(line);
      if (!improved) step *= 0.5;
    }
    if (!best || Cancelled()) return false;
    *part = std::move(best->front());
    parts->push_back(std::move(best->back()));
    return true;
  }

  /// What maps of parts get wrong, each fitted at the texels of the whole light, once they share those.
  double PredictShared(const std::vector<const SingleMapFit*>& fits) const {
    std::vector<double> costs;
    costs.reserve(fits.size());
    for (const SingleMapFit* fit : fits) costs.push_back(fit->cost);
    const std::vector<double> shares = SharesOfTexels(costs);
    std::vector<SingleMapFit> maps;
    maps.reserve(fits.size());
    for (size_t i = 0; i < fits.size(); ++i) {
      const double scale = std::sqrt(shares[i]);
      SingleMapFit map = *fits[i];
      map.cost /= scale;
      glm::dmat3 smaller(1.0);
      smaller[0][0] = smaller[1][1] = scale;
      map.projection.texel_from_ray = smaller * map.projection.texel_from_ray;
      map.projection.size.width = std::max(1, static_cast<int>(scale * map.projection.size.width));
      map.projection.size.height = std::max(1, static_cast<int>(scale * map.projection.size.height));
      maps.push_back(map);
    }
    return Order(&maps);
  }

  std::vector<Part> CubeFaces() {
    std::vector<Part> parts;
    for (LightSamples& samples : DivideByCubeFaces(*problem_.samples)) {
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
    const std::vector<double> shares = SharesOfTexels(CostsOf(parts));
    for (size_t i = 0; i < parts.size(); ++i) {
      const double aspect = static_cast<double>(problem_.map_size.width) / problem_.map_size.height;
      const MapSize size = SizeOfTexels(problem_.map_size.texels() * shares[i], aspect);
      partition.maps.push_back(Fit(parts[i].samples, size, options_));
    }
    Order(&partition.maps);
    partition.maps[0].evaluations +=
        evaluations_ -
        std::accumulate(partition.maps.begin(), partition.maps.end(), 0,
                        [](int total, const SingleMapFit& map) { return total + map.evaluations; });
    return partition;
  }

  static std::vector<ShadowProjection> ProjectionsOf(const std::vector<SingleMapFit>& maps) {
    std::vector<ShadowProjection> projections;
    projections.reserve(maps.size());
    for (const SingleMapFit& map : maps) projections.push_back(map.projection);
    return projections;
  }

  double Predict(const std::vector<SingleMapFit>& maps) const {
    const std::vector<ShadowProjection> projections = ProjectionsOf(maps);
    return PredictMisclassifiedPixels(*problem_.samples, projections) + EdgeMetricOfHeld(lit_, projections);
  }

  /// With the shadow that they do not hold.
  double PredictAll(const std::vector<SingleMapFit>& maps) const {
    const std::vector<ShadowProjection> projections = ProjectionsOf(maps);
    return PredictWrongPixels(problem_, projections).Total() + EdgeMetricOfHeld(lit_, projections);
  }

  /// Puts the maps into the order in which they judge best what several hold: the finest first, then
  /// neighbours change places while that helps. A map's far corners may hold other parts' samples, in texels
  /// much larger than theirs. Returns what the maps are predicted to get wrong in that order.
  double Order(std::vector<SingleMapFit>* maps) const {
    std::stable_sort(maps->begin(), maps->end(), [](const SingleMapFit& a, const SingleMapFit& b) {
      return a.cost * b.edge_length < b.cost * a.edge_length;
    });
    double least = Predict(*maps);
    bool improved = true;
    for (size_t round = 1; improved && round < maps->size(); ++round) {
      improved = false;
      for (size_t i = 0; i + 1 < maps->size(); ++i) {
        std::swap((*maps)[i], (*maps)[i + 1]);
        if (const double predicted = Predict(*maps); predicted < least) {
          least = predicted;
          improved = true;
        } else {
          std::swap((*maps)[i], (*maps)[i + 1]);
        }
      }
    }
    return least;
  }

  const LightProblem& problem_;
  const DefaultOptions& options_;
  DefaultOptions quick_;
  BoundarySamples lit_;  ///< A map's far corners may hold them, too, and would darken them.
  int evaluations_ = 0;
};

}  // namespace

MapPartition PartitionMaps(const LightProblem& problem, const DefaultOptions& options) {
  return Partitioner(problem, options).Partition();
}

}  // namespace shadowfit
