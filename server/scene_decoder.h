#pragma once

#include <google/protobuf/repeated_field.h>

#include <glm/glm.hpp>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/cancellation.h"
#include "core/scene/scene.h"

namespace shadowfit {

/// A scene from its wire form, a serialized SceneData. Checks what only the wire can get wrong: that counts
/// and bytes agree, before memory is taken for them, and that indices fit; what numbers mean, Validate() must
/// check. InvalidArgument begins with the field's path, as "meshes[3].triangle_count". Cancelled or
/// DeadlineExceeded once `cancellation` (may be null) asks.
absl::StatusOr<Scene> DecodeScene(std::string bytes, const Cancellation* cancellation = nullptr);

/// Twelve numbers as an affine matrix; `path` names them in the error.
absl::Status DecodeTransform(const google::protobuf::RepeatedField<float>& numbers, const std::string& path,
                             glm::mat4x3* out);

}  // namespace shadowfit
