#include "server/resolution_worker.h"

#include <vector>

#include "absl/strings/str_format.h"
#include "server/errors.h"

namespace shadowfit {
namespace {

absl::Status DecodeOptions(const v1::ResolutionOptions& from, ResolutionOptions* to) {
  *to = {};
  if (from.max_size() > static_cast<uint32_t>(kMaxResolution)) {
    return absl::InvalidArgumentError(
        absl::StrFormat("max_size: %d is above %d", from.max_size(), kMaxResolution));
  }
  if (from.max_size() != 0) to->max_size = static_cast<int>(from.max_size());
  if (from.percentile() != 0.0) to->percentile = from.percentile();
  to->histogram = from.histogram();
  switch (from.rounding()) {
    case v1::SIZE_ROUNDING_UNSPECIFIED:
    case v1::SIZE_ROUNDING_EXACT:
      to->rounding = SizeRounding::kExact;
      break;
    case v1::SIZE_ROUNDING_MULTIPLE_OF_8:
      to->rounding = SizeRounding::kMultipleOf8;
      break;
    case v1::SIZE_ROUNDING_POWER_OF_TWO:
      to->rounding = SizeRounding::kPowerOfTwo;
      break;
    default:
      return absl::InvalidArgumentError(absl::StrFormat("rounding: unknown value %d", from.rounding()));
  }
  return Validate(*to);
}

void EncodeSize(const MapSize& from, v1::Size* to) {
  to->set_width(static_cast<uint32_t>(from.width));
  to->set_height(static_cast<uint32_t>(from.height));
}

void EncodeBins(const std::vector<ResolutionBin>& from,
                google::protobuf::RepeatedPtrField<v1::ResolutionBin>* to) {
  to->Reserve(static_cast<int>(from.size()));
  for (const ResolutionBin& bin : from) {
    v1::ResolutionBin& encoded = *to->Add();
    encoded.set_texels(bin.texels);
    encoded.set_pixels(static_cast<uint64_t>(bin.pixels));
  }
}

void EncodeMap(const MapEstimate& from, v1::MapResolution* to) {
  to->set_visible_pixels(static_cast<uint64_t>(from.pixels));
  EncodeSize(from.recommended, to->mutable_recommended());
  to->set_needed_width(from.needed.x);
  to->set_needed_height(from.needed.y);
  to->set_limited(from.limited);
  to->set_crop_min_x(from.crop_min.x);
  to->set_crop_min_y(from.crop_min.y);
  to->set_crop_max_x(from.crop_max.x);
  to->set_crop_max_y(from.crop_max.y);
  to->set_smallest_patch_width(from.smallest_patch.x);
  to->set_smallest_patch_height(from.smallest_patch.y);
  auto& m = *to->mutable_world_to_shadow_clip()->mutable_m();
  m.Reserve(16);
  for (int k = 0; k < 16; ++k) m.AddAlreadyReserved(from.clip_from_world[k / 4][k % 4]);
  EncodeBins(from.histogram_x, to->mutable_histogram_x());
  EncodeBins(from.histogram_y, to->mutable_histogram_y());
}

void EncodeResult(uint64_t frame_id, const ResolutionSummary& summary, double queue_seconds,
                  v1::ResolutionResult* result) {
  result->Clear();
  result->set_frame_id(frame_id);
  for (const LightEstimate& from : summary.lights) {
    v1::LightResolution& to = *result->add_lights();
    to.set_id(from.id);
    EncodeSize(from.recommended, to.mutable_recommended());
    for (const MapEstimate& map : from.maps) EncodeMap(map, to.add_maps());
  }
  result->set_queue_seconds(queue_seconds);
  result->set_total_seconds(summary.seconds);
}

}  // namespace

absl::Status ResolutionWorker::Answer(const v1::Frame* frame, const v1::ResolutionOptions& options,
                                      const JobContext& job, v1::ResolutionResult* result) {
  if (frame == nullptr) return WithFieldViolation(absl::InvalidArgumentError("frame: missing"), "");
  ResolutionOptions decoded;
  if (absl::Status status = DecodeOptions(options, &decoded); !status.ok()) {
    return WithFieldViolation(std::move(status), "options");
  }
  if (absl::Status status = decoder_.Decode(*frame, &frame_, &frame_options_); !status.ok()) {
    return WithFieldViolation(std::move(status), "frame");
  }
  request_.camera = frame_.camera;
  request_.depth = frame_.depth;
  request_.screen = frame_.screen;
  request_.output_clip_depth = frame_.output_clip_depth;
  request_.lights.clear();
  for (const LightRequest& light : frame_.lights) {
    request_.lights.push_back(
        {.id = light.id, .light = light.light, .clip_from_world = light.previous_clip_from_world});
  }
  if (absl::Status status = estimator_.Estimate(request_, decoded, job.cancellation, &summary_);
      !status.ok()) {
    return WithFieldViolation(std::move(status), "frame");
  }
  EncodeResult(frame->frame_id(), summary_, job.queue_seconds, result);
  return absl::OkStatus();
}

}  // namespace shadowfit
