#include "core/frame/narrow_shadows.h"

#include <bit>
#include <cstring>

namespace shadowfit {
namespace {

/// Pixels in shadow, 64 from the beginning of a byte on, the first one lowest; those of the rim are zero.
struct Pixels {
  const PackedBits& visible;
  const PackedBits& shadow;

  uint64_t operator()(std::ptrdiff_t byte) const { return Word(visible, byte) & Word(shadow, byte); }
  uint64_t Byte(std::ptrdiff_t byte) const {
    return uint64_t{visible.bytes[static_cast<size_t>(byte)]} & shadow.bytes[static_cast<size_t>(byte)];
  }

  static uint64_t Word(const PackedBits& packed, std::ptrdiff_t byte) {
    static_assert(std::endian::native == std::endian::little);
    uint64_t word = 0;
    std::memcpy(&word, packed.bytes.data() + byte, sizeof(word));
    return word;
  }
};

}  // namespace

double NarrowShare(const PackedBits& visible, const PackedBits& shadow) {
  const Pixels pixels{visible, shadow};
  const std::ptrdiff_t row_bytes = shadow.stride / 8;
  int runs = 0;
  int narrow = 0;
  for (int y = 0; y < shadow.height; ++y) {
    const std::ptrdiff_t row = ((y + PixelPlanes::kRimRows) * shadow.stride + PixelPlanes::kRimColumns) / 8;
    for (int x = 0; x < shadow.width; x += 64) {
      const std::ptrdiff_t byte = row + x / 8;
      const uint64_t word = pixels(byte);
      uint64_t here = word;
      // Beyond the row there is the next one.
      if (x + 64 > shadow.width) here &= (uint64_t{1} << (shadow.width - x)) - 1;
      if (here == 0) continue;
      const uint64_t left = here << 1 | pixels.Byte(byte - 1) >> 7;
      const uint64_t right = word >> 1 | pixels.Byte(byte + 8) << 63;
      const uint64_t below = pixels(byte - row_bytes);
      const uint64_t above = pixels(byte + row_bytes);
      runs += std::popcount(here & ~left) + std::popcount(here & ~below);
      narrow += std::popcount(here & ~left & ~right) + std::popcount(here & ~below & ~above);
    }
  }
  return runs > 0 ? static_cast<double>(narrow) / runs : 0.0;
}

}  // namespace shadowfit
