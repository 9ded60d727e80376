#pragma once

#include "core/fit/light_problem.h"
#include "core/fit/options.h"
#include "core/fit/ray_hull.h"

namespace shadowfit {

/// The best single map of a light, and what it costs.
struct SingleMapFit {
  ShadowProjection projection;
  /// The pixels that edges are displaced by, rough samples weighted. Proportional to 1 / sqrt(texels).
  double cost = 0.0;
  /// Length of edge that the cost counts, in pixels; cost / length is how far a typical edge is displaced.
  double edge_length = 0.0;
  bool complete = true;  ///< False where no single map holds all rays; see RayHull::complete.
  /// False also where the map that does has texels of too different widths to be of use: receivers span
  /// nearly half of all directions.
  bool usable = true;
  bool kept_previous = false;  ///< Whether the map is the previous frame's, as it is or rescaled.
  int evaluations = 0;
};

/// The hull of what the map must hold, with the samples' footprints where one map holds those too, and the
/// best map around it (AxisSearch); or the previous frame's map, as it is or rescaled, see
/// DefaultOptions::keep_within. The cost is what the search saw of new ones even then. Where a first look at
/// DefaultOptions::glance_samples says that the previous map may stay, there is no search, and all but the
/// map is left unsaid.
SingleMapFit FitSingleMap(const LightProblem& problem, const DefaultOptions& options);

/// The best map in the valley of `problem.previous`, which must be given and is near it: a descent without a
/// search.
SingleMapFit RefitSingleMap(const LightProblem& problem, const DefaultOptions& options);

}  // namespace shadowfit
