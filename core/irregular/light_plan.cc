#include "core/irregular/light_plan.h"

#include <algorithm>
#include <cmath>

#include "core/irregular/sample_layout.h"

namespace shadowfit::irregular {
namespace {

/// About this many pixels plan a light.
constexpr double kPlanningPixels = 2500.0;

/// World-from-pixel, then world to ray coordinates, as one matrix: see RayFromPixel.
void SetRayFromPixel(const Camera& camera, const LightFrame& frame, const ReceiverLayer& layer, int width,
                     int height, LayerSource* source) {
  const glm::dmat4& m = camera.world_from_clip();
  const double z0 = NdcFromWindowDepth(camera.clip_depth(), 0.0);
  const double z1 = NdcFromWindowDepth(camera.clip_depth(), 1.0);
  const glm::dvec4 col_x = m[0] * (2.0 / width);
  const glm::dvec4 col_y = m[1] * (2.0 / height);
  const glm::dvec4 col_z = m[2] * (z1 - z0);
  const glm::dvec4 base = m[3] + m[2] * z0 + m[0] * (2.0 * layer.pixel_offset.x / width - 1.0) +
                          m[1] * (2.0 * layer.pixel_offset.y / height - 1.0);
  const auto to_ray = [&frame](const glm::dvec4& column, double out[4]) {
    const glm::dvec3 from_origin = glm::dvec3(column) - column.w * frame.ws_origin;
    for (int row = 0; row < 3; ++row) {
      out[row] = frame.rotation[row][0] * from_origin.x + frame.rotation[row][1] * from_origin.y +
                 frame.rotation[row][2] * from_origin.z;
    }
    out[3] = column.w;
  };
  to_ray(base, source->ray_from_pixel.base);
  to_ray(col_x, source->ray_from_pixel.col_x);
  to_ray(col_y, source->ray_from_pixel.col_y);
  to_ray(col_z, source->ray_from_pixel.col_z);
}

glm::dvec3 ViewDirection(const Camera& camera) {
  const glm::dvec4 near = camera.WsFromNdc({0.0, 0.0, NearNdc(camera.clip_depth())});
  const glm::dvec4& eye = camera.ws_eye();
  // From the eye towards the near plane; an orthographic camera's eye is that direction already.
  const glm::dvec3 direction =
      eye.w != 0.0 ? glm::dvec3(near) / near.w - glm::dvec3(eye) / eye.w : glm::dvec3(eye);
  const double length = glm::length(direction);
  return length > 0.0 && std::isfinite(length) ? direction / length : glm::dvec3(0.0, 0.0, -1.0);
}

/// Ray coordinates of a pixel's sample; false where there is none to plan for.
bool RayOfPixel(const LightFrame& frame, const LayerSource& layer, int x, int y, glm::dvec3* r) {
  if (layer.known.bottom_row != nullptr && layer.known.Row(y)[x] != 0) return false;
  if (layer.ws_positions.bottom_row != nullptr) {
    const glm::dvec3 from_origin = glm::dvec3(layer.ws_positions.Row(y)[x]) - frame.ws_origin;
    for (int row = 0; row < 3; ++row) {
      const double* m = frame.rotation[row];
      (*r)[row] = m[0] * from_origin.x + m[1] * from_origin.y + m[2] * from_origin.z;
    }
  } else {
    const float z = layer.depth.Row(y)[x];
    if (!(z >= 0.0f && z <= 1.0f) || z == layer.background) return false;
    const RayFromPixel& m = layer.ray_from_pixel;
    double h[4];
    for (int i = 0; i < 4; ++i) {
      h[i] = m.base[i] + x * m.col_x[i] + y * m.col_y[i] + static_cast<double>(z) * m.col_z[i];
    }
    *r = glm::dvec3(h[0], h[1], h[2]) / h[3];
  }
  const double length2 = glm::dot(*r, *r);
  if (!(length2 < 1e34)) return false;
  if (frame.has_cone && !(r->z >= frame.cos_outer * std::sqrt(length2))) return false;
  if (layer.ws_normals.bottom_row == nullptr) return true;
  const glm::dvec3 n(layer.ws_normals.Row(y)[x]);
  glm::dvec3 n_ray;
  for (int row = 0; row < 3; ++row) {
    const double* m = frame.rotation[row];
    n_ray[row] = m[0] * n.x + m[1] * n.y + m[2] * n.z;
  }
  return !((frame.directional ? n_ray.z : glm::dot(n_ray, *r)) > 0.0);
}

}  // namespace

void LightPlan::SetUpLayers(const MaskRequest& request, size_t light) {
  layers.resize(request.layers.size());
  for (size_t i = 0; i < layers.size(); ++i) {
    LayerSource& source = layers[i];
    const ReceiverLayer& layer = request.layers[i];
    source = LayerSource{};
    source.depth = layer.depth;
    source.ws_positions = layer.ws_positions;
    source.ws_normals = layer.ws_normals;
    if (!request.known.empty()) source.known = request.known[light * layers.size() + i];
    if (layer.ws_positions.bottom_row == nullptr) {
      source.background = static_cast<float>(BackgroundWindowDepth(request.camera->clip_depth()));
    }
    // Three roundings of the projection beside the format's own.
    source.depth_relative_error = 3.0f * kUnitRoundoff;
    switch (request.depth_precision) {
      case DepthPrecision::kFloat32:
        source.depth_relative_error += kUnitRoundoff;
        break;
      case DepthPrecision::kUnorm24:
        source.depth_absolute_error = 0.5f / 16777215.0f;
        break;
      case DepthPrecision::kUnorm16:
        source.depth_absolute_error = 0.5f / 65535.0f;
        break;
      case DepthPrecision::kFloat16:
        source.depth_relative_error += 0x1p-11f;
        source.depth_absolute_error = 0x1p-25f;
        break;
    }
  }
}

void LightPlan::SetMatrices(const MaskRequest& request) {
  const glm::dvec3 origin = glm::abs(frame.ws_origin);
  const double extent = std::max({origin.x, origin.y, origin.z});
  for (size_t i = 0; i < layers.size(); ++i) {
    layers[i].origin_error = static_cast<float>(4.0 * static_cast<double>(kUnitRoundoff) * extent);
    if (layers[i].ws_positions.bottom_row != nullptr) continue;
    SetRayFromPixel(*request.camera, frame, request.layers[i], layers[i].depth.width, layers[i].depth.height,
                    &layers[i]);
  }
}

void LightPlan::CollectRays(const MaskRequest& request) {
  const ImageView<glm::vec3>& positions = layers[0].ws_positions;
  const int width = positions.bottom_row != nullptr ? positions.width : layers[0].depth.width;
  const int height = positions.bottom_row != nullptr ? positions.height : layers[0].depth.height;
  const double pixels = static_cast<double>(width) * height * static_cast<double>(layers.size());
  const int stride = std::max(1, static_cast<int>(std::sqrt(pixels / kPlanningPixels)));
  rays_.clear();
  // One pixel of each square, anywhere in it: pixels in step would tell little of what is between them.
  uint32_t random = 1;
  const auto next = [&random, stride] {
    random = random * 1664525u + 1013904223u;
    return static_cast<int>((random >> 16) % static_cast<uint32_t>(stride));
  };
  glm::dvec3 r;
  for (const LayerSource& layer : layers) {
    for (int y0 = 0; y0 < height; y0 += stride) {
      if (IsCancelled(request.cancellation)) return;
      for (int x0 = 0; x0 < width; x0 += stride) {
        const int x = x0 + next(), y = y0 + next();
        if (x >= width || y >= height) continue;
        if (RayOfPixel(frame, layer, x, y, &r)) rays_.emplace_back(r);
      }
    }
  }
}

/// Ray coordinates whose third axis looks towards the samples, if they all lie to one side of the light.
void LightPlan::Plan(const MaskRequest& request, size_t light, const RaySpace& ray_space) {
  SetUpLayers(request, light);
  frame = LightFrame{};
  frame.directional = ray_space.is_directional();
  if (!frame.directional) frame.ws_origin = ray_space.ws_position();
  if (ray_space.cos_outer()) {
    frame.has_cone = true;
    frame.cos_outer = *ray_space.cos_outer();
  }
  const glm::dvec3 hint = request.camera != nullptr ? ViewDirection(*request.camera) : glm::dvec3(0, 1, 0);
  if (frame.directional || frame.has_cone) BasisAround(ray_space.ws_direction(), hint, frame.rotation);
  SetMatrices(request);
  CollectRays(request);
  int count = 6;
  if (frame.directional) {
    count = 1;
    // Only the exact value of what is subtracted matters: single precision, so that casters lose nothing by
    // it.
    glm::dvec3 sum(0.0);
    for (const glm::vec3& ray : rays_) sum += glm::dvec3(ray);
    const glm::dvec3 centre = sum / std::max(static_cast<double>(rays_.size()), 1.0);
    for (int row = 0; row < 3; ++row) {
      const double* axis = frame.rotation[row];
      frame.ws_origin += centre[row] * glm::dvec3(axis[0], axis[1], axis[2]);
    }
    frame.ws_origin = glm::dvec3(glm::vec3(frame.ws_origin));
    if (!std::isfinite(glm::dot(frame.ws_origin, frame.ws_origin))) frame.ws_origin = glm::dvec3(0.0);
    SetMatrices(request);
  } else if (frame.has_cone) {
    count = frame.cos_outer >= 0.4 ? 1 : 6;
  } else {
    const glm::dvec3 axis = rays_.empty() ? glm::dvec3(0, 0, 1) : SingleFaceAxis(rays_);
    if (axis != glm::dvec3(0.0)) {
      count = 1;
      BasisAround(axis, hint, frame.rotation);
      SetMatrices(request);
    }
  }
  SetUpFaces(count);
}

void LightPlan::SetUpFaces(int count) {
  face_count = count;
  for (int f = 0; f < count; ++f) {
    Face& face = faces[static_cast<size_t>(f)];
    face.axis = count == 1 ? 2 : f / 2;
    face.sign = count == 1 || f % 2 == 0 ? 1.0 : -1.0;
    for (int row = 0; row < 3; ++row) {
      for (int i = 0; i < 3; ++i) {
        face.rotation[row][i] = frame.rotation[(face.axis + 1 + row) % 3][i] * (row == 2 ? face.sign : 1.0);
      }
    }
  }
}

void LightPlan::UseSixFaces() { SetUpFaces(6); }

}  // namespace shadowfit::irregular
