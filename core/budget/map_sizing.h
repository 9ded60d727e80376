#pragma once

#include <optional>
#include <variant>

#include "core/math/shadow_projection.h"

namespace shadowfit {

/// Texels a side.
inline constexpr int kMaxMapSize = 65536;

/// Lengths that a map's sides may have.
struct SideLimits {
  int min_side = 16;    ///< Texels; rounded up to an allowed length.
  int max_side = 8192;  ///< Texels; rounded down to an allowed length.
  SizeRounding rounding = SizeRounding::kExact;
};

/// Share a number of texels among the lights of a frame, so that the fewest wrong pixels are predicted.
struct BudgetOptions {
  double total_texels = 0.0;  ///< Of all maps. 0: those of the atlas.
  SideLimits sides;
  /// Lay the maps out in one texture of this size. The maps then hold together at most as many texels as can
  /// be packed into it.
  std::optional<MapSize> atlas;
};

/// Give each light the smallest map that is expected to hold a number of wrong pixels.
struct ToleranceOptions {
  double max_misclassified_pixels = 0.0;  ///< Of each light, divided by the light's weight.
  SideLimits sides;
};

/// How the sizes of a frame's maps are chosen: as requested, by budget or by tolerance. The requested sizes
/// give the maps' aspect ratios in any case, as far as rounding allows.
using MapSizing = std::variant<std::monostate, BudgetOptions, ToleranceOptions>;

}  // namespace shadowfit
