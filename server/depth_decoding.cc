#include "server/depth_decoding.h"

#include <bit>

namespace shadowfit {

// Plain loops without branches: compilers vectorise them for any processor, and memory bounds them.

void DepthFromFloat16(std::span<const uint16_t> in, float* out) {
  // Moved into place, exponent and mantissa read as a float32 whose exponent is too small by 127 - 15; a
  // product with 2^112 repairs that exactly, for numbers below the smallest normal one too. Infinities and
  // NaN keep an exponent of all ones.
  constexpr uint32_t kExponentOnes = 0x7F800000;
  const float scale = std::bit_cast<float>(uint32_t{127 + 112} << 23);
  for (size_t i = 0; i < in.size(); ++i) {
    const uint32_t half = in[i];
    const uint32_t magnitude = (half & 0x7FFFU) << 13;
    const uint32_t finite = std::bit_cast<uint32_t>(std::bit_cast<float>(magnitude) * scale);
    const uint32_t bits = (half & 0x7C00U) == 0x7C00U ? magnitude | kExponentOnes : finite;
    out[i] = std::bit_cast<float>(bits | (half & 0x8000U) << 16);
  }
}

void DepthFromUnorm16(std::span<const uint16_t> in, float* out) {
  for (size_t i = 0; i < in.size(); ++i) out[i] = static_cast<float>(in[i]) / 65535.0F;
}

void DepthFromUnorm24(std::span<const uint32_t> in, float* out) {
  for (size_t i = 0; i < in.size(); ++i) {
    out[i] = static_cast<float>(static_cast<int32_t>(in[i] & 0xFFFFFFU)) / 16777215.0F;
  }
}

}  // namespace shadowfit
