#pragma once

#include <vector>

#include "core/fit/light_problem.h"
#include "core/fit/options.h"
#include "core/fit/single_map_fit.h"

namespace shadowfit {

/// The maps of a light, in the order in which they are asked.
struct MapPartition {
  std::vector<SingleMapFit> maps;  ///< Never empty.
};

/// Divides a light's rays by planes through the light, and gives each part its own map.
///
/// A part's expected misclassified pixels at t texels are c / sqrt(t). At a total of T texels, the sum over
/// parts is least where the derivatives c_k / t_k^(3/2) are equal, so t_k is proportional to c_k^(2/3) and
/// the sum is
///
///   (sum c_k^(2/3))^(3/2) / sqrt(T).
///
/// Parts are divided one after the other: first those that no single map holds, then, up to
/// `options.most_maps`, those where this sum falls by more than kLeastGain. Where planes leave parts that no
/// map holds, the faces of a cube replace them, which hold everything.
MapPartition PartitionMaps(const LightProblem& problem, const DefaultOptions& options);

/// Share of the predicted pixels that a further map must save.
inline constexpr double kLeastGain = 0.03;

}  // namespace shadowfit
