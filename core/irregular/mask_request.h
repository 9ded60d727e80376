#pragma once

#include "absl/status/status.h"
#include "core/irregular/shadow_masks.h"

namespace shadowfit::irregular {

/// InvalidArgument names the field that is wrong. Lights are checked where they are used.
absl::Status CheckRequest(const MaskRequest& request);

}  // namespace shadowfit::irregular
