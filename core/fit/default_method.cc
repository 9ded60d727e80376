#include "core/fit/default_method.h"

#include "core/fit/map_partition.h"
#include "core/fit/partial_map.h"
#include "core/fit/ray_hull.h"

namespace shadowfit {

absl::StatusOr<LightFit> DefaultMethod::Fit(const LightProblem& given_problem) const {
  // No hulls take longer than those that are not complete, and FitPartialMap's baselines ask for the same.
  RayHulls hulls;
  LightProblem problem = given_problem;
  problem.hulls = &hulls;
  const MapPartition partition = PartitionMaps(problem, options_);
  LightFit fit;
  fit.projection = partition.maps[0].projection;
  if (partition.maps[0].kept_previous) fit.outcome = FitOutcome::kKeptPrevious;
  for (const SingleMapFit& map : partition.maps) {
    fit.evaluations += map.evaluations;
    if (&map != &partition.maps[0]) fit.further_projections.push_back(map.projection);
    if (map.complete) continue;
    fit.outcome = FitOutcome::kFallback;
    fit.note =
        "receivers span a half space or more as seen from the light; the map holds a part of the shadow";
  }
  if (partition.maps.size() == 1 && !partition.maps[0].complete && problem.KnowsShadow()) {
    const PartialMap partial = FitPartialMap(problem, options_, fit.projection);
    fit.projection = partial.projection;
    fit.evaluations += partial.evaluations;
  }
  return fit;
}

}  // namespace shadowfit
