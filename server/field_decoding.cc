#include "server/field_decoding.h"

#include <bit>

#include "absl/strings/str_cat.h"
#include "core/fit/frame_optimizer.h"
#include "server/depth_decoding.h"

namespace shadowfit {

static_assert(std::endian::native == std::endian::little, "buffers are little-endian and are read in place");

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

absl::Status DecodeCamera(bool present, const v1::Camera& camera, const std::string& path,
                          CameraMatrices* out) {
  if (!present) return FieldError(path, "missing");
  absl::Status status = DecodeMatrix(camera.has_view(), camera.view(), path + ".view", &out->view_from_world);
  status.Update(
      DecodeMatrix(camera.has_projection(), camera.projection(), path + ".projection", &out->clip_from_view));
  status.Update(DecodeClipDepth(camera.clip_depth(), path + ".clip_depth", &out->clip_depth));
  return status;
}

absl::Status DecodeLightKind(const v1::Light& light, const std::string& path, Light* out) {
  switch (light.kind_case()) {
    case v1::Light::kPoint: {
      PointLight& point = out->emplace<PointLight>();
      absl::Status status = DecodeVector(light.point().has_position(), light.point().position(),
                                         path + ".point.position", &point.ws_position);
      if (!status.ok()) return status;
      break;
    }
    case v1::Light::kSpot: {
      SpotLight& spot = out->emplace<SpotLight>();
      absl::Status status = DecodeVector(light.spot().has_position(), light.spot().position(),
                                         path + ".spot.position", &spot.ws_position);
      status.Update(DecodeVector(light.spot().has_direction(), light.spot().direction(),
                                 path + ".spot.direction", &spot.ws_direction));
      if (!status.ok()) return status;
      spot.outer_half_angle = light.spot().outer_half_angle();
      break;
    }
    case v1::Light::kDirectional: {
      DirectionalLight& directional = out->emplace<DirectionalLight>();
      absl::Status status = DecodeVector(light.directional().has_direction(), light.directional().direction(),
                                         path + ".directional.direction", &directional.ws_direction);
      if (!status.ok()) return status;
      break;
    }
    case v1::Light::KIND_NOT_SET:
      return FieldError(path + ".kind", "missing, one of point, spot, directional expected");
  }
  return absl::OkStatus();
}

absl::Status DepthDecoder::Decode(const v1::DepthBuffer& depth, const std::string& path, DepthView* view) {
  const auto check = [&](uint64_t sample_bytes) { return CheckPicture(depth, sample_bytes, path); };
  const std::string& data = depth.data();
  const float* samples = nullptr;
  const auto convert = [&]<typename T>(void (*function)(std::span<const T>, float*)) {
    const std::span<const T> in = Samples<T>(data);
    converted_.resize(in.size());
    function(in, converted_.data());
    samples = converted_.data();
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
      return UnknownEnum(path + ".encoding", depth.encoding());
  }
  return ViewRows(samples, depth, path, view);
}

}  // namespace shadowfit
