#include "client/render/light_block.h"

#include <algorithm>
#include <cmath>

namespace shadowfit {
namespace {

/// std140 twins of the structures in shaders/lights.glsl.
struct GpuLight {
  glm::mat4 clip_from_world{1.0f};
  glm::vec4 ws_position{0.0f};
  glm::vec4 ws_axis{0.0f, 0.0f, 0.0f, -2.0f};
  glm::vec4 power{0.0f};
  glm::vec4 map_size{0.0f};
  glm::vec4 test{0.0f};
  glm::vec4 bias{0.0f};
};
struct GpuLights {
  GpuLight lights[LightBlock::kMaxLights];
  glm::ivec4 light_count{0};
};

void Place(const PointLight& light, GpuLight* gpu) { gpu->ws_position = glm::vec4(light.ws_position, 1.0f); }
void Place(const SpotLight& light, GpuLight* gpu) {
  gpu->ws_position = glm::vec4(light.ws_position, 1.0f);
  gpu->ws_axis =
      glm::vec4(glm::normalize(light.ws_direction), static_cast<float>(std::cos(light.outer_half_angle)));
}
void Place(const DirectionalLight& light, GpuLight* gpu) {
  gpu->ws_position = glm::vec4(-glm::normalize(light.ws_direction), 0.0f);
}

}  // namespace

void LightBlock::Upload(std::span<const LightView> lights) {
  GpuLights block;
  block.light_count.x = static_cast<int>(lights.size());
  for (size_t i = 0; i < lights.size(); ++i) {
    const LightView& view = lights[i];
    GpuLight& gpu = block.lights[i];
    std::visit([&](const auto& light) { Place(light, &gpu); }, view.light);
    gpu.clip_from_world = glm::mat4(view.clip_from_world);
    gpu.power = glm::vec4(view.power, 0.0f);
    if (view.test) {
      gpu.test = glm::vec4(1.0f + static_cast<float>(view.test->bias), view.test->pcf_radius,
                           static_cast<float>(view.test->kernel), 0.0f);
      gpu.bias = glm::vec4(view.test->constant, view.test->slope, std::min(view.test->clamp, 1e30), 0.0f);
    }
    gpu.map_size = glm::vec4(view.map_size.width, view.map_size.height, 0.0f, 0.0f);
  }
  glBindBuffer(GL_UNIFORM_BUFFER, buffer_.name());
  glBufferData(GL_UNIFORM_BUFFER, sizeof(block), &block, GL_DYNAMIC_DRAW);
}

}  // namespace shadowfit
