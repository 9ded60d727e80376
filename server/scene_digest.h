#pragma once

#include <string>
#include <string_view>

#include "core/cancellation.h"

namespace shadowfit {

/// Whether this is a digest: 64 lower-case hexadecimal digits.
bool IsSceneDigest(std::string_view digest);

/// SHA-256 of `data` in that form. Of a part of it once `cancellation` (may be null) asks.
std::string SceneDigest(std::string_view data, const Cancellation* cancellation = nullptr);

}  // namespace shadowfit
