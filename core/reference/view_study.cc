#include "core/reference/view_study.h"

#include <algorithm>

#include "core/reference/shadow_map_test.h"

namespace shadowfit {

ViewStudy ViewStudy::Create(const TruthScene& scene, const Camera& camera, MapSize screen_size,
                            MapSize sample_size) {
  return {camera, scene.RenderSurface(camera, screen_size.width, screen_size.height),
          scene.RenderSurface(camera, sample_size.width, sample_size.height)};
}

absl::StatusOr<LightStudy> LightStudy::Create(const TruthScene& scene, const ViewStudy& view,
                                              const Light& light) {
  const absl::StatusOr<RaySpace> ray_space = RaySpace::Create(light);
  if (!ray_space.ok()) return ray_space.status();
  LightStudy study;
  study.light = light;
  study.ray_space = *ray_space;
  study.screen = scene.TrueShadow(view.screen, *ray_space);
  WriteBit(scene.TrueShadow(view.samples, *ray_space), 0, &study.bits);
  study.shadowed_pixels = int(std::ranges::count(study.screen, PixelLight::kShadowed));
  study.concerned_pixels = study.shadowed_pixels + int(std::ranges::count(study.screen, PixelLight::kLit));
  return study;
}

absl::StatusOr<int> WrongPixels(const TruthScene& scene, const ViewStudy& view, const LightStudy& light,
                                std::span<const ShadowProjection> projections) {
  const absl::StatusOr<ShadowMask> mask =
      ShadowFromMaps(scene, view.screen, light.screen, light.ray_space, projections);
  if (!mask.ok()) return mask.status();
  return CountWrongPixels(light.screen, *mask);
}

void WriteBit(const ShadowMask& mask, int bit, std::vector<uint32_t>* bits) {
  bits->resize(mask.size());
  const uint32_t value = uint32_t{1} << bit;
  for (size_t i = 0; i < mask.size(); ++i) {
    (*bits)[i] = mask[i] == PixelLight::kShadowed ? (*bits)[i] | value : (*bits)[i] & ~value;
  }
}

}  // namespace shadowfit
