#pragma once

#include "absl/status/status.h"
#include "core/resolution/resolution.h"
#include "server/frame_decoder.h"
#include "server/job.h"
#include "shadowfit/v1/resolution.pb.h"

namespace shadowfit {

/// Answers one resolution request after the other: decode, estimate, encode. Keeps its working memory. One
/// thread at a time.
class ResolutionWorker {
 public:
  /// `frame` null: the request lacks it. Errors carry the field, as "frame.<path>" or "options.<path>", in a
  /// google.rpc.BadRequest.
  absl::Status Answer(const v1::Frame* frame, const v1::ResolutionOptions& options, const JobContext& job,
                      v1::ResolutionResult* result);

 private:
  FrameDecoder decoder_{FrameDecoder::MapSizes::kOptional};
  ResolutionEstimator estimator_;
  FrameRequest frame_;
  Options frame_options_;
  ResolutionRequest request_;
  ResolutionSummary summary_;
};

}  // namespace shadowfit
