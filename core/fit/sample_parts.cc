#include "core/fit/sample_parts.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <glm/glm.hpp>
#include <vector>

namespace shadowfit {
namespace {

constexpr std::array kBoundaries = {&LightSamples::boundary, &LightSamples::rough_boundary,
                                    &LightSamples::unseen_boundary};

/// The samples with the given indices.
BoundarySamples Some(const BoundarySamples& from, const std::vector<size_t>& indices) {
  BoundarySamples some;
  some.Resize(indices.size());
  some.limit = from.limit;
  for (size_t k = 0; k < indices.size(); ++k) {
    const size_t i = indices[k];
    some.Set(k, from.Ray(i), from.RayDx1(i), from.RayDx2(i), from.q[i], {from.n1[i], from.n2[i]},
             from.length[i], from.tail[i]);
  }
  return some;
}

void ReserveHullSamples(size_t count, LightSamples* samples) {
  samples->hull_rays.reserve(count);
  samples->hull_along_ray.reserve(count);
  samples->hull_in_shadow.reserve(count);
  samples->hull_rays_dx1.reserve(count);
  samples->hull_rays_dx2.reserve(count);
}

void CopyHullSample(const LightSamples& from, size_t i, LightSamples* to) {
  to->hull_rays.push_back(from.hull_rays[i]);
  to->hull_along_ray.push_back(from.hull_along_ray[i]);
  to->hull_in_shadow.push_back(from.hull_in_shadow[i]);
  to->hull_rays_dx1.push_back(from.hull_rays_dx1[i]);
  to->hull_rays_dx2.push_back(from.hull_rays_dx2[i]);
}

/// What holds for the whole light, and no sample.
LightSamples NoneOf(const LightSamples& samples) {
  LightSamples none;
  none.source = samples.source;
  none.pixels_per_sample = samples.pixels_per_sample;
  none.narrow_share = samples.narrow_share;
  return none;
}

/// Deals samples out by their rays: part_of(ray) is the index of a part.
template <typename PartOf>
std::vector<LightSamples> Divide(const LightSamples& samples, size_t parts, const PartOf& part_of) {
  std::vector<LightSamples> divided(parts, NoneOf(samples));
  std::vector<std::vector<size_t>> indices(parts);
  const auto deal_out = [&](BoundarySamples LightSamples::*boundary) {
    const BoundarySamples& all = samples.*boundary;
    for (std::vector<size_t>& part : indices) part.clear();
    for (size_t i = 0; i < all.size(); ++i) indices[part_of(all.Ray(i))].push_back(i);
    for (size_t k = 0; k < parts; ++k) divided[k].*boundary = Some(all, indices[k]);
  };
  for (BoundarySamples LightSamples::*boundary : kBoundaries) deal_out(boundary);
  for (size_t i = 0; i < samples.hull_rays.size(); ++i) {
    CopyHullSample(samples, i, &divided[part_of(samples.hull_rays[i])]);
  }
  return divided;
}

size_t CubeFace(const glm::dvec3& r) {
  const glm::dvec3 a = glm::abs(r);
  const int axis = a.x >= a.y && a.x >= a.z ? 0 : a.y >= a.z ? 1 : 2;
  return 2 * static_cast<size_t>(axis) + (r[axis] < 0.0 ? 1 : 0);
}

}  // namespace

std::vector<LightSamples> DivideByPlane(const LightSamples& samples, const glm::dvec3& covector) {
  return Divide(samples, 2, [&](const glm::dvec3& r) { return size_t{glm::dot(covector, r) > 0.0}; });
}

std::vector<LightSamples> DivideByCubeFaces(const LightSamples& samples) {
  return Divide(samples, 6, CubeFace);
}

LightSamples SomeSamples(const LightSamples& samples, size_t stride,
                         absl::FunctionRef<bool(const glm::dvec3&)> chosen,
                         std::span<const uint8_t> hull_samples) {
  LightSamples some = NoneOf(samples);
  std::vector<size_t> indices;
  size_t first = 0;
  for (BoundarySamples LightSamples::*boundary : kBoundaries) {
    const BoundarySamples& all = samples.*boundary;
    indices.clear();
    size_t i = first;
    for (; i < all.size(); i += stride) {
      if (chosen(all.Ray(i))) indices.push_back(i);
    }
    // The steps go on from one list to the next.
    first = i - all.size();
    some.*boundary = Some(all, indices);
    for (double& length : (some.*boundary).length) length *= static_cast<double>(stride);
  }
  ReserveHullSamples(
      hull_samples.size() - static_cast<size_t>(std::count(hull_samples.begin(), hull_samples.end(), 0)),
      &some);
  for (size_t i = 0; i < samples.hull_rays.size(); ++i) {
    if (hull_samples[i] != 0) CopyHullSample(samples, i, &some);
  }
  return some;
}

}  // namespace shadowfit
