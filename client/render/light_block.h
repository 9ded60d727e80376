#pragma once

#include <glm/glm.hpp>
#include <optional>
#include <span>

#include "absl/status/status.h"
#include "client/render/gl_objects.h"
#include "core/bias/standard_test.h"
#include "core/math/light.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

/// A light with its shadow map's matrix, as one frame uses it.
struct LightView {
  Light light;
  glm::dvec3 power{1.0};            ///< RGB: irradiance of a directional light, intensity of others.
  glm::dmat4 clip_from_world{1.0};  ///< Of the shadow map; OpenGL depth convention.
  MapSize map_size;
  /// The standard test, with its format that of the maps. None: the test that knows no depth errors, for
  /// which the receiver's tangent plane is compared at the texel's centre.
  std::optional<StandardTest> test = std::nullopt;
};

/// The lights of a frame in a uniform buffer, as shaders/lights.glsl declares it.
class LightBlock {
 public:
  static constexpr int kMaxLights = 32;
  static constexpr GLuint kBinding = 0;

  void Upload(std::span<const LightView> lights);
  void Bind() const { glBindBufferBase(GL_UNIFORM_BUFFER, kBinding, buffer_.name()); }

 private:
  GlBuffer buffer_;
};

}  // namespace shadowfit
