#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <glm/gtc/matrix_transform.hpp>
#include <limits>
#include <random>
#include <vector>

#include "core/fit/frame_optimizer.h"
#include "core/math/ray_space.h"

namespace shadowfit::testing {

/// Spheres above the ground z = 0, ray-traced in closed form: frames whose every value is known without a
/// renderer.
struct AnalyticScene {
  struct Sphere {
    glm::dvec3 center;
    double radius;
  };
  std::vector<Sphere> spheres;
  bool ground = true;

  /// Distance along the ray (direction of unit length) to the first surface beyond `least`; infinity without
  /// one.
  double Trace(const glm::dvec3& origin, const glm::dvec3& direction, double least,
               glm::dvec3* normal) const {
    double nearest = std::numeric_limits<double>::infinity();
    if (ground && direction.z != 0.0) {
      const double t = -origin.z / direction.z;
      if (t > least && t < nearest) {
        nearest = t;
        *normal = {0, 0, 1};
      }
    }
    for (const Sphere& sphere : spheres) {
      const glm::dvec3 offset = origin - sphere.center;
      const double b = glm::dot(offset, direction);
      const double discriminant = b * b - glm::dot(offset, offset) + sphere.radius * sphere.radius;
      if (discriminant < 0.0) continue;
      for (const double t : {-b - std::sqrt(discriminant), -b + std::sqrt(discriminant)}) {
        if (t > least && t < nearest) {
          nearest = t;
          *normal = glm::normalize(origin + t * direction - sphere.center);
          break;
        }
      }
    }
    return nearest;
  }
};

/// A frame with the memory that its request borrows.
struct OwnedFrame {
  std::vector<float> depth;
  std::vector<uint32_t> bits;
  FrameRequest request;
};

inline double Uniform(std::mt19937& random, double low, double high) {
  return low + (high - low) * (static_cast<double>(random()) / 4294967296.0);
}

inline glm::dvec3 UniformDirection(std::mt19937& random) {
  for (;;) {
    const glm::dvec3 v(Uniform(random, -1, 1), Uniform(random, -1, 1), Uniform(random, -1, 1));
    const double length = glm::length(v);
    if (length > 0.1 && length < 1.0) return v / length;
  }
}

/// A perspective projection in any clip convention.
inline glm::dmat4 Perspective(double fov_y, double aspect, double near_plane, double far_plane,
                              ClipDepth convention) {
  const glm::dmat4 gl = glm::perspectiveRH_NO(fov_y, aspect, near_plane, far_plane);
  glm::dmat4 depth(1.0);
  if (convention == ClipDepth::kZeroToOne) {
    depth[2][2] = 0.5;
    depth[3][2] = 0.5;
  } else if (convention == ClipDepth::kReversedZeroToOne) {
    depth[2][2] = -0.5;
    depth[3][2] = 0.5;
  }
  return depth * gl;
}

/// Draws depth and exact shadow bits (surfaces facing away from a light are not in shadow: the light does not
/// reach them).
inline OwnedFrame Draw(const AnalyticScene& scene, const CameraMatrices& matrices, int width, int height,
                       std::vector<LightRequest> lights) {
  OwnedFrame frame;
  frame.request.camera = matrices;
  frame.request.lights = std::move(lights);
  const auto pixels = static_cast<size_t>(width) * static_cast<size_t>(height);
  frame.depth.assign(pixels, static_cast<float>(BackgroundWindowDepth(matrices.clip_depth)));
  frame.bits.assign(pixels, 0);
  const Camera camera = *Camera::Create(matrices);
  std::vector<RaySpace> spaces;
  for (const LightRequest& light : frame.request.lights) spaces.push_back(*RaySpace::Create(light.light));
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const glm::dvec2 ndc((x + 0.5) * 2.0 / width - 1.0, (y + 0.5) * 2.0 / height - 1.0);
      const glm::dvec4 near_point = camera.WsFromNdc({ndc, NearNdc(matrices.clip_depth)});
      const glm::dvec4 far_point = camera.WsFromNdc({ndc, FarNdc(matrices.clip_depth)});
      const glm::dvec3 origin = glm::dvec3(near_point) / near_point.w;
      const glm::dvec3 direction = glm::normalize(glm::dvec3(far_point) / far_point.w - origin);
      glm::dvec3 normal(0.0);
      const double t = scene.Trace(origin, direction, 0.0, &normal);
      if (!(t < glm::length(glm::dvec3(far_point) / far_point.w - origin))) continue;
      const glm::dvec3 ws = origin + t * direction;
      if (glm::dot(normal, direction) > 0.0) normal = -normal;
      const glm::dvec4 clip = camera.clip_from_world() * glm::dvec4(ws, 1.0);
      const double ndc_z = clip.z / clip.w;
      const size_t pixel = static_cast<size_t>(y) * static_cast<size_t>(width) + static_cast<size_t>(x);
      frame.depth[pixel] =
          static_cast<float>(matrices.clip_depth == ClipDepth::kNegativeOneToOne ? 0.5 * ndc_z + 0.5 : ndc_z);
      for (size_t i = 0; i < spaces.size(); ++i) {
        const glm::dvec3 to_light = spaces[i].TowardsLight(ws);
        const double distance = glm::length(to_light);
        if (glm::dot(normal, to_light) <= 0.0 || !spaces[i].Illuminates(ws)) continue;
        glm::dvec3 ignored;
        const double hit = scene.Trace(ws, to_light / distance, 1e-6 * (1.0 + glm::length(ws)), &ignored);
        if (hit < (spaces[i].is_directional() ? 1e300 : distance)) frame.bits[pixel] |= uint32_t{1} << i;
      }
    }
  }
  frame.request.depth = BottomFirst(frame.depth.data(), width, height);
  frame.request.bits = BottomFirst(frame.bits.data(), width, height);
  return frame;
}

