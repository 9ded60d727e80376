#pragma once

#include "absl/status/status.h"
#include "core/irregular/shadow_masks.h"
#include "server/job.h"
#include "server/mask_decoder.h"
#include "server/mask_renderers.h"
#include "server/scene_store.h"
#include "shadowfit/v1/mask.pb.h"

namespace shadowfit {

/// Answers one frame after the other: decode, find the scene, render, encode. Answers depend on their frame
/// alone. One thread at a time.
class MaskWorker {
 public:
  MaskWorker(SceneStore& scenes, MaskRenderers& renderers) : scenes_(scenes), renderers_(renderers) {}

  /// `frame` null: the request lacks it. Errors carry the field as "frame.<path>" in a google.rpc.BadRequest.
  absl::Status Answer(const v1::MaskFrame* frame, const JobContext& job, v1::MaskResult* result);

 private:
  absl::Status Render(const v1::MaskFrame& frame, const JobContext& job, v1::MaskResult* result);

  SceneStore& scenes_;
  MaskRenderers& renderers_;
  MaskDecoder decoder_;
  DecodedMaskFrame decoded_;
};

}  // namespace shadowfit
