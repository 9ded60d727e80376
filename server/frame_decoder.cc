#include "server/frame_decoder.h"

#include <string>
#include <tuple>
#include <utility>

#include "absl/strings/str_format.h"
#include "server/field_decoding.h"

namespace shadowfit {
namespace {

absl::Status DecodeMethod(v1::Method value, Method* out) {
  switch (value) {
    case v1::METHOD_UNSPECIFIED:
    case v1::METHOD_DEFAULT:
      *out = Method::kDefault;
      return absl::OkStatus();
    case v1::METHOD_PAPER:
      *out = Method::kPaper;
      return absl::OkStatus();
    case v1::METHOD_NORMAL:
      *out = Method::kNormal;
      return absl::OkStatus();
    case v1::METHOD_FOCUSED:
      *out = Method::kFocused;
      return absl::OkStatus();
    case v1::METHOD_LISPSM:
      *out = Method::kLispsm;
      return absl::OkStatus();
    case v1::METHOD_PLANE_OPTIMAL:
      *out = Method::kPlaneOptimal;
      return absl::OkStatus();
    case v1::METHOD_SPHERE_STABLE:
      *out = Method::kSphereStable;
      return absl::OkStatus();
    default:
      return UnknownEnum("options.method", value);
  }
}

absl::Status DecodeMostMaps(uint32_t from, DefaultOptions* to) {
  if (from > kMostMaps) {
    return FieldError("options.most_maps", absl::StrFormat("%d is outside 0 to %d", from, kMostMaps));
  }
  to->most_maps = std::max(1, static_cast<int>(from));
  to->divide_where_needed = from != 1;
  return absl::OkStatus();
}

absl::Status DecodeBias(const v1::SafeBiasOptions& from, BiasOptions* to) {
  *to = {};
  switch (from.format()) {
    case v1::SHADOW_MAP_FORMAT_UNSPECIFIED:
    case v1::SHADOW_MAP_FORMAT_UNORM24:
      to->format = DepthFormat::kUnorm24;
      break;
    case v1::SHADOW_MAP_FORMAT_UNORM16:
      to->format = DepthFormat::kUnorm16;
      break;
    case v1::SHADOW_MAP_FORMAT_FLOAT32:
      to->format = DepthFormat::kFloat32;
      break;
    default:
      return UnknownEnum("options.safe_bias.format", from.format());
  }
  if (from.pcf_radius() > static_cast<uint32_t>(kMaxPcfRadius)) {
    return FieldError("options.safe_bias.pcf_radius",
                      absl::StrFormat("%d is outside 0 to %d", from.pcf_radius(), kMaxPcfRadius));
  }
  to->pcf_radius = static_cast<int>(from.pcf_radius());
  if (from.max_samples() != 0) to->max_samples = from.max_samples();
  return absl::OkStatus();
}

absl::Status DecodeSides(const v1::SideLimits& from, const std::string& path, SideLimits* to) {
  for (const auto& [value, side, name] : {std::tuple(from.min_side(), &to->min_side, ".min_side"),
                                          std::tuple(from.max_side(), &to->max_side, ".max_side")}) {
    if (value > kMaxMapSize) {
      return FieldError(path + name, absl::StrFormat("%d is above %d", value, kMaxMapSize));
    }
    if (value != 0) *side = static_cast<int>(value);
  }
  switch (from.rounding()) {
    case v1::SIZE_ROUNDING_UNSPECIFIED:
    case v1::SIZE_ROUNDING_EXACT:
      to->rounding = SizeRounding::kExact;
      return absl::OkStatus();
    case v1::SIZE_ROUNDING_MULTIPLE_OF_8:
      to->rounding = SizeRounding::kMultipleOf8;
      return absl::OkStatus();
    case v1::SIZE_ROUNDING_POWER_OF_TWO:
      to->rounding = SizeRounding::kPowerOfTwo;
      return absl::OkStatus();
    default:
      return UnknownEnum(path + ".rounding", from.rounding());
  }
}

absl::Status DecodeSizing(const v1::OptimizeOptions& from, MapSizing* to) {
  if (from.has_texel_budget()) {
    BudgetOptions& budget = to->emplace<BudgetOptions>();
    // Doubles hold what 65536^2 texels for each of 32 lights need, and more is no budget.
    budget.total_texels = static_cast<double>(from.texel_budget().total_texels());
    if (from.texel_budget().has_atlas()) {
      absl::Status status =
          DecodeSize(from.texel_budget().atlas(), "options.texel_budget.atlas", &budget.atlas.emplace());
      if (!status.ok()) return status;
    }
    return DecodeSides(from.texel_budget().sides(), "options.texel_budget.sides", &budget.sides);
  }
  if (from.has_tolerance()) {
    ToleranceOptions& tolerance = to->emplace<ToleranceOptions>();
    tolerance.max_misclassified_pixels = from.tolerance().max_misclassified_pixels();
    return DecodeSides(from.tolerance().sides(), "options.tolerance.sides", &tolerance.sides);
  }
  return absl::OkStatus();
}

absl::Status DecodeBits(const v1::BitBuffer& bits, BitsView* view) {
  if (absl::Status status = CheckPicture(bits, sizeof(uint32_t), "shadow_bits"); !status.ok()) return status;
  return ViewRows(Samples<uint32_t>(bits.data()).data(), bits, "shadow_bits", view);
}

absl::Status DecodeLight(const v1::Light& light, const std::string& path, FrameDecoder::MapSizes map_sizes,
                         LightRequest* out) {
  out->id = light.id();
  if (absl::Status status = DecodeLightKind(light, path, &out->light); !status.ok()) return status;
  out->weight = light.has_weight() ? light.weight() : 1.0;
  out->map_size = {};
  if (light.has_shadow_map()) {
    absl::Status status = DecodeSize(light.shadow_map(), path + ".shadow_map", &out->map_size);
    if (!status.ok()) return status;
  } else if (map_sizes == FrameDecoder::MapSizes::kRequired) {
    return FieldError(path + ".shadow_map", "missing");
  }
  out->previous_map_size.reset();
  if (light.has_previous_shadow_map()) {
    absl::Status status = DecodeSize(light.previous_shadow_map(), path + ".previous_shadow_map",
                                     &out->previous_map_size.emplace());
    if (!status.ok()) return status;
  }
  out->previous_clip_from_world.reset();
  if (!light.has_previous_world_to_shadow_clip()) return absl::OkStatus();
  return DecodeMatrix(true, light.previous_world_to_shadow_clip(), path + ".previous_world_to_shadow_clip",
                      &out->previous_clip_from_world.emplace());
}

}  // namespace

absl::Status FrameDecoder::Decode(const v1::Frame& frame, FrameRequest* request, Options* options) {
  absl::Status status = DecodeCamera(frame.has_camera(), frame.camera(), "camera", &request->camera);
  if (!status.ok()) return status;

  if (!frame.has_depth()) return FieldError("depth", "missing");
  if (status = depth_.Decode(frame.depth(), "depth", &request->depth); !status.ok()) return status;
  request->bits.reset();
  if (frame.has_shadow_bits()) {
    if (status = DecodeBits(frame.shadow_bits(), &request->bits.emplace()); !status.ok()) return status;
  }

  // Before memory is taken for each of them; that there is one at all, core checks.
  if (frame.lights_size() > kMaxLights) {
    return FieldError("lights",
                      absl::StrFormat("%d, at most %d fit a frame", frame.lights_size(), kMaxLights));
  }
  const bool sized = frame.options().map_sizing_case() != v1::OptimizeOptions::MAP_SIZING_NOT_SET;
  request->lights.resize(static_cast<size_t>(frame.lights_size()));
  for (int i = 0; i < frame.lights_size(); ++i) {
    LightRequest& light = request->lights[static_cast<size_t>(i)];
    status = DecodeLight(frame.lights(i), absl::StrFormat("lights[%d]", i),
                         sized ? MapSizes::kOptional : map_sizes_, &light);
    if (!status.ok()) return status;
    if (sized && light.map_size == MapSize{}) light.map_size = {1024, 1024};
  }

  request->screen = {};
  if (frame.has_screen()) {
    if (status = DecodeSize(frame.screen(), "screen", &request->screen); !status.ok()) return status;
  }
  request->ws_scene_bounds.reset();
  if (frame.has_scene_bounds()) {
    const v1::Bounds& bounds = frame.scene_bounds();
    Bounds& out = request->ws_scene_bounds.emplace();
    status = DecodeVector(bounds.has_min(), bounds.min(), "scene_bounds.min", &out.min);
    status.Update(DecodeVector(bounds.has_max(), bounds.max(), "scene_bounds.max", &out.max));
    if (!status.ok()) return status;
  }

  *options = {};
  status = DecodeMethod(frame.options().method(), &options->method);
  status.Update(DecodeClipDepth(frame.options().output_clip_depth(), "options.output_clip_depth",
                                &request->output_clip_depth));
  status.Update(DecodeMostMaps(frame.options().most_maps(), &options->standard));
  options->standard.free_aspect = frame.options().free_aspect();
  if (frame.options().has_keep_within()) options->standard.keep_within = frame.options().keep_within();
  options->standard.hold_all_shadow = frame.options().hold_all_shadow();
  status.Update(DecodeSizing(frame.options(), &options->sizing));
  options->assess_quality = frame.options().assess_quality();
  request->safe_bias.reset();
  if (frame.options().has_safe_bias()) {
    status.Update(DecodeBias(frame.options().safe_bias(), &request->safe_bias.emplace()));
  }
  return status;
}

}  // namespace shadowfit
