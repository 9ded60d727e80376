#include "core/budget/atlas.h"

#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wunused-function"
#define STBRP_STATIC
#define STB_RECT_PACK_IMPLEMENTATION
#include <stb/stb_rect_pack.h>
#pragma GCC diagnostic pop

namespace shadowfit {

std::optional<std::vector<AtlasPosition>> PackAtlas(std::span<const MapSize> maps, MapSize atlas) {
  std::vector<stbrp_rect> rectangles(maps.size());
  for (size_t i = 0; i < maps.size(); ++i) {
    rectangles[i].w = maps[i].width;
    rectangles[i].h = maps[i].height;
  }
  // As many nodes as the atlas is wide: the packer then need not round widths up.
  std::vector<stbrp_node> nodes(static_cast<size_t>(atlas.width));
  stbrp_context context;
  stbrp_init_target(&context, atlas.width, atlas.height, nodes.data(), atlas.width);
  if (stbrp_pack_rects(&context, rectangles.data(), static_cast<int>(rectangles.size())) == 0) {
    return std::nullopt;
  }
  std::vector<AtlasPosition> positions;
  positions.reserve(rectangles.size());
  for (const stbrp_rect& rectangle : rectangles) positions.push_back({rectangle.x, rectangle.y});
  return positions;
}

}  // namespace shadowfit
