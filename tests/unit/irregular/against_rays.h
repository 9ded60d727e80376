#pragma once

#include <gtest/gtest.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <glm/gtc/matrix_transform.hpp>
#include <iostream>
#include <string>
#include <vector>

#include "core/irregular/shadow_masks.h"
#include "core/reference/truth_scene.h"
#include "core/scene/procedural.h"
#include "tests/unit/irregular/mask_oracle.h"

namespace shadowfit::oracle {

/// Far outside the triangle as the light sees it; spares the careful test.
inline bool ClearlyMisses(const Triangle& triangle, const RaySpace& ray_space, const glm::dvec3& r,
                          double margin) {
  glm::dvec3 v[3];
  for (int i = 0; i < 3; ++i) v[i] = ray_space.RayFromPoint(glm::dvec3(triangle.corners[i]));
  const double turn = glm::dot(glm::cross(v[0], v[1]), v[2]) < 0.0 ? -1.0 : 1.0;
  for (int i = 0; i < 3; ++i) {
    const glm::dvec3 edge = glm::cross(v[i], v[(i + 1) % 3]);
    if (turn * glm::dot(edge, r) < -margin * glm::length(edge) * glm::length(r)) return true;
  }
  return false;
}

/// How masks compare with Embree's shadow rays.
struct RayComparison {
  size_t samples = 0, shadowed = 0;
  size_t differing = 0;  ///< Not excused.
  size_t excused = 0;  ///< Differ, but some ray within the stated bounds of theirs meets an edge or surface.
  size_t confirmed =
      0;  ///< Of those excused: extended precision agrees with the mask, at the depth's sample.
  size_t undecided = 0;

