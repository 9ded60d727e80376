#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace shadowfit {

/// Depth samples of other encodings as float32. Exact: each result is the float nearest to the encoded value,
/// the largest unorm value is 1. `out` holds as many samples as `in`.
void DepthFromFloat16(std::span<const uint16_t> in, float* out);
void DepthFromUnorm16(std::span<const uint16_t> in, float* out);
/// The high byte of each sample is ignored.
void DepthFromUnorm24(std::span<const uint32_t> in, float* out);

}  // namespace shadowfit
