#pragma once

#include <cstddef>
#include <cstdint>

#include "shadowfit/v1/mask.pb.h"

namespace shadowfit {

/// Bytes of a row of LightMask.bits.
inline size_t MaskRowBytes(int width) { return (static_cast<size_t>(width) + 7) / 8; }

/// Whether a pixel is in shadow; `row` counts in the order of the bits, layer after layer. The bits must be
/// as many as the width and the row ask for.
inline bool MaskBit(const v1::LightMask& mask, int width, size_t x, size_t row) {
  const auto byte = static_cast<uint8_t>(mask.bits()[row * MaskRowBytes(width) + x / 8]);
  return (byte >> (x % 8) & 1) != 0;
}

}  // namespace shadowfit