  void Add(const RayComparison& other) {
    samples += other.samples;
    shadowed += other.shadowed;
    differing += other.differing;
    excused += other.excused;
    confirmed += other.confirmed;
    undecided += other.undecided;
  }
  void Print(const std::string& name) const {
    std::cout << name << ": " << samples << " samples, " << shadowed << " in shadow, " << differing
              << " differ, " << excused << " more within the bound of an edge or surface (" << confirmed
              << " of them as in extended precision), " << undecided << " undecided" << std::endl;
  }
};

/// Masks of a scene against Embree's shadow rays, which start from the exact surface and skip its own
/// triangle. Also renders with `bsp`, and with one thread: bitwise the same.
inline RayComparison CompareWithRays(const Scene& scene, const StandPoint& stand_point, const Light& light,
                                     int width, int height) {
  RayComparison counts;
  CameraMatrices matrices;
  matrices.view_from_world = glm::lookAt(stand_point.ws_eye, stand_point.ws_target, glm::dvec3(0, 0, 1));
  matrices.clip_from_view = glm::perspective(0.9, double(width) / height, 0.1, 300.0);
  const Camera camera = *Camera::Create(matrices);
  const auto truth_scene = TruthScene::Create(scene);
  EXPECT_TRUE(truth_scene.ok()) << truth_scene.status();
  if (!truth_scene.ok()) return counts;
  const VisibleSurface surface = truth_scene->RenderSurface(camera, width, height);
  const RaySpace ray_space = *RaySpace::Create(light);
  const ShadowMask truth = truth_scene->TrueShadow(surface, ray_space);

  const auto mask_scene = MaskScene::Create(scene);
  EXPECT_TRUE(mask_scene.ok()) << mask_scene.status();
  if (!mask_scene.ok()) return counts;
  ReceiverLayer layer;
  layer.depth = surface.Depth();
  MaskRequest request;
  request.scene = &*mask_scene;
  request.camera = &camera;
  request.layers = {&layer, 1};
  request.lights = {&light, 1};
  MaskRenderer renderer, bsp;
  const auto masks = renderer.Render(request);
  EXPECT_TRUE(masks.ok()) << masks.status();
  if (!masks.ok()) return counts;
  const LightMask& mask = (*masks)[0];
  request.method = MaskMethod::kBsp;
  tbb::task_arena(1).execute([&] {
    const auto bsp_masks = bsp.Render(request);
    EXPECT_TRUE(bsp_masks.ok()) << bsp_masks.status();
    if (!bsp_masks.ok()) return;
    EXPECT_TRUE(std::equal(mask.bits.begin(), mask.bits.end(), (*bsp_masks)[0].bits.begin()));
    EXPECT_EQ(mask.undecided_samples, (*bsp_masks)[0].undecided_samples);
  });

  const std::vector<Triangle> triangles = Flatten(scene);
  Real reach = 0;
  for (size_t i = 0; i < surface.size(); ++i) {
    if (surface.primitive[i] != kNoPrimitive)
      reach = std::max<Real>(reach, 2 * glm::length(surface.ws_point[i]));
  }
  counts.undecided = mask.undecided_samples;
  for (size_t i = 0; i < surface.size(); ++i) {
    if (truth[i] == PixelLight::kNotConcerned) continue;
    ++counts.samples;
    counts.shadowed += truth[i] == PixelLight::kShadowed;
    const int x = int(i) % width, y = int(i) / width;
    const bool in_shadow = mask.InShadow(0, height, x, y);
    if (in_shadow == (truth[i] == PixelLight::kShadowed)) continue;
    // How far the sample may be from the surface: its depth's four roundings along the view ray, and the
    // roundings of coordinates; see shadow_masks.h.
    const glm::dvec3 ndc((x + 0.5) * 2.0 / width - 1.0, (y + 0.5) * 2.0 / height - 1.0,
                         2.0 * double(surface.depth[i]) - 1.0);
    const glm::dvec4 at = camera.WsFromNdc(ndc);
    const glm::dvec4 beyond = camera.WsFromNdc(ndc + glm::dvec3(0, 0, 1e-6));
    const glm::dvec3 point = glm::dvec3(at) / at.w;
    const Real slope = glm::length(glm::dvec3(beyond) / beyond.w - point) / 1e-6;
    const Real depth_error = slope * 2 * 4 * kRoundoff * surface.depth[i];
    const Real distance = ray_space.is_directional() ? reach : glm::length(point - ray_space.ws_position());
    const Real bound =
        depth_error +
        kRoundoff * (16 * distance + 4 * std::max<Real>(reach, glm::length(ray_space.ws_position())));
    const double margin =
        1e-5 + 2.0 * double(bound) / std::max(glm::length(ray_space.RayFromPoint(point)), 1e-30);
    bool within = false, blocked = false;
    for (size_t t = 0; t < triangles.size(); ++t) {
      if (t == surface.primitive[i] ||
          ClearlyMisses(triangles[t], ray_space, ray_space.RayFromPoint(point), margin)) {
        continue;
      }
      const Answer answer = Blocks(triangles[t], light, point, 1.5L * bound, 1.5L * bound, reach, bound);
      within = within || answer == Answer::kUnsure || answer == Answer::kOnSurface;
      blocked = blocked || Blocks(triangles[t], light, point, 0, 0, 0) == Answer::kBlocked;
    }
    within ? ++counts.excused : ++counts.differing;
    counts.confirmed += within && blocked == in_shadow;
  }
  return counts;
}

/// ... of which none may differ beyond the bounds, and few within them.
inline void ExpectEqualToRays(const std::string& name, const Scene& scene, const StandPoint& stand_point,
                              const Light& light, int width = 320, int height = 240) {
  const RayComparison counts = CompareWithRays(scene, stand_point, light, width, height);
  counts.Print(name);
  EXPECT_EQ(counts.differing, 0u) << name;
  EXPECT_LT(counts.excused, counts.samples / 200) << name;
  EXPECT_GT(counts.shadowed, counts.samples / 100) << name;
  EXPECT_LT(counts.shadowed, counts.samples) << name;
}

}  // namespace shadowfit::oracle
