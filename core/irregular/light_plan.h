#pragma once

#include <array>
#include <glm/glm.hpp>
#include <vector>

#include "core/irregular/mask_types.h"
#include "core/irregular/sample_kernels.h"
#include "core/irregular/shadow_masks.h"
#include "core/math/ray_space.h"

namespace shadowfit::irregular {

/// What all pieces of a light's mask share: its coordinates, and how pixels get there.
struct LightPlan {
  LightFrame frame;
  int face_count = 1;
  std::array<Face, 6> faces;  ///< Their axes; pieces lay out cells of their own.
  std::vector<LayerSource> layers;

  /// One face if a few of the visible samples say that it will do. The same for any number of threads.
  void Plan(const MaskRequest& request, size_t light, const RaySpace& ray_space);
  /// After all, samples lie in all directions.
  void UseSixFaces();

 private:
  void SetUpLayers(const MaskRequest& request, size_t light);
  void SetMatrices(const MaskRequest& request);
  void SetUpFaces(int count);
  void CollectRays(const MaskRequest& request);

  std::vector<glm::vec3> rays_;
};

}  // namespace shadowfit::irregular
