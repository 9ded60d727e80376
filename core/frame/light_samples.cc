#include "core/frame/light_samples.h"

namespace shadowfit {

void BoundarySamples::Resize(size_t count) {
  for (int k = 0; k < 3; ++k) {
    r[k].resize(count);
    dr1[k].resize(count);
    dr2[k].resize(count);
  }
  q.resize(count);
  n1.resize(count);
  n2.resize(count);
  length.resize(count);
  tail.resize(count);
}

void BoundarySamples::Add(const glm::dvec3& ray, const glm::dvec3& ray_dx1, const glm::dvec3& ray_dx2,
                          double along_ray, const glm::dvec2& normal, double edge_length, double edge_tail) {
  Resize(size() + 1);
  Set(size() - 1, ray, ray_dx1, ray_dx2, along_ray, normal, edge_length, edge_tail);
}

}  // namespace shadowfit
