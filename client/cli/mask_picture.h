#pragma once

#include <filesystem>

#include "absl/status/status.h"
#include "shadowfit/v1/mask.pb.h"

namespace shadowfit {

/// Writes one light's mask of the first layer: 0 = lit, 255 = in shadow; or, where the mask has it, RGB of
/// the light that arrives. Rows in the order of the frame's: the top one first in files.
absl::Status WriteMaskPicture(const std::filesystem::path& file, const v1::MaskResult& result,
                              const v1::LightMask& mask);

}  // namespace shadowfit
