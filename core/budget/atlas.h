#pragma once

#include <optional>
#include <span>
#include <vector>

#include "core/math/shadow_projection.h"

namespace shadowfit {

/// Where a map begins in a texture, in texels from the corner where both texture coordinates are 0.
struct AtlasPosition {
  int x = 0;
  int y = 0;
  friend bool operator==(const AtlasPosition&, const AtlasPosition&) = default;
};

/// Places maps side by side, not overlapping and not turned, in a texture of `atlas` texels (stb_rect_pack's
/// skyline); none where they do not fit. Deterministic.
std::optional<std::vector<AtlasPosition>> PackAtlas(std::span<const MapSize> maps, MapSize atlas);

}  // namespace shadowfit
