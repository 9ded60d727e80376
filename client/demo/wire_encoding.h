#pragma once

#include <string>
#include <vector>

#include "core/frame/camera.h"
#include "core/math/light.h"
#include "shadowfit/v1/frame.pb.h"

namespace shadowfit {

void Encode(const glm::dvec3& v, v1::Vector3* out);
/// An OpenGL camera: NDC depth from -1 to 1.
void Encode(const CameraMatrices& camera, v1::Camera* out);
/// Without id and shadow map.
void Encode(const Light& light, v1::Light* out);

/// The values as they lie in memory: both ends are little-endian.
template <typename T>
void Encode(const std::vector<T>& values, std::string* out) {
  out->assign(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T));
}

/// The size and the values of a picture whose row 0 is at the bottom.
void EncodeDepth(int width, int height, const std::vector<float>& depth, v1::DepthBuffer* out);

}  // namespace shadowfit
