#include "server/mask_decoder.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/fit/frame_optimizer.h"
#include "server/scene_decoder.h"

namespace shadowfit {
namespace {

constexpr int kMaxLayers = 64;
/// Each sample takes about 48 bytes while its masks are computed.
constexpr uint64_t kMaxSamples = uint64_t{1} << 25;

absl::Status DecodeOutput(v1::MaskOutput value, MaskOutput* out) {
  switch (value) {
    case v1::MASK_OUTPUT_UNSPECIFIED:
    case v1::MASK_OUTPUT_BITS:
      *out = MaskOutput::kBits;
      return absl::OkStatus();
    case v1::MASK_OUTPUT_TRANSMITTANCE:
      *out = MaskOutput::kTransmittance;
      return absl::OkStatus();
    case v1::MASK_OUTPUT_COVERAGE:
      *out = MaskOutput::kCoverage;
      return absl::OkStatus();
    default:
      return UnknownEnum("output", value);
  }
}

absl::Status DecodeMaskMethod(v1::MaskMethod value, MaskMethod* out) {
  switch (value) {
    case v1::MASK_METHOD_UNSPECIFIED:
    case v1::MASK_METHOD_DEFAULT:
      *out = MaskMethod::kGrid;
      return absl::OkStatus();
    case v1::MASK_METHOD_BSP:
      *out = MaskMethod::kBsp;
      return absl::OkStatus();
    case v1::MASK_METHOD_EXHAUSTIVE:
      *out = MaskMethod::kExhaustive;
      return absl::OkStatus();
    default:
      return UnknownEnum("method", value);
  }
}

}  // namespace

DepthPrecision PrecisionOf(v1::DepthEncoding encoding) {
  switch (encoding) {
    case v1::DEPTH_ENCODING_FLOAT16:
      return DepthPrecision::kFloat16;
    case v1::DEPTH_ENCODING_UNORM16:
      return DepthPrecision::kUnorm16;
    case v1::DEPTH_ENCODING_UNORM24:
      return DepthPrecision::kUnorm24;
    default:
      return DepthPrecision::kFloat32;
  }
}

absl::Status MaskDecoder::DecodeLayer(const v1::ReceiverLayer& layer, const v1::DepthBuffer& first,
                                      const std::string& path, DepthDecoder* depth, ReceiverLayer* out) {
  if (!layer.has_depth()) return FieldError(path + ".depth", "missing");
  const v1::DepthBuffer& buffer = layer.depth();
  if (buffer.width() != first.width() || buffer.height() != first.height() ||
      buffer.encoding() != first.encoding() || buffer.row_order() != first.row_order()) {
    return FieldError(path + ".depth", "size, encoding or row order is not that of the first layer");
  }
  if (absl::Status status = depth->Decode(buffer, path + ".depth", &out->depth); !status.ok()) return status;
  out->pixel_offset = {layer.has_offset_x() ? layer.offset_x() : 0.5,
                       layer.has_offset_y() ? layer.offset_y() : 0.5};
  out->ws_normals = {};
  if (layer.normals().empty()) return absl::OkStatus();
  const uint64_t expected = uint64_t{buffer.width()} * buffer.height() * sizeof(glm::vec3);
  if (layer.normals().size() != expected) {
    return FieldError(path + ".normals",
                      absl::StrFormat("%d bytes, %dx%d normals of 12 bytes are %d", layer.normals().size(),
                                      buffer.width(), buffer.height(), expected));
  }
  return ViewRows(reinterpret_cast<const glm::vec3*>(layer.normals().data()), buffer, path + ".depth",
                  &out->ws_normals);
}

absl::Status MaskDecoder::Decode(const v1::MaskFrame& frame, DecodedMaskFrame* out) {
  absl::Status status = DecodeCamera(frame.has_camera(), frame.camera(), "camera", &out->camera);
  if (!status.ok()) return status;

  if (frame.layers_size() < 1 || frame.layers_size() > kMaxLayers) {
    return FieldError("layers", absl::StrFormat("%d, 1 to %d expected", frame.layers_size(), kMaxLayers));
  }
  const v1::DepthBuffer& first = frame.layers(0).depth();
  const uint64_t samples =
      uint64_t{first.width()} * first.height() * static_cast<uint64_t>(frame.layers_size());
  if (samples > kMaxSamples) {
    return FieldError("layers", absl::StrFormat("%d of %dx%d, at most %d samples in all", frame.layers_size(),
                                                first.width(), first.height(), kMaxSamples));
  }
  const auto layers = static_cast<size_t>(frame.layers_size());
  if (depth_decoders_.size() < layers) depth_decoders_.resize(layers);
  out->layers.resize(layers);
  for (int i = 0; i < frame.layers_size(); ++i) {
    status = DecodeLayer(frame.layers(i), first, absl::StrFormat("layers[%d]", i),
                         &depth_decoders_[static_cast<size_t>(i)], &out->layers[static_cast<size_t>(i)]);
    if (!status.ok()) return status;
  }
  out->depth_precision = PrecisionOf(first.encoding());
  out->top_first = first.row_order() == v1::ROW_ORDER_TOP_FIRST;

  if (frame.lights_size() < 1 || frame.lights_size() > kMaxLights) {
    return FieldError("lights", absl::StrFormat("%d, 1 to %d expected", frame.lights_size(), kMaxLights));
  }
  out->lights.resize(static_cast<size_t>(frame.lights_size()));
  for (int i = 0; i < frame.lights_size(); ++i) {
    status = DecodeLightKind(frame.lights(i), absl::StrFormat("lights[%d]", i),
                             &out->lights[static_cast<size_t>(i)]);
    if (!status.ok()) return status;
  }

  out->known.clear();
  if (frame.known_size() != 0 && frame.known_size() != frame.lights_size()) {
    return FieldError(
        "known", absl::StrFormat("%d, but there are %d lights", frame.known_size(), frame.lights_size()));
  }
  for (int i = 0; i < frame.known_size(); ++i) {
    const std::string& data = frame.known(i).data();
    const size_t layer_bytes = size_t{first.width()} * first.height();
    if (data.size() != layer_bytes * layers) {
      return FieldError(absl::StrFormat("known[%d].data", i),
                        absl::StrFormat("%d bytes, %d layers of %dx%d are %d", data.size(), layers,
                                        first.width(), first.height(), layer_bytes * layers));
    }
    for (size_t layer = 0; layer < layers; ++layer) {
      status = ViewRows(reinterpret_cast<const uint8_t*>(data.data()) + layer * layer_bytes, first,
                        "layers[0].depth", &out->known.emplace_back());
      if (!status.ok()) return status;
    }
  }

  out->moved_instances.resize(static_cast<size_t>(frame.moved_instances_size()));
  for (int i = 0; i < frame.moved_instances_size(); ++i) {
    const v1::InstanceTransform& moved = frame.moved_instances(i);
    MovedInstance& to = out->moved_instances[static_cast<size_t>(i)];
    to.instance = moved.instance();
    status =
        DecodeTransform(moved.world_from_object(),
                        absl::StrFormat("moved_instances[%d].world_from_object", i), &to.world_from_object);
    if (!status.ok()) return status;
  }
  status = DecodeOutput(frame.output(), &out->output);
  status.Update(DecodeMaskMethod(frame.method(), &out->method));
  return status;
}

}  // namespace shadowfit
