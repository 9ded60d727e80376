#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/str_format.h"
#include "core/fit/light_problem.h"
#include "core/frame/camera.h"
#include "core/frame/images.h"
#include "core/math/light.h"
#include "shadowfit/v1/frame.pb.h"

namespace shadowfit {

// What the decoders of several services share. Each checks what only the wire can get wrong; InvalidArgument
// begins with `path`, the field's.

inline constexpr uint32_t kMaxPictureSide = 16384;

absl::Status FieldError(std::string_view path, const std::string& what);
absl::Status UnknownEnum(std::string_view path, int value);

absl::Status DecodeMatrix(bool present, const v1::Matrix4& matrix, std::string_view path, glm::dmat4* out);
absl::Status DecodeVector(bool present, const v1::Vector3& vector, const std::string& path, glm::dvec3* out);
absl::Status DecodeSize(const v1::Size& size, const std::string& path, MapSize* out);
absl::Status DecodeClipDepth(v1::ClipDepth value, std::string_view path, ClipDepth* out);
absl::Status DecodeCamera(bool present, const v1::Camera& camera, const std::string& path,
                          CameraMatrices* out);
/// Without its shadow map and previous matrix.
absl::Status DecodeLightKind(const v1::Light& light, const std::string& path, Light* out);

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

/// Depth buffers of any encoding. Keeps memory between calls.
class DepthDecoder {
 public:
  /// The view borrows from `depth` and from this decoder, until either changes.
  absl::Status Decode(const v1::DepthBuffer& depth, const std::string& path, DepthView* view);

 private:
  std::vector<float> converted_;  // Of encodings other than float32.
};

}  // namespace shadowfit
