#include <gtest/gtest.h>

#include <algorithm>
#include <glm/gtc/matrix_transform.hpp>
#include <iostream>

#include "core/fit/frame_optimizer.h"
#include "core/irregular/shadow_masks.h"
#include "core/reference/shadow_map_test.h"
#include "core/reference/truth_scene.h"
#include "core/scene/procedural.h"

namespace shadowfit {
namespace {

/// Exact answers near the edges of a shadow map's shadows, the map's answers elsewhere.
TEST(HybridMasks, CorrectTheMapWhereItErrs) {
  constexpr int kWidth = 480, kHeight = 320, kRadius = 4;
  const auto scene = MakePlaza(60000);
  ASSERT_TRUE(scene.ok()) << scene.status();
  CameraMatrices matrices;
  matrices.view_from_world =
      glm::lookAt(PlazaStandPoint().ws_eye, PlazaStandPoint().ws_target, glm::dvec3(0, 0, 1));
  matrices.clip_from_view = glm::perspective(0.9, double(kWidth) / kHeight, 0.1, 300.0);
  const Camera camera = *Camera::Create(matrices);
  const auto truth_scene = TruthScene::Create(*scene);
  ASSERT_TRUE(truth_scene.ok()) << truth_scene.status();
  const VisibleSurface surface = truth_scene->RenderSurface(camera, kWidth, kHeight);
  const Light light = PointLight{{5, -4, 14}};
  const RaySpace ray_space = *RaySpace::Create(light);
  const ShadowMask truth = truth_scene->TrueShadow(surface, ray_space);

  // 1. What a map fitted to this frame would show.
  FrameRequest frame;
  frame.camera = matrices;
  frame.depth = surface.Depth();
  frame.lights.resize(1);
  frame.lights[0].light = light;
  frame.lights[0].map_size = {512, 512};
  FrameOptimizer optimizer;
  FrameSummary summary;
  ASSERT_TRUE(optimizer.Optimize(frame, Options(), Cancellation(), &summary).ok());
  const auto map =
      ShadowFromMaps(*truth_scene, surface, truth, ray_space, {&summary.lights[0].projection, 1});
  ASSERT_TRUE(map.ok()) << map.status();
  std::vector<uint8_t> in_shadow(map->size());
  for (size_t i = 0; i < map->size(); ++i) in_shadow[i] = (*map)[i] == PixelLight::kShadowed;

  // 2. The rest is rendered.
  const std::vector<uint8_t> known = KnownAwayFromEdges(in_shadow, kWidth, kHeight, kRadius);
  const ImageView<uint8_t> known_view = BottomFirst(known.data(), kWidth, kHeight);
  const auto mask_scene = MaskScene::Create(*scene);
  ASSERT_TRUE(mask_scene.ok()) << mask_scene.status();
  ReceiverLayer layer;
  layer.depth = surface.Depth();
  MaskRequest request;
  request.scene = &*mask_scene;
  request.camera = &camera;
  request.layers = {&layer, 1};
  request.lights = {&light, 1};
  MaskRenderer exact_renderer, renderer;
  const auto exact = exact_renderer.Render(request);
  ASSERT_TRUE(exact.ok()) << exact.status();
  request.known = {&known_view, 1};
  const auto hybrid = renderer.Render(request);
  ASSERT_TRUE(hybrid.ok()) << hybrid.status();

  size_t unknown = 0, map_wrong = 0, hybrid_wrong = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const auto i = static_cast<size_t>(y * kWidth + x);
      const bool answer = (*hybrid)[0].InShadow(0, kHeight, x, y);
      if (known[i] == 0) {
        ++unknown;
        ASSERT_EQ(answer, (*exact)[0].InShadow(0, kHeight, x, y)) << x << ' ' << y;
      } else {
        ASSERT_EQ(answer, known[i] == 2) << x << ' ' << y;
      }
      if (truth[i] == PixelLight::kNotConcerned) continue;
      map_wrong += (*map)[i] != truth[i];
      hybrid_wrong += answer != (truth[i] == PixelLight::kShadowed);
    }
  }
  std::cout << "map " << map_wrong << " wrong pixels, hybrid " << hybrid_wrong << ", of " << surface.size()
            << " pixels " << unknown << " rendered exactly\n";
  EXPECT_EQ((*hybrid)[0].known_samples, surface.size() - unknown);
  EXPECT_LT(unknown, surface.size() / 3);
  EXPECT_LT(hybrid_wrong, map_wrong / 2);
}

TEST(HybridMasks, KnownAwayFromEdges) {
  // One pixel in shadow, in the middle of 7x5.
  std::vector<uint8_t> in_shadow(35, 0);
  in_shadow[2 * 7 + 3] = 1;
  const std::vector<uint8_t> known = KnownAwayFromEdges(in_shadow, 7, 5, 1);
  for (int y = 0; y < 5; ++y) {
    for (int x = 0; x < 7; ++x) {
      const bool near = std::abs(x - 3) <= 1 && std::abs(y - 2) <= 1;
      EXPECT_EQ(known[static_cast<size_t>(y * 7 + x)], near ? 0 : 1) << x << ' ' << y;
    }
  }
  EXPECT_EQ(KnownAwayFromEdges({in_shadow.data() + 17, 1}, 1, 1, 3), std::vector<uint8_t>(1, 2));
}

}  // namespace
}  // namespace shadowfit
