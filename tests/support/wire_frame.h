#pragma once

#include <cmath>
#include <cstring>
#include <glm/gtc/packing.hpp>
#include <random>
#include <string>
#include <variant>

#include "shadowfit/v1/frame.pb.h"
#include "tests/support/analytic_scene.h"

namespace shadowfit::testing {

inline void SetVector(const glm::dvec3& from, v1::Vector3* to) {
  to->set_x(from.x);
  to->set_y(from.y);
  to->set_z(from.z);
}

inline void SetMatrix(const glm::dmat4& from, v1::Matrix4* to) {
  to->clear_m();
  for (int i = 0; i < 16; ++i) to->add_m(from[i / 4][i % 4]);
}

inline v1::ClipDepth WireClipDepth(ClipDepth convention) {
  return static_cast<v1::ClipDepth>(static_cast<int>(convention) + v1::CLIP_DEPTH_NEGATIVE_ONE_TO_ONE);
}

inline void AppendSample(v1::DepthEncoding encoding, float depth, std::string* data) {
  const auto append = [data](auto value) {
    data->append(reinterpret_cast<const char*>(&value), sizeof(value));
  };
  switch (encoding) {
    case v1::DEPTH_ENCODING_FLOAT16:
      append(static_cast<uint16_t>(glm::packHalf1x16(depth)));
      break;
    case v1::DEPTH_ENCODING_UNORM16:
      append(static_cast<uint16_t>(std::lround(double{depth} * 65535.0)));
      break;
    case v1::DEPTH_ENCODING_UNORM24:
      // A stencil value in the high byte, as depth-stencil buffers have it.
      append(static_cast<uint32_t>(std::lround(double{depth} * 16777215.0)) | 0xAB000000U);
      break;
    default:
      append(depth);
  }
}

inline void SetLight(const LightRequest& from, v1::Light* to) {
  to->set_id(from.id);
  if (const auto* point = std::get_if<PointLight>(&from.light)) {
    SetVector(point->ws_position, to->mutable_point()->mutable_position());
  } else if (const auto* spot = std::get_if<SpotLight>(&from.light)) {
    SetVector(spot->ws_position, to->mutable_spot()->mutable_position());
    SetVector(spot->ws_direction, to->mutable_spot()->mutable_direction());
    to->mutable_spot()->set_outer_half_angle(spot->outer_half_angle);
  } else {
    SetVector(std::get<DirectionalLight>(from.light).ws_direction,
              to->mutable_directional()->mutable_direction());
  }
  to->mutable_shadow_map()->set_width(static_cast<uint32_t>(from.map_size.width));
  to->mutable_shadow_map()->set_height(static_cast<uint32_t>(from.map_size.height));
  if (from.previous_clip_from_world) {
    SetMatrix(*from.previous_clip_from_world, to->mutable_previous_world_to_shadow_clip());
  }
}

/// A core request as it travels.
inline v1::Frame WireFrame(uint64_t frame_id, const FrameRequest& request,
                           v1::DepthEncoding encoding = v1::DEPTH_ENCODING_FLOAT32,
                           v1::RowOrder row_order = v1::ROW_ORDER_BOTTOM_FIRST) {
  v1::Frame frame;
  frame.set_frame_id(frame_id);
  SetMatrix(request.camera.view_from_world, frame.mutable_camera()->mutable_view());
  SetMatrix(request.camera.clip_from_view, frame.mutable_camera()->mutable_projection());
  frame.mutable_camera()->set_clip_depth(WireClipDepth(request.camera.clip_depth));
  const int width = request.depth.width;
  const int height = request.depth.height;
  const auto memory_row = [&](int y) { return row_order == v1::ROW_ORDER_TOP_FIRST ? height - 1 - y : y; };
  v1::DepthBuffer& depth = *frame.mutable_depth();
  depth.set_width(static_cast<uint32_t>(width));
  depth.set_height(static_cast<uint32_t>(height));
  depth.set_encoding(encoding);
  depth.set_row_order(row_order);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      AppendSample(encoding, request.depth.At(x, memory_row(y)), depth.mutable_data());
    }
  }
  if (request.bits) {
    v1::BitBuffer& bits = *frame.mutable_shadow_bits();
    bits.set_width(static_cast<uint32_t>(width));
    bits.set_height(static_cast<uint32_t>(height));
    bits.set_row_order(row_order);
    for (int y = 0; y < height; ++y) {
      bits.mutable_data()->append(reinterpret_cast<const char*>(request.bits->Row(memory_row(y))),
                                  static_cast<size_t>(width) * sizeof(uint32_t));
    }
  }
  for (const LightRequest& light : request.lights) SetLight(light, frame.add_lights());
  frame.mutable_options()->set_output_clip_depth(WireClipDepth(request.output_clip_depth));
  return frame;
}

/// A drawn frame of a random scene: `lights` lights with ids 100, 101, ...
inline OwnedFrame RandomFrame(uint32_t seed, int width, int height, int lights) {
  std::mt19937 random(seed);
  const AnalyticScene scene = RandomSpheres(random, 8);
  std::vector<LightRequest> requests;
  for (int i = 0; i < lights; ++i) requests.push_back(RandomLight(random, 100 + static_cast<uint32_t>(i)));
  const CameraMatrices camera =
      WalkThroughCamera(random, ClipDepth::kNegativeOneToOne, static_cast<double>(width) / height);
  return Draw(scene, camera, width, height, std::move(requests));
}

/// Frame `step` of a slow walk through one random scene with `lights` lights that stand still.
inline OwnedFrame WalkFrame(uint32_t seed, int step, int width, int height, int lights) {
  std::mt19937 random(seed);
  const AnalyticScene scene = RandomSpheres(random, 8);
  std::vector<LightRequest> requests;
  for (int i = 0; i < lights; ++i) requests.push_back(RandomLight(random, 100 + static_cast<uint32_t>(i)));
  CameraMatrices camera =
      WalkThroughCamera(random, ClipDepth::kNegativeOneToOne, static_cast<double>(width) / height);
  camera.view_from_world = glm::translate(camera.view_from_world, glm::dvec3(0.01 * step, 0.02 * step, 0.0));
  return Draw(scene, camera, width, height, std::move(requests));
}

/// Matrices must agree to the last bit, so they are compared as bytes.
inline std::string MatrixBytes(const v1::FrameResult& result) {
  std::string bytes;
  for (const v1::LightResult& light : result.lights()) {
    const auto& m = light.world_to_shadow_clip().m();
    bytes.append(reinterpret_cast<const char*>(m.data()), static_cast<size_t>(m.size()) * sizeof(double));
  }
  return bytes;
}

inline std::string MatrixBytes(const FrameSummary& summary) {
  std::string bytes;
  for (const LightSummary& light : summary.lights) {
    bytes.append(reinterpret_cast<const char*>(&light.clip_from_world[0][0]), 16 * sizeof(double));
  }
  return bytes;
}

}  // namespace shadowfit::testing
