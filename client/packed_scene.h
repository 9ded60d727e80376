#pragma once

#include <string>

#include "shadowfit/v1/scene.pb.h"

namespace shadowfit {

/// A scene as it is uploaded, and the digest by which the service knows it from then on.
struct PackedScene {
  std::string digest;  ///< SHA-256 of `bytes`, 64 lower-case hexadecimal digits.
  std::string bytes;   ///< A serialized shadowfit.v1.SceneData.
};

/// Serializes a scene. Do it once and keep the result: frames need its digest, and a service that has
/// forgotten the scene its bytes.
PackedScene PackScene(const v1::SceneData& scene);

}  // namespace shadowfit
