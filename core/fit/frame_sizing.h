#pragma once

#include <span>
#include <vector>

#include "absl/status/status.h"
#include "core/budget/atlas.h"
#include "core/budget/map_sizing.h"
#include "core/fit/light_problem.h"

namespace shadowfit {

/// One light of a frame whose maps' sizes are to be chosen.
struct SizedLight {
  LightProblem problem;  ///< With the requested size.
  double weight = 1.0;
  LightFit fit;                                ///< Of the requested size; then of the chosen one.
  std::vector<AtlasPosition> atlas_positions;  ///< Of its maps, where there is an atlas.
};

/// InvalidArgument where the options mean nothing, whatever the lights; the message begins with the field, as
/// "options.texel_budget.total_texels".
absl::Status CheckSizing(const MapSizing& sizing);

/// Gives every light the size that the options ask for: its prediction at the requested size says how many
/// wrong pixels it has at any. The fit is scaled where the aspect ratio stays, and made anew by `method`
/// where rounding changes it. `edges_known`: the frame has shadow bits; lights without a shadow edge then get
/// the least size.
absl::Status SizeMaps(const MapSizing& sizing, const LightMatrixMethod& method, bool edges_known,
                      std::span<SizedLight> lights);

}  // namespace shadowfit
