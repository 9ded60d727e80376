#pragma once

#include "core/irregular/shadow_masks.h"
#include "server/idle_pool.h"

namespace shadowfit {

/// The mask renderers of all calls and streams.
using MaskRenderers = IdlePool<MaskRenderer>;

}  // namespace shadowfit
