#include "client/cli/mask_picture.h"

#include <OpenImageIO/imageio.h>

#include <cstdint>
#include <memory>
#include <vector>

#include "absl/strings/str_format.h"
#include "client/mask_bits.h"

namespace shadowfit {

absl::Status WriteMaskPicture(const std::filesystem::path& file, const v1::MaskResult& result,
                              const v1::LightMask& mask) {
  const auto width = static_cast<size_t>(result.width()), height = static_cast<size_t>(result.height());
  const int channels = mask.rgb().empty() ? 1 : 3;
  std::vector<uint8_t> pixels;
  if (channels == 3) {
    pixels.assign(mask.rgb().begin(), mask.rgb().end());
  } else {
    for (size_t y = 0; y < height; ++y) {
      for (size_t x = 0; x < width; ++x) {
        pixels.push_back(MaskBit(mask, static_cast<int>(width), x, y) ? 255 : 0);
      }
    }
  }
  const std::unique_ptr<OIIO::ImageOutput> output = OIIO::ImageOutput::create(file.string());
  if (!output) return absl::UnavailableError(absl::StrFormat("%s: %s", file.string(), OIIO::geterror()));
  const OIIO::ImageSpec spec(static_cast<int>(width), static_cast<int>(height), channels,
                             OIIO::TypeDesc::UINT8);
  // Frames from files have their top row first, as pictures do.
  if (!output->open(file.string(), spec) || !output->write_image(OIIO::TypeDesc::UINT8, pixels.data()) ||
      !output->close()) {
    return absl::UnavailableError(absl::StrFormat("%s: %s", file.string(), output->geterror()));
  }
  return absl::OkStatus();
}

}  // namespace shadowfit
