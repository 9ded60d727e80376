#include "core/reference/artefacts.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "core/reference/shadow_map_test.h"

namespace shadowfit {
namespace {

double LargestComponent(const glm::dvec3& v) {
  return std::max({std::abs(v.x), std::abs(v.y), std::abs(v.z)});
}

/// Follows a texel's ray past faces of the wrong kind.
class FaceFinder {
 public:
  FaceFinder(const TruthScene& scene, CasterFaces casters) : scene_(scene), casters_(casters) {
    const Bounds& bounds = scene.ws_bounds();
    step_ =
        bounds.empty() ? 1.0 : 1e-6 * std::max(LargestComponent(bounds.min), LargestComponent(bounds.max));
  }

  bool Counts(uint32_t primitive, const glm::dvec3& direction) const {
    if (casters_ == CasterFaces::kBoth) return true;
    const bool front = glm::dot(scene_.WindingNormal(primitive), direction) < 0.0;
    return front == (casters_ == CasterFaces::kFront);
  }

  /// `t` and `primitive` are the first hit on the ray, and become the first that counts.
  void Advance(const RaySpace::WsRay& ray, double* t, uint32_t* primitive) const {
    const double step = step_ / glm::length(ray.direction);
    while (!Counts(*primitive, ray.direction)) {
      const double start = *t + step;
      const auto hit = scene_.FirstHit(ray.origin + start * ray.direction, ray.direction);
      if (!hit) {
        *t = CasterMap::kNothing;
        *primitive = kNoPrimitive;
        return;
      }
      *t = start + hit->distance;
      *primitive = hit->primitive;
    }
  }

