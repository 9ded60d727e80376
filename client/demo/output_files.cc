#include "client/demo/output_files.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

#include <fstream>
#include <memory>
#include <vector>

#include "absl/strings/str_format.h"

namespace shadowfit {
namespace {

absl::Status Write(OIIO::ImageOutput* output, const std::string& name, const OIIO::ImageSpec& spec,
                   const Picture& picture) {
  if (!output->open(name, spec))
    return absl::UnavailableError(absl::StrFormat("%s: %s", name, output->geterror()));
  // Files begin with the top row, pictures with the bottom one.
  const OIIO::stride_t row_bytes = OIIO::stride_t{3} * picture.width;
  const uint8_t* top_row = picture.rgb.data() + row_bytes * (picture.height - 1);
  if (!output->write_image(OIIO::TypeDesc::UINT8, top_row, OIIO::AutoStride, -row_bytes) ||
      !output->close()) {
    return absl::UnavailableError(absl::StrFormat("%s: %s", name, output->geterror()));
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status MakeFolder(const std::filesystem::path& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) return absl::UnavailableError(absl::StrFormat("%s: %s", folder.string(), error.message()));
  return absl::OkStatus();
}

absl::Status WriteText(const std::filesystem::path& file, const std::string& text) {
  std::ofstream stream(file, std::ios::binary);
  stream << text;
  if (!stream.flush()) return absl::UnavailableError(absl::StrFormat("%s: cannot be written", file.string()));
  return absl::OkStatus();
}

absl::Status WritePng(const std::filesystem::path& file, const Picture& picture) {
  const std::unique_ptr<OIIO::ImageOutput> output = OIIO::ImageOutput::create(file.string());
  if (!output) return absl::UnavailableError(absl::StrFormat("%s: %s", file.string(), OIIO::geterror()));
  OIIO::ImageSpec spec(picture.width, picture.height, 3, OIIO::TypeDesc::UINT8);
  spec.attribute("png:compressionLevel",
                 3);  // A third of the time of the default for a few per cent of size.
  return Write(output.get(), file.string(), spec, picture);
}

absl::StatusOr<std::string> EncodeJpeg(const Picture& picture) {
  const std::unique_ptr<OIIO::ImageOutput> output = OIIO::ImageOutput::create("jpeg");
  if (!output) return absl::UnavailableError(absl::StrFormat("JPEG: %s", OIIO::geterror()));
  std::vector<unsigned char> bytes;
  OIIO::Filesystem::IOVecOutput memory(bytes);
  if (!output->set_ioproxy(&memory)) return absl::UnavailableError("JPEG: cannot be written to memory");
  OIIO::ImageSpec spec(picture.width, picture.height, 3, OIIO::TypeDesc::UINT8);
  spec.attribute("Compression", "jpeg:88");
  if (absl::Status status = Write(output.get(), "picture.jpg", spec, picture); !status.ok()) return status;
  return std::string(bytes.begin(), bytes.end());
}

}  // namespace shadowfit
