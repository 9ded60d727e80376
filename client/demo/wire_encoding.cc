#include "client/demo/wire_encoding.h"

namespace shadowfit {
namespace {

void Encode(const glm::dmat4& matrix, v1::Matrix4* out) {
  out->clear_m();
  for (int column = 0; column < 4; ++column) {
    for (int row = 0; row < 4; ++row) out->add_m(matrix[column][row]);
  }
}

}  // namespace

void Encode(const glm::dvec3& v, v1::Vector3* out) {
  out->set_x(v.x);
  out->set_y(v.y);
  out->set_z(v.z);
}

void Encode(const CameraMatrices& camera, v1::Camera* out) {
  Encode(camera.view_from_world, out->mutable_view());
  Encode(camera.clip_from_view, out->mutable_projection());
  out->set_clip_depth(v1::CLIP_DEPTH_NEGATIVE_ONE_TO_ONE);
}

void Encode(const Light& light, v1::Light* out) {
  if (const auto* point = std::get_if<PointLight>(&light)) {
    Encode(point->ws_position, out->mutable_point()->mutable_position());
  } else if (const auto* spot = std::get_if<SpotLight>(&light)) {
    Encode(spot->ws_position, out->mutable_spot()->mutable_position());
    Encode(spot->ws_direction, out->mutable_spot()->mutable_direction());
    out->mutable_spot()->set_outer_half_angle(spot->outer_half_angle);
  } else {
    Encode(std::get<DirectionalLight>(light).ws_direction, out->mutable_directional()->mutable_direction());
  }
}

void EncodeDepth(int width, int height, const std::vector<float>& depth, v1::DepthBuffer* out) {
  out->set_width(static_cast<uint32_t>(width));
  out->set_height(static_cast<uint32_t>(height));
  out->set_encoding(v1::DEPTH_ENCODING_FLOAT32);
  out->set_row_order(v1::ROW_ORDER_BOTTOM_FIRST);
  Encode(depth, out->mutable_data());
}

}  // namespace shadowfit
