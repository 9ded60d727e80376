#pragma once

#include <span>

#include "core/fit/light_problem.h"
#include "core/fit/options.h"
#include "core/fit/prediction.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

struct TrimmedShadow {
  PredictedPixels predicted;  ///< Of the maps as they are now.
  int evaluations = 0;        ///< Of the objective.
};

/// Lets go of shadow where that is predicted to pay: a few far pixels, or one, may stretch a map so much that
/// all others' edges are the worse for it, and shown lit they are a few wrong pixels and no more.
///
/// Changes a light's maps, which the default method made, in place, one after the other. Each of a map's
/// sides is moved inwards over the samples in shadow nearest to it. By the metric's slope along the map's
/// width a cut of the share c saves about c times the pixels that texels of this width cost, and it costs the
/// pixels of the shadow that end outside. The best cut is made, a map fitted to what is left
/// (RefitSingleMap()), and kept where the frame says that fewer pixels are wrong (PredictWrongPixels()); and
/// again, until no cut is. Of several maps the first that holds a sample has it; what a map lets go of,
/// others may hold.
///
/// `problem.sampler` must be given.
TrimmedShadow TrimShadow(const LightProblem& problem, const DefaultOptions& options,
                         std::span<ShadowProjection> maps);

}  // namespace shadowfit
