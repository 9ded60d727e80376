#include "server/frame_worker.h"

#include <algorithm>

#include "server/errors.h"
#include "server/result_encoder.h"

namespace shadowfit {

absl::Status FrameWorker::Answer(const v1::Frame* frame, const JobContext& job, v1::FrameResult* result) {
  if (frame == nullptr) return WithFieldViolation(absl::InvalidArgumentError("frame: missing"), "frame");
  return WithFieldViolation(Optimize(*frame, job, result), "frame");
}

absl::Status FrameWorker::Optimize(const v1::Frame& frame, const JobContext& job, v1::FrameResult* result) {
  if (absl::Status status = decoder_.Decode(frame, &request_, &options_); !status.ok()) return status;
  if (memory_ == Memory::kLastFrame) Recall();
  if (absl::Status status = optimizer_.Optimize(request_, options_, job.cancellation, &summary_);
      !status.ok()) {
    return status;
  }
  if (memory_ == Memory::kLastFrame) Remember();
  EncodeResult(frame.frame_id(), summary_, job.queue_seconds, result);
  return absl::OkStatus();
}

void FrameWorker::Recall() {
  // A matrix means something in its own clip convention only.
  if (request_.output_clip_depth != last_clip_depth_) return;
  for (LightRequest& light : request_.lights) {
    if (light.previous_clip_from_world) continue;
    const auto found = std::find_if(last_.begin(), last_.end(),
                                    [&light](const LastMatrix& last) { return last.id == light.id; });
    if (found != last_.end()) light.previous_clip_from_world = found->clip_from_world;
  }
}

void FrameWorker::Remember() {
  last_clip_depth_ = request_.output_clip_depth;
  last_.clear();
  for (const LightSummary& light : summary_.lights) last_.push_back({light.id, light.clip_from_world});
}

}  // namespace shadowfit
