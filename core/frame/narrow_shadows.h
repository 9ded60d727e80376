#pragma once

#include "core/frame/pixel_scan.h"

namespace shadowfit {

/// Of the runs of one light's shadow along rows and columns of the picture, the share in [0,1] that is a
/// single pixel long; 0 without shadow. Rows and columns end runs. `visible` says where there is a surface at
/// all: bits elsewhere mean nothing.
double NarrowShare(const PackedBits& visible, const PackedBits& shadow);

}  // namespace shadowfit
