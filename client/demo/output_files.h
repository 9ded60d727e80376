#pragma once

#include <filesystem>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/render/picture_pass.h"

namespace shadowfit {

/// Makes a folder and those above it.
absl::Status MakeFolder(const std::filesystem::path& folder);

absl::Status WriteText(const std::filesystem::path& file, const std::string& text);

absl::Status WritePng(const std::filesystem::path& file, const Picture& picture);

/// A JPEG file's bytes.
absl::StatusOr<std::string> EncodeJpeg(const Picture& picture);

}  // namespace shadowfit
