#include "client/scene_io/read_image.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

#include <algorithm>
#include <memory>

#include "absl/strings/str_format.h"

namespace shadowfit {
namespace {

/// Larger pictures are refused before their pixels are allocated.
constexpr int kMaxSide = 16384;

absl::StatusOr<Image8> ReadAll(OIIO::ImageInput* input, const std::string& name) {
  const OIIO::ImageSpec& spec = input->spec();
  if (spec.width < 1 || spec.height < 1 || spec.width > kMaxSide || spec.height > kMaxSide) {
    return absl::InvalidArgumentError(absl::StrFormat("%s: %dx%d pixels, 1 to %d a side are accepted", name,
                                                      spec.width, spec.height, kMaxSide));
  }
  Image8 image;
  image.width = spec.width;
  image.height = spec.height;
  image.channels = std::min(spec.nchannels, 4);
  image.values.resize(image.pixels() * static_cast<size_t>(image.channels));
  const OIIO::stride_t row_bytes = static_cast<OIIO::stride_t>(image.width) * image.channels;
  // Starting at the last row with a negative stride turns the file's top-first rows over.
  uint8_t* last_row = image.values.data() + row_bytes * (image.height - 1);
  if (!input->read_image(0, 0, 0, image.channels, OIIO::TypeDesc::UINT8, last_row, OIIO::AutoStride,
                         -row_bytes)) {
    return absl::InvalidArgumentError(absl::StrFormat("%s: %s", name, input->geterror()));
  }
  return image;
}

OIIO::ImageSpec UnassociatedAlpha() {
  OIIO::ImageSpec config;
  config.attribute("oiio:UnassociatedAlpha", 1);
  return config;
}

}  // namespace

absl::StatusOr<Image8> ReadImage8(const std::filesystem::path& file) {
  const OIIO::ImageSpec config = UnassociatedAlpha();
  const std::unique_ptr<OIIO::ImageInput> input = OIIO::ImageInput::open(file.string(), &config);
  if (!input) return absl::InvalidArgumentError(absl::StrFormat("%s: %s", file.string(), OIIO::geterror()));
  return ReadAll(input.get(), file.string());
}

absl::StatusOr<Image8> ReadImage8(std::span<const std::byte> bytes, const std::string& name) {
  OIIO::Filesystem::IOMemReader memory(const_cast<std::byte*>(bytes.data()), bytes.size());
  const OIIO::ImageSpec config = UnassociatedAlpha();
  const std::unique_ptr<OIIO::ImageInput> input = OIIO::ImageInput::open(name, &config, &memory);
  if (!input) return absl::InvalidArgumentError(absl::StrFormat("%s: %s", name, OIIO::geterror()));
  return ReadAll(input.get(), name);
}

}  // namespace shadowfit