 private:
  const TruthScene& scene_;
  const CasterFaces casters_;
  double step_;
};

/// Calls answer(i, receiver) for every concerned pixel that falls on the map.
template <typename Answer>
ShadowMask TestPixels(const StandardMap& map, const VisibleSurface& surface, const ShadowMask& truth,
                      const RaySpace& ray_space, const Answer& answer) {
  const ReceiverProjector projector(ray_space, map.casters.projection, map.range);
  ShadowMask mask(surface.size(), PixelLight::kNotConcerned);
  tbb::parallel_for(tbb::blocked_range<size_t>(0, surface.size(), 4096), [&](const auto& pixels) {
    for (size_t i = pixels.begin(); i != pixels.end(); ++i) {
      if (truth[i] == PixelLight::kNotConcerned) continue;
      const auto receiver = projector.Project(surface.ws_point[i], surface.ws_normal[i]);
      mask[i] = receiver && answer(i, *receiver) ? PixelLight::kShadowed : PixelLight::kLit;
    }
  });
  return mask;
}

/// Whether the weighty half of the taps around a receiver are in shadow; shadowed(texel, depth of the
/// receiver's tangent plane at the texel's centre) says it of one.
template <typename Shadowed>
bool MostAreShadowed(const StandardMap& map, int radius, PcfKernel kernel, const ReceiverDepth& receiver,
                     const Shadowed& shadowed) {
  const MapSize size = map.casters.projection.size;
  const int centre_x = static_cast<int>(receiver.texel.x);
  const int centre_y = static_cast<int>(receiver.texel.y);
  const auto weight = [&](int offset) {
    return kernel == PcfKernel::kTent ? radius + 1 - std::abs(offset) : 1;
  };
  int in_shadow = 0;
  for (int y = std::max(0, centre_y - radius); y <= std::min(size.height - 1, centre_y + radius); ++y) {
    for (int x = std::max(0, centre_x - radius); x <= std::min(size.width - 1, centre_x + radius); ++x) {
      const glm::dvec2 offset = glm::dvec2(x + 0.5, y + 0.5) - receiver.texel;
      if (!shadowed(x, y, receiver.depth + glm::dot(receiver.slope, offset))) continue;
      in_shadow += weight(x - centre_x) * weight(y - centre_y);
    }
  }
  const int side =
      kernel == PcfKernel::kTent ? (radius + 1) * (radius + 1) : 2 * radius + 1;  // Sum of weights.
  return 2 * in_shadow > side * side;
}

}  // namespace

absl::StatusOr<StandardMap> RenderStandardMap(const TruthScene& scene, const RaySpace& ray_space,
                                              const ShadowProjection& projection, const DepthRange& range,
                                              CasterFaces casters) {
  absl::StatusOr<CasterMap> rendered = scene.RenderCasters(ray_space, projection);
  if (!rendered.ok()) return rendered.status();
  StandardMap map{.casters = *std::move(rendered), .range = range, .depth = {}};
  map.depth.assign(map.casters.primitive.size(), 1.0);
  const FaceFinder faces(scene, casters);
  tbb::parallel_for(0, projection.size.height, [&](int y) {
    for (int x = 0; x < projection.size.width; ++x) {
      const size_t texel =
          static_cast<size_t>(y) * static_cast<size_t>(projection.size.width) + static_cast<size_t>(x);
      uint32_t& primitive = map.casters.primitive[texel];
      if (primitive == kNoPrimitive) continue;
      const RaySpace::WsRay ray = map.casters.TexelRay(ray_space, x, y);
      double& t = map.casters.along_ray[texel];
      faces.Advance(ray, &t, &primitive);
      if (primitive == kNoPrimitive) continue;
      const glm::dvec3 ws_point = ray.origin + t * ray.direction;
      const double w = glm::dot(projection.Axis(), ray_space.RayFromPoint(ws_point));
      map.depth[texel] = WindowDepth(range, ray_space.AlongRay(ws_point), w);
    }
  });
  return map;
}

ShadowMask ShadowFromStandardMap(const StandardMap& map, const StandardTest& test,
                                 const VisibleSurface& surface, const ShadowMask& truth,
                                 const RaySpace& ray_space) {
  std::vector<double> stored(map.depth.size());
  for (size_t i = 0; i < stored.size(); ++i) stored[i] = StoredDepth(test.format, map.depth[i]);
  return TestPixels(map, surface, truth, ray_space, [&](size_t, const ReceiverDepth& receiver) {
    double bias = test.constant;
    if (test.bias == BiasKind::kSlopeScaled)
      bias = std::min(bias + test.slope * receiver.Steepness(), test.clamp);
    return MostAreShadowed(
        map, test.pcf_radius, test.kernel, receiver, [&](int x, int y, double plane_depth) {
          const double compared = test.bias == BiasKind::kReceiverPlane ? plane_depth : receiver.depth;
          // A renderer clamps what it compares to the range that the map can hold.
          const auto texel = static_cast<size_t>(y) * static_cast<size_t>(map.casters.projection.size.width) +
                             static_cast<size_t>(x);
          return stored[texel] < std::min(1.0, compared - bias);
        });
  });
}

ShadowMask ShadowWithoutDepthErrors(const StandardMap& map, int pcf_radius, const VisibleSurface& surface,
                                    const ShadowMask& truth, const RaySpace& ray_space, PcfKernel kernel) {
  return TestPixels(map, surface, truth, ray_space, [&](size_t i, const ReceiverDepth& receiver) {
    return MostAreShadowed(map, pcf_radius, kernel, receiver, [&](int x, int y, double) {
      return TexelShadows(map.casters, ray_space, x, y, surface.primitive[i], surface.ws_point[i],
                          surface.ws_normal[i], /*facet_slope=*/0.0);
    });
  });
}

ArtefactCounts CountArtefacts(const ShadowMask& truth, const ShadowMask& ideal, const ShadowMask& shown) {
  ArtefactCounts counts;
  for (size_t i = 0; i < truth.size(); ++i) {
    if (shown[i] == truth[i]) continue;
    if (ideal[i] != truth[i]) {
      ++counts.jagged;
    } else if (shown[i] == PixelLight::kShadowed) {
      ++counts.acne;
    } else {
      ++counts.peter_panning;
    }
  }
  return counts;
}

int CountFlicker(const ShadowMask& truth_before, const ShadowMask& before, const ShadowMask& truth_after,
                 const ShadowMask& after) {
  int flicker = 0;
  for (size_t i = 0; i < before.size(); ++i) {
    flicker += truth_before[i] == truth_after[i] && before[i] != after[i] ? 1 : 0;
  }
  return flicker;
}

}  // namespace shadowfit
