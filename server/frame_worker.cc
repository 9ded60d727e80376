#include "server/frame_worker.h"

#include <algorithm>

#include "server/errors.h"
#include "server/mask_decoder.h"
#include "server/result_encoder.h"

namespace shadowfit {

absl::Status FrameWorker::Answer(const v1::Frame* frame, const JobContext& job, v1::FrameResult* result) {
  if (frame == nullptr) return WithFieldViolation(absl::InvalidArgumentError("frame: missing"), "frame");
  return WithFieldViolation(Optimize(*frame, job, result), "frame");
}

absl::Status FrameWorker::Optimize(const v1::Frame& frame, const JobContext& job, v1::FrameResult* result) {
  if (absl::Status status = decoder_.Decode(frame, &request_, &options_); !status.ok()) return status;
  if (!request_.bits && !frame.scene_digest().empty()) {
    if (absl::Status status = RenderBits(frame, job); !status.ok()) return status;
  }
  if (memory_ == Memory::kLastFrame) Recall();
  if (absl::Status status = optimizer_.Optimize(request_, options_, job.cancellation, &summary_);
      !status.ok()) {
    return status;
  }
  if (memory_ == Memory::kLastFrame) Remember();
  EncodeResult(frame.frame_id(), summary_, job.queue_seconds, result);
  return absl::OkStatus();
}

absl::Status FrameWorker::RenderBits(const v1::Frame& frame, const JobContext& job) {
  absl::StatusOr<SceneStore::Handle> scene = FindScene(scenes_, frame.scene_digest());
  if (!scene.ok()) return scene.status();
  const absl::StatusOr<Camera> camera = Camera::Create(request_.camera);
  if (!camera.ok()) return absl::OkStatus();  // The optimizer says what is wrong with it.
  std::vector<Light> lights;
  lights.reserve(request_.lights.size());
  for (const LightRequest& light : request_.lights) lights.push_back(light.light);
  ReceiverLayer layer;
  layer.depth = request_.depth;
  MaskRequest masks_request;
  masks_request.scene = &(*scene)->scene;
  masks_request.camera = &*camera;
  masks_request.layers = {&layer, 1};
  masks_request.lights = lights;
  masks_request.depth_precision = PrecisionOf(frame.depth().encoding());
  masks_request.cancellation = &job.cancellation;
  const MaskRenderers::Lease renderer = renderers_.Take();
  const auto masks = renderer->Render(masks_request);
  if (!masks.ok()) return masks.status();
  const int width = request_.depth.width, height = request_.depth.height;
  rendered_bits_.assign(static_cast<size_t>(width) * static_cast<size_t>(height), 0);
  for (size_t light = 0; light < masks->size(); ++light) {
    for (int y = 0; y < height; ++y) {
      uint32_t* row = rendered_bits_.data() + static_cast<size_t>(y) * static_cast<size_t>(width);
      for (int x = 0; x < width; ++x) {
        row[x] |= static_cast<uint32_t>((*masks)[light].InShadow(0, height, x, y)) << light;
      }
    }
  }
  request_.bits = BottomFirst(rendered_bits_.data(), width, height);
  return absl::OkStatus();
}

void FrameWorker::Recall() {
  // A matrix means something in its own clip convention only.
  if (request_.output_clip_depth != last_clip_depth_) return;
  for (LightRequest& light : request_.lights) {
    if (light.previous_clip_from_world) continue;
    const auto found = std::find_if(last_.begin(), last_.end(),
                                    [&light](const LastMatrix& last) { return last.id == light.id; });
    if (found == last_.end()) continue;
    light.previous_clip_from_world = found->clip_from_world;
    light.previous_map_size = found->size;
  }
}

void FrameWorker::Remember() {
  last_clip_depth_ = request_.output_clip_depth;
  last_.clear();
  for (const LightSummary& light : summary_.lights) {
    last_.push_back({light.id, light.clip_from_world, light.projection.size});
  }
}

}  // namespace shadowfit
