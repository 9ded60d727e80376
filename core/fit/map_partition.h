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
/// Parts are divided one after the other: first those that no single map holds, then, up to
/// `options.most_maps`, the costliest that gains by it. Of the lines through its map (DividingLines), quick
/// fits of both halves, at the texels that they would get (SharesOfTexels), are predicted with the maps that
/// are there (PredictMisclassifiedPixels, and what they may darken of what is lit: FrameSampler::LitSamples);
/// the best line is turned and moved while that helps, and taken where it saves more than kLeastGain. Where
/// planes leave parts that no map holds, the faces of a cube replace them, which hold everything.
MapPartition PartitionMaps(const LightProblem& problem, const DefaultOptions& options);

/// Share of the predicted pixels that a further map must save.
inline constexpr double kLeastGain = 0.03;

}  // namespace shadowfit
