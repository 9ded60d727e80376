#pragma once

#include <google/protobuf/repeated_field.h>

#include <glm/glm.hpp>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/scene/scene.h"
#include "shadowfit/v1/scene.pb.h"

namespace shadowfit {

/// A scene from its wire form. Checks what only the wire can get wrong: that counts and bytes agree, before
/// memory is taken for them, and that indices fit; what numbers mean, Validate() must check. InvalidArgument
/// begins with the field's path, as "meshes[3].triangle_count".
absl::StatusOr<Scene> DecodeScene(const v1::SceneData& data);

/// Twelve numbers as an affine matrix; `path` names them in the error.
absl::Status DecodeTransform(const google::protobuf::RepeatedField<float>& numbers, const std::string& path,
                             glm::mat4x3* out);

}  // namespace shadowfit
