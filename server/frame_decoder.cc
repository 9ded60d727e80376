#include "server/frame_decoder.h"

#include <bit>
#include <optional>
#include <string>
#include <string_view>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "server/depth_decoding.h"

namespace shadowfit {
namespace {

static_assert(std::endian::native == std::endian::little, "buffers are little-endian and are read in place");

constexpr uint32_t kMaxPictureSide = 16384;

absl::Status FieldError(std::string_view path, const std::string& what) {
  return absl::InvalidArgumentError(absl::StrCat(absl::string_view(path.data(), path.size()), ": ", what));
}

absl::Status DecodeMatrix(bool present, const v1::Matrix4& matrix, std::string_view path, glm::dmat4* out) {
  if (!present) return FieldError(path, "missing");
  if (matrix.m_size() != 16) {
    return FieldError(std::string(path) + ".m", absl::StrFormat("%d entries, 16 expected", matrix.m_size()));
  }
  for (int i = 0; i < 16; ++i) (*out)[i / 4][i % 4] = matrix.m(i);
  return absl::OkStatus();
}

absl::Status DecodeVector(bool present, const v1::Vector3& vector, const std::string& path, glm::dvec3* out) {
  if (!present) return FieldError(path, "missing");
  *out = {vector.x(), vector.y(), vector.z()};
  return absl::OkStatus();
}

absl::Status DecodeSize(const v1::Size& size, const std::string& path, MapSize* out) {
  for (const auto& [value, name] : {std::pair(size.width(), ".width"), std::pair(size.height(), ".height")}) {
    if (value < 1 || value > kMaxMapSize) {
      return FieldError(path + name, absl::StrFormat("%d is outside 1 to %d", value, kMaxMapSize));
    }
  }
  *out = {static_cast<int>(size.width()), static_cast<int>(size.height())};
  return absl::OkStatus();
}

absl::Status UnknownEnum(std::string_view path, int value) {
  return FieldError(path, absl::StrFormat("unknown value %d", value));
}

absl::Status DecodeClipDepth(v1::ClipDepth value, std::string_view path, ClipDepth* out) {
  switch (value) {
    case v1::CLIP_DEPTH_UNSPECIFIED:
    case v1::CLIP_DEPTH_NEGATIVE_ONE_TO_ONE:
      *out = ClipDepth::kNegativeOneToOne;
      return absl::OkStatus();
    case v1::CLIP_DEPTH_ZERO_TO_ONE:
      *out = ClipDepth::kZeroToOne;
      return absl::OkStatus();
    case v1::CLIP_DEPTH_REVERSED_ZERO_TO_ONE:
      *out = ClipDepth::kReversedZeroToOne;
      return absl::OkStatus();
    default:
      return UnknownEnum(path, value);
  }
}

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

/// Size and byte count of a picture, before anything is allocated for it.
template <typename Buffer>
absl::Status CheckPicture(const Buffer& buffer, uint64_t sample_bytes, const std::string& path) {
  for (const auto& [value, name] :
       {std::pair(buffer.width(), ".width"), std::pair(buffer.height(), ".height")}) {
    if (value < 1 || value > kMaxPictureSide) {
      return FieldError(path + name, absl::StrFormat("%d is outside 1 to %d", value, kMaxPictureSide));
    }
  }
  const uint64_t expected = uint64_t{buffer.width()} * buffer.height() * sample_bytes;
  if (buffer.data().size() != expected) {
    return FieldError(path + ".data",
                      absl::StrFormat("%d bytes, %dx%d samples of %d bytes are %d", buffer.data().size(),
                                      buffer.width(), buffer.height(), sample_bytes, expected));
  }
  return absl::OkStatus();
}

/// A view of packed rows in either order. A string's bytes are aligned for any sample type: the allocator
/// sees to it, and short strings lie inside their object at a multiple of 8.
template <typename T, typename Buffer>
absl::Status ViewRows(const T* samples, const Buffer& buffer, const std::string& path, ImageView<T>* view) {
  const int width = static_cast<int>(buffer.width());
  const int height = static_cast<int>(buffer.height());
  switch (buffer.row_order()) {
    case v1::ROW_ORDER_UNSPECIFIED:
    case v1::ROW_ORDER_BOTTOM_FIRST:
      *view = BottomFirst(samples, width, height);
      return absl::OkStatus();
    case v1::ROW_ORDER_TOP_FIRST:
      *view = TopFirst(samples, width, height);
      return absl::OkStatus();
    default:
      return UnknownEnum(path + ".row_order", buffer.row_order());
  }
}

template <typename T>
std::span<const T> Samples(const std::string& data) {
  return {reinterpret_cast<const T*>(data.data()), data.size() / sizeof(T)};
}

absl::Status DecodeBits(const v1::BitBuffer& bits, BitsView* view) {
  if (absl::Status status = CheckPicture(bits, sizeof(uint32_t), "shadow_bits"); !status.ok()) return status;
  return ViewRows(Samples<uint32_t>(bits.data()).data(), bits, "shadow_bits", view);
}

absl::Status DecodeLight(const v1::Light& light, const std::string& path, FrameDecoder::MapSizes map_sizes,
                         LightRequest* out) {
  out->id = light.id();
  switch (light.kind_case()) {
    case v1::Light::kPoint: {
      PointLight& point = out->light.emplace<PointLight>();
      absl::Status status = DecodeVector(light.point().has_position(), light.point().position(),
                                         path + ".point.position", &point.ws_position);
      if (!status.ok()) return status;
      break;
    }
    case v1::Light::kSpot: {
      SpotLight& spot = out->light.emplace<SpotLight>();
      absl::Status status = DecodeVector(light.spot().has_position(), light.spot().position(),
                                         path + ".spot.position", &spot.ws_position);
      status.Update(DecodeVector(light.spot().has_direction(), light.spot().direction(),
                                 path + ".spot.direction", &spot.ws_direction));
      if (!status.ok()) return status;
      spot.outer_half_angle = light.spot().outer_half_angle();
      break;
    }
    case v1::Light::kDirectional: {
      DirectionalLight& directional = out->light.emplace<DirectionalLight>();
      absl::Status status = DecodeVector(light.directional().has_direction(), light.directional().direction(),
                                         path + ".directional.direction", &directional.ws_direction);
      if (!status.ok()) return status;
      break;
    }
    case v1::Light::KIND_NOT_SET:
      return FieldError(path + ".kind", "missing, one of point, spot, directional expected");
  }
  out->map_size = {};
  if (light.has_shadow_map()) {
    absl::Status status = DecodeSize(light.shadow_map(), path + ".shadow_map", &out->map_size);
    if (!status.ok()) return status;
  } else if (map_sizes == FrameDecoder::MapSizes::kRequired) {
    return FieldError(path + ".shadow_map", "missing");
  }
  out->previous_clip_from_world.reset();
  if (!light.has_previous_world_to_shadow_clip()) return absl::OkStatus();
  return DecodeMatrix(true, light.previous_world_to_shadow_clip(), path + ".previous_world_to_shadow_clip",
                      &out->previous_clip_from_world.emplace());
}

}  // namespace

absl::Status FrameDecoder::DecodeDepth(const v1::DepthBuffer& depth, DepthView* view) {
  const auto check = [&depth](uint64_t sample_bytes) { return CheckPicture(depth, sample_bytes, "depth"); };
  const std::string& data = depth.data();
  const float* samples = nullptr;
  const auto convert = [&]<typename T>(void (*function)(std::span<const T>, float*)) {
    const std::span<const T> in = Samples<T>(data);
    converted_depth_.resize(in.size());
    function(in, converted_depth_.data());
    samples = converted_depth_.data();
  };
  switch (depth.encoding()) {
    case v1::DEPTH_ENCODING_UNSPECIFIED:
    case v1::DEPTH_ENCODING_FLOAT32:
      if (absl::Status status = check(4); !status.ok()) return status;
      samples = Samples<float>(data).data();
      break;
    case v1::DEPTH_ENCODING_FLOAT16:
      if (absl::Status status = check(2); !status.ok()) return status;
      convert(&DepthFromFloat16);
      break;
    case v1::DEPTH_ENCODING_UNORM16:
      if (absl::Status status = check(2); !status.ok()) return status;
      convert(&DepthFromUnorm16);
      break;
    case v1::DEPTH_ENCODING_UNORM24:
      if (absl::Status status = check(4); !status.ok()) return status;
      convert(&DepthFromUnorm24);
      break;
    default:
      return UnknownEnum("depth.encoding", depth.encoding());
  }
  return ViewRows(samples, depth, "depth", view);
}

absl::Status FrameDecoder::Decode(const v1::Frame& frame, FrameRequest* request, Options* options) {
  if (!frame.has_camera()) return FieldError("camera", "missing");
  const v1::Camera& camera = frame.camera();
  absl::Status status =
      DecodeMatrix(camera.has_view(), camera.view(), "camera.view", &request->camera.view_from_world);
  status.Update(DecodeMatrix(camera.has_projection(), camera.projection(), "camera.projection",
                             &request->camera.clip_from_view));
  status.Update(DecodeClipDepth(camera.clip_depth(), "camera.clip_depth", &request->camera.clip_depth));
  if (!status.ok()) return status;

  if (!frame.has_depth()) return FieldError("depth", "missing");
  if (status = DecodeDepth(frame.depth(), &request->depth); !status.ok()) return status;
  request->bits.reset();
  if (frame.has_shadow_bits()) {
    if (status = DecodeBits(frame.shadow_bits(), &request->bits.emplace()); !status.ok()) return status;
  }

  // Before memory is taken for each of them; that there is one at all, core checks.
  if (frame.lights_size() > kMaxLights) {
    return FieldError("lights",
                      absl::StrFormat("%d, at most %d fit a frame", frame.lights_size(), kMaxLights));
  }
  request->lights.resize(static_cast<size_t>(frame.lights_size()));
  for (int i = 0; i < frame.lights_size(); ++i) {
    status = DecodeLight(frame.lights(i), absl::StrFormat("lights[%d]", i), map_sizes_,
                         &request->lights[static_cast<size_t>(i)]);
    if (!status.ok()) return status;
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
  request->safe_bias.reset();
  if (frame.options().has_safe_bias()) {
    status.Update(DecodeBias(frame.options().safe_bias(), &request->safe_bias.emplace()));
  }
  return status;
}

}  // namespace shadowfit
