#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "core/irregular/shadow_masks.h"

namespace shadowfit {

std::vector<uint8_t> KnownAwayFromEdges(std::span<const uint8_t> in_shadow, int width, int height,
                                        int radius) {
  const auto w = static_cast<size_t>(width), h = static_cast<size_t>(height), r = static_cast<size_t>(radius);
  // Separable: the least and the greatest answer within the radius along rows, then along columns.
  std::vector<uint8_t> seen(w * h);  // Bit 0: lit within reach; bit 1: in shadow.
  for (size_t y = 0; y < h; ++y) {
    for (size_t x = 0; x < w; ++x) {
      uint8_t bits = 0;
      const size_t end = std::min(w, x + r + 1);
      for (size_t i = x > r ? x - r : 0; i < end && bits != 3; ++i) bits |= in_shadow[y * w + i] != 0 ? 2 : 1;
      seen[y * w + x] = bits;
    }
  }
  std::vector<uint8_t> known(w * h);
  for (size_t y = 0; y < h; ++y) {
    const size_t first = y > r ? y - r : 0, end = std::min(h, y + r + 1);
    for (size_t i = first; i < end; ++i) {
      for (size_t x = 0; x < w; ++x) known[y * w + x] |= seen[i * w + x];
    }
    for (size_t x = 0; x < w; ++x) {
      uint8_t& value = known[y * w + x];
      if (value == 3) value = static_cast<uint8_t>(KnownShadow::kUnknown);
    }
  }
  return known;
}

}  // namespace shadowfit
