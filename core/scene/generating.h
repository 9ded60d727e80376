#pragma once

#include <cstddef>
#include <glm/glm.hpp>

#include "absl/status/status.h"
#include "absl/strings/str_format.h"
#include "core/scene/scene.h"

namespace shadowfit {

// What the generated scenes (procedural.h) share.

/// Returns its number.
inline int AddMaterial(Scene* scene, const char* name, glm::vec3 diffuse) {
  Material& material = scene->materials.emplace_back();
  material.name = name;
  material.diffuse = diffuse;
  return static_cast<int>(scene->materials.size()) - 1;
}

inline absl::Status TooFew(const char* scene, size_t triangles, size_t least) {
  return absl::InvalidArgumentError(
      absl::StrFormat("%s: %d triangles, at least %d are needed", scene, triangles, least));
}

}  // namespace shadowfit
