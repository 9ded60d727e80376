#include "server/mask_worker.h"

#include <chrono>
#include <cstring>
#include <span>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/errors.h"

namespace shadowfit {
namespace {

/// Copies `blocks` pictures of `height` rows, whose row 0 is at the bottom.
void EncodeRows(std::span<const uint8_t> rows, size_t pitch, size_t row_bytes, size_t height, size_t blocks,
                bool top_first, std::string* out) {
  out->resize(blocks * height * row_bytes);
  for (size_t i = 0; i < blocks * height; ++i) {
    const size_t block = i / height, y = i % height;
    const size_t from = block * height + (top_first ? height - 1 - y : y);
    std::memcpy(out->data() + i * row_bytes, rows.data() + from * pitch, row_bytes);
  }
}

void EncodeMask(const LightMask& mask, const DecodedMaskFrame& frame, v1::LightMask* out) {
  const auto width = static_cast<size_t>(frame.layers[0].depth.width);
  const auto height = static_cast<size_t>(frame.layers[0].depth.height);
  const size_t layers = frame.layers.size();
  out->clear_bits();
  out->clear_rgb();
  out->clear_coverage();
  if (frame.output == MaskOutput::kCoverage) {
    EncodeRows(mask.coverage, width, width, height, 1, frame.top_first, out->mutable_coverage());
  } else {
    EncodeRows(mask.bits, mask.bytes_per_row, (width + 7) / 8, height, layers, frame.top_first,
               out->mutable_bits());
  }
  if (frame.output == MaskOutput::kTransmittance) {
    EncodeRows(mask.rgb, 3 * width, 3 * width, height, layers, frame.top_first, out->mutable_rgb());
  }
  out->set_samples(mask.samples);
  out->set_shadowed_samples(mask.shadowed_samples);
  out->set_undecided_samples(mask.undecided_samples);
  out->set_facing_away_samples(mask.facing_away_samples);
  out->set_known_samples(mask.known_samples);
  out->set_outside_cone_samples(mask.outside_cone_samples);
  out->set_seconds(1e-3 * mask.milliseconds.Total());
}

}  // namespace

absl::Status MaskWorker::Answer(const v1::MaskFrame* frame, const JobContext& job, v1::MaskResult* result) {
  if (frame == nullptr) return WithFieldViolation(absl::InvalidArgumentError("frame: missing"), "frame");
  return WithFieldViolation(Render(*frame, job, result), "frame");
}

absl::Status MaskWorker::Render(const v1::MaskFrame& frame, const JobContext& job, v1::MaskResult* result) {
  const auto start = std::chrono::steady_clock::now();
  if (absl::Status status = decoder_.Decode(frame, &decoded_); !status.ok()) return status;
  const absl::StatusOr<Camera> camera = Camera::Create(decoded_.camera);
  if (!camera.ok()) return absl::InvalidArgumentError(absl::StrCat("camera.", camera.status().message()));
  // In use until this returns.
  const absl::StatusOr<SceneStore::Handle> scene = FindScene(scenes_, frame.scene_digest());
  if (!scene.ok()) return scene.status();
  MaskRequest request;
  request.scene = &(*scene)->scene;
  request.camera = &*camera;
  request.layers = decoded_.layers;
  request.lights = decoded_.lights;
  request.moved_instances = decoded_.moved_instances;
  request.known = decoded_.known;
  request.depth_precision = decoded_.depth_precision;
  request.output = decoded_.output;
  request.method = decoded_.method;
  request.cancellation = &job.cancellation;
  const MaskRenderers::Lease renderer = renderers_.Take();
  const auto masks = renderer->Render(request);
  if (!masks.ok()) return masks.status();

  result->set_frame_id(frame.frame_id());
  result->set_width(static_cast<uint32_t>(decoded_.layers[0].depth.width));
  result->set_height(static_cast<uint32_t>(decoded_.layers[0].depth.height));
  result->set_layers(static_cast<uint32_t>(decoded_.layers.size()));
  // The messages of the last frame keep their memory.
  while (result->lights_size() > frame.lights_size()) result->mutable_lights()->RemoveLast();
  while (result->lights_size() < frame.lights_size()) result->add_lights();
  for (int i = 0; i < frame.lights_size(); ++i) {
    v1::LightMask& out = *result->mutable_lights(i);
    out.set_id(frame.lights(i).id());
    EncodeMask((*masks)[static_cast<size_t>(i)], decoded_, &out);
  }
  result->mutable_timings()->set_queue_seconds(job.queue_seconds);
  result->mutable_timings()->set_total_seconds(
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
  return absl::OkStatus();
}

}  // namespace shadowfit