/// The ground from straight above, square, with a shadow where in_shadow(x, y) says so, whatever may cast it.
template <typename InShadow>
OwnedFrame DrawShadowOnGround(int side, const LightRequest& light, const InShadow& in_shadow) {
  const CameraMatrices matrices{glm::lookAtRH(glm::dvec3(0, 0, 10), glm::dvec3(0, 0, 0), glm::dvec3(0, 1, 0)),
                                Perspective(1.0, 1.0, 0.1, 100.0, ClipDepth::kNegativeOneToOne),
                                ClipDepth::kNegativeOneToOne};
  OwnedFrame frame = Draw(AnalyticScene{}, matrices, side, side, {light});
  for (int y = 0; y < side; ++y) {
    for (int x = 0; x < side; ++x) frame.bits[static_cast<size_t>(y * side + x)] = in_shadow(x, y) ? 1 : 0;
  }
  return frame;
}

/// A viewer standing on the ground, as in a walk-through.
inline CameraMatrices WalkThroughCamera(std::mt19937& random, ClipDepth convention, double aspect = 1.0) {
  const glm::dvec3 eye(Uniform(random, -2, 2), Uniform(random, -12, -8), Uniform(random, 1.2, 3.0));
  const glm::dvec3 target(Uniform(random, -2, 2), Uniform(random, 0, 4), Uniform(random, 0.0, 1.0));
  return {glm::lookAtRH(eye, target, glm::dvec3(0, 0, 1)),
          Perspective(Uniform(random, 0.6, 1.3), aspect, 0.1, 200.0, convention), convention};
}

inline AnalyticScene RandomSpheres(std::mt19937& random, int count) {
  AnalyticScene scene;
  for (int i = 0; i < count; ++i) {
    const double radius = Uniform(random, 0.1, 0.8);
    scene.spheres.push_back(
        {{Uniform(random, -5, 5), Uniform(random, -5, 8), radius + Uniform(random, 0.0, 1.5)}, radius});
  }
  return scene;
}

inline LightRequest RandomLight(std::mt19937& random, uint32_t id) {
  LightRequest light;
  light.id = id;
  const glm::dvec3 target(Uniform(random, -3, 3), Uniform(random, -3, 3), 0.0);
  glm::dvec3 from = UniformDirection(random);
  from.z = std::abs(from.z) + 0.05;
  const double distance = Uniform(random, 3.0, 40.0);
  switch (random() % 3) {
    case 0:
      light.light = PointLight{target + distance * from};
      break;
    case 1:
      light.light = SpotLight{target + distance * from, -from, Uniform(random, 0.1, 1.4)};
      break;
    default:
      light.light = DirectionalLight{-from};
      break;
  }
  light.map_size = {static_cast<int>(64 + random() % 900), static_cast<int>(64 + random() % 900)};
  return light;
}

}  // namespace shadowfit::testing
