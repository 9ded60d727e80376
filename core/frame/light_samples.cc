#include "core/frame/light_samples.h"

namespace shadowfit {

void BoundarySamples::Clear() {
  for (int k = 0; k < 3; ++k) {
    r[k].clear();
    dr1[k].clear();
    dr2[k].clear();
  }
  q.clear();
  n1.clear();
  n2.clear();
  length.clear();
}

void BoundarySamples::Reserve(size_t count) {
  for (int k = 0; k < 3; ++k) {
    r[k].reserve(count);
    dr1[k].reserve(count);
    dr2[k].reserve(count);
  }
  q.reserve(count);
  n1.reserve(count);
  n2.reserve(count);
  length.reserve(count);
}

void BoundarySamples::Add(const glm::dvec3& ray, const glm::dvec3& ray_dx1, const glm::dvec3& ray_dx2,
                          double along_ray, const glm::dvec2& normal, double edge_length) {
  for (int k = 0; k < 3; ++k) {
    r[k].push_back(ray[k]);
    dr1[k].push_back(ray_dx1[k]);
    dr2[k].push_back(ray_dx2[k]);
  }
  q.push_back(along_ray);
  n1.push_back(normal.x);
  n2.push_back(normal.y);
  length.push_back(edge_length);
}

void LightSamples::Clear() {
  source = SampleSource::kNone;
  boundary.Clear();
  rough_boundary.Clear();
  hull_rays.clear();
  hull_along_ray.clear();
  hull_rays_dx1.clear();
  hull_rays_dx2.clear();
}

}  // namespace shadowfit
