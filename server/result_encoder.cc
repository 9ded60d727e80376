#include "server/result_encoder.h"

namespace shadowfit {
namespace {

v1::FitOutcome EncodeOutcome(FitOutcome outcome) {
  switch (outcome) {
    case FitOutcome::kFitted:
      return v1::FIT_OUTCOME_FITTED;
    case FitOutcome::kKeptPrevious:
      return v1::FIT_OUTCOME_KEPT_PREVIOUS;
    case FitOutcome::kFallback:
      return v1::FIT_OUTCOME_FALLBACK;
  }
  return v1::FIT_OUTCOME_UNSPECIFIED;
}

v1::SampleSource EncodeSource(SampleSource source) {
  switch (source) {
    case SampleSource::kShadowBoundary:
      return v1::SAMPLE_SOURCE_SHADOW_BOUNDARY;
    case SampleSource::kAllVisible:
      return v1::SAMPLE_SOURCE_ALL_VISIBLE;
    case SampleSource::kNone:
      return v1::SAMPLE_SOURCE_NONE;
  }
  return v1::SAMPLE_SOURCE_UNSPECIFIED;
}

void EncodeBias(const SafeBias& from, v1::SafeBias* to) {
  to->set_constant(from.constant);
  to->set_slope(from.slope);
  to->set_clamp(from.clamp);
  to->set_polygon_offset_constant(from.polygon_offset_constant);
  to->set_polygon_offset_slope(from.polygon_offset_slope);
  to->set_receiver_plane_constant(from.receiver_plane_constant);
  to->set_mean_detachment(from.ws_mean_detachment);
  to->set_worst_detachment(from.ws_worst_detachment);
  to->set_mean_detachment_of_constant(from.ws_mean_detachment_of_constant);
  to->set_mean_detachment_pixels(from.mean_detachment_pixels);
  to->set_worst_detachment_pixels(from.worst_detachment_pixels);
  to->set_samples(static_cast<uint32_t>(from.samples));
}

void EncodeMatrix(const glm::dmat4& from, v1::Matrix4* to) {
  auto& m = *to->mutable_m();
  m.Reserve(16);
  for (int k = 0; k < 16; ++k) m.AddAlreadyReserved(from[k / 4][k % 4]);
}

void EncodeSize(MapSize from, v1::Size* to) {
  to->set_width(static_cast<uint32_t>(from.width));
  to->set_height(static_cast<uint32_t>(from.height));
}

void EncodePosition(AtlasPosition from, v1::AtlasPosition* to) {
  to->set_x(static_cast<uint32_t>(from.x));
  to->set_y(static_cast<uint32_t>(from.y));
}

v1::MapFlaw EncodeFlaw(MapFlaw flaw) {
  switch (flaw) {
    case MapFlaw::kNone:
      return v1::MAP_FLAW_NONE;
    case MapFlaw::kPerspective:
      return v1::MAP_FLAW_PERSPECTIVE;
    case MapFlaw::kProjection:
      return v1::MAP_FLAW_PROJECTION;
    case MapFlaw::kFit:
      return v1::MAP_FLAW_FIT;
    case MapFlaw::kBudget:
      return v1::MAP_FLAW_BUDGET;
  }
  return v1::MAP_FLAW_UNSPECIFIED;
}

void EncodeQuality(const MapQuality& from, v1::MapQuality* to) {
  to->set_unit_pixels(from.unit_pixels);
  to->set_perspective(from.perspective);
  to->set_projection(from.projection);
  to->set_fit(from.fit);
  to->set_budget(from.budget);
  to->set_saturation(from.saturation);
  to->set_worst(EncodeFlaw(from.Worst()));
}

}  // namespace

void EncodeResult(uint64_t frame_id, const FrameSummary& summary, double queue_seconds,
                  v1::FrameResult* result) {
  result->Clear();
  result->set_frame_id(frame_id);
  for (size_t i = 0; i < summary.lights.size(); ++i) {
    const LightSummary& from = summary.lights[i];
    v1::LightResult& to = *result->add_lights();
    to.set_id(from.id);
    EncodeMatrix(from.clip_from_world, to.mutable_world_to_shadow_clip());
    EncodeSize(from.projection.size, to.mutable_shadow_map());
    to.set_predicted_misclassified_pixels(from.predicted_misclassified_pixels);
    to.set_shadow_outside_pixels(from.shadow_outside_pixels);
    to.set_outcome(EncodeOutcome(from.outcome));
    to.set_sample_source(EncodeSource(from.sample_source));
    to.set_note(from.note);
    to.set_boundary_samples(static_cast<uint32_t>(from.boundary_samples));
    to.set_hull_samples(static_cast<uint32_t>(from.hull_samples));
    to.set_evaluations(static_cast<uint32_t>(from.evaluations));
    to.set_optimize_seconds(from.seconds);
    if (from.swim_pixels) to.set_swim_pixels(*from.swim_pixels);
    if (from.safe_bias) EncodeBias(*from.safe_bias, to.mutable_safe_bias());
    if (from.quality) EncodeQuality(*from.quality, to.mutable_quality());
    if (from.atlas_position) EncodePosition(*from.atlas_position, to.mutable_atlas_position());
    for (const LightMap& map : from.further_maps) {
      v1::ShadowMap& further = *to.add_further_maps();
      EncodeMatrix(map.clip_from_world, further.mutable_world_to_shadow_clip());
      EncodeSize(map.projection.size, further.mutable_size());
      if (map.safe_bias) EncodeBias(*map.safe_bias, further.mutable_safe_bias());
      if (map.atlas_position) EncodePosition(*map.atlas_position, further.mutable_atlas_position());
    }
  }
  v1::FrameTimings& timings = *result->mutable_timings();
  timings.set_queue_seconds(queue_seconds);
  timings.set_sampling_seconds(summary.sampling_seconds);
  timings.set_total_seconds(summary.total_seconds);
  timings.set_bias_seconds(summary.bias_seconds);
}

}  // namespace shadowfit
