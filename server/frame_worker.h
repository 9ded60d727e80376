#pragma once

#include <optional>
#include <vector>

#include "absl/status/status.h"
#include "core/fit/frame_optimizer.h"
#include "server/frame_decoder.h"
#include "server/job.h"
#include "server/mask_renderers.h"
#include "server/scene_store.h"
#include "shadowfit/v1/frame.pb.h"

namespace shadowfit {

/// Answers one frame after the other: decode, optimize, encode. Keeps its working memory, and on request the
/// matrices of the last frame. One thread at a time.
class FrameWorker {
 public:
  enum class Memory {
    kNone,       ///< Each answer depends on its frame alone.
    kLastFrame,  ///< A light without a previous matrix takes that of the last answer, by id.
  };

  FrameWorker(Memory memory, SceneStore& scenes, MaskRenderers& renderers)
      : memory_(memory), scenes_(scenes), renderers_(renderers) {}

  /// `frame` null: the request lacks it. Errors carry the field as "frame.<path>" in a google.rpc.BadRequest.
  absl::Status Answer(const v1::Frame* frame, const JobContext& job, v1::FrameResult* result);

 private:
  struct LastMatrix {
    uint32_t id = 0;
    glm::dmat4 clip_from_world{1.0};
    MapSize size;
  };

  absl::Status Optimize(const v1::Frame& frame, const JobContext& job, v1::FrameResult* result);
  /// Exact bits of a stored scene, at the depth buffer's resolution.
  absl::Status RenderBits(const v1::Frame& frame, const JobContext& job);
  void Recall();
  void Remember();

  const Memory memory_;
  SceneStore& scenes_;
  MaskRenderers& renderers_;
  FrameDecoder decoder_;
  FrameOptimizer optimizer_;
  FrameRequest request_;
  Options options_;
  FrameSummary summary_;
  std::vector<uint32_t> rendered_bits_;
  std::vector<LastMatrix> last_;
  ClipDepth last_clip_depth_ = ClipDepth::kNegativeOneToOne;
};

}  // namespace shadowfit
