#pragma once

#include <vector>

#include "absl/status/status.h"
#include "core/frame/camera.h"
#include "core/irregular/shadow_masks.h"
#include "server/field_decoding.h"
#include "shadowfit/v1/mask.pb.h"

namespace shadowfit {

/// A frame's masks as core asks for them, but for the scene.
struct DecodedMaskFrame {
  CameraMatrices camera;
  std::vector<ReceiverLayer> layers;
  std::vector<Light> lights;
  std::vector<MovedInstance> moved_instances;
  std::vector<ImageView<uint8_t>> known;
  DepthPrecision depth_precision = DepthPrecision::kFloat32;
  MaskOutput output = MaskOutput::kBits;
  MaskMethod method = MaskMethod::kGrid;
  bool top_first = false;  ///< Row order of the layers, and of the answer.
};

/// What a sample's encoding costs of precision; the encoding must be known.
DepthPrecision PrecisionOf(v1::DepthEncoding encoding);

/// Turns wire frames into core's requests. Keeps memory between calls.
class MaskDecoder {
 public:
  /// `out` borrows pictures from `frame` and from this decoder, until either changes. Checks what only the
  /// wire can get wrong. InvalidArgument begins with the field's path within the frame.
  absl::Status Decode(const v1::MaskFrame& frame, DecodedMaskFrame* out);

 private:
  absl::Status DecodeLayer(const v1::ReceiverLayer& layer, const v1::DepthBuffer& first,
                           const std::string& path, DepthDecoder* depth, ReceiverLayer* out);

  std::vector<DepthDecoder> depth_decoders_;  // One a layer.
};

}  // namespace shadowfit
