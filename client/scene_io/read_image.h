#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace shadowfit {

/// Eight bits a channel, channels interleaved, row 0 at the bottom (v = 0).
struct Image8 {
  int width = 0;
  int height = 0;
  int channels = 0;  ///< 1 grey, 2 grey and alpha, 3 RGB, 4 RGB and alpha.
  std::vector<uint8_t> values;

  bool has_alpha() const { return channels == 2 || channels == 4; }
  const uint8_t* Pixel(size_t i) const { return values.data() + i * static_cast<size_t>(channels); }
  size_t pixels() const { return static_cast<size_t>(width) * static_cast<size_t>(height); }
};

/// Any picture that OpenImageIO reads; colour is not multiplied by alpha.
absl::StatusOr<Image8> ReadImage8(const std::filesystem::path& file);

/// The same from memory. `name` ends in the format's extension, as "texture.png".
absl::StatusOr<Image8> ReadImage8(std::span<const std::byte> bytes, const std::string& name);

}  // namespace shadowfit
