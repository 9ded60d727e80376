#pragma once

#include <cstdint>

#include "core/fit/frame_optimizer.h"
#include "shadowfit/v1/frame.pb.h"

namespace shadowfit {

/// Fills `result`, whatever it held before, with the answer to frame `frame_id`.
void EncodeResult(uint64_t frame_id, const FrameSummary& summary, double queue_seconds,
                  v1::FrameResult* result);

}  // namespace shadowfit
