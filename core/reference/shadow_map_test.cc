#include "core/reference/shadow_map_test.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <vector>

namespace shadowfit {
namespace {

/// Neighbouring triangles of a flat surface differ from the tangent plane by the rounding of their float
/// vertices: casters that are nearer by less than this share of the coordinates' size do not count.
constexpr double kRelativeTolerance = 1e-5;

/// Neighbouring triangles of a curved surface rise above the tangent plane: by less than this share of the
/// distance to them, up to dihedral angles of 11 degrees. Every renderer's bias covers as much; where it does
/// not, that is a depth error, which the counts of artefacts hold, and not the matrix's.
constexpr double kFacetSlope = 0.2;

/// A facet that rises so little is about as far from the point as the texel's ray meets the plane: casters
/// farther away than this many times that distance are no facets, however little they rise. Where the light
/// grazes a plane, all casters do.
constexpr double kFacetReach = 1.25;

}  // namespace

bool TexelShadows(const CasterMap& map, const RaySpace& ray_space, int x, int y, uint32_t primitive,
                  const glm::dvec3& ws_point, const glm::dvec3& ws_normal, double facet_slope) {
  const size_t texel = size_t(y) * size_t(map.projection.size.width) + size_t(x);
  if (map.primitive[texel] == kNoPrimitive || map.primitive[texel] == primitive) return false;
  const RaySpace::WsRay ray = map.TexelRay(ray_space, x, y);
  // The light falls onto the plane from its front. A ray that runs alongside it or away from it stays in
  // front for ever: the plane is infinitely far along it, and any caster is nearer.
  const double towards_plane = -glm::dot(ws_normal, ray.direction);
  if (!(towards_plane > 0.0)) return true;
  const double receiver = glm::dot(ws_normal, ray.origin - ws_point) / towards_plane;
  const double gap = receiver - map.along_ray[texel];
  const glm::dvec3 ws_on_plane = ray.origin + receiver * ray.direction;
  const glm::dvec3 size = glm::abs(ws_point);
  const double tolerance = kRelativeTolerance * std::max({size.x, size.y, size.z});
  const double height = gap * towards_plane;
  const double distance = glm::length(ws_on_plane - ws_point);
  if (!(gap > tolerance / glm::length(ray.direction))) return false;
  if (height > facet_slope * distance) return true;
  const glm::dvec3 ws_caster = ray.origin + map.along_ray[texel] * ray.direction;
  return glm::length(ws_caster - ws_point) > kFacetReach * distance;
}

absl::StatusOr<ShadowMask> ShadowFromMaps(const TruthScene& scene, const VisibleSurface& surface,
                                          const ShadowMask& truth, const RaySpace& ray_space,
                                          std::span<const ShadowProjection> projections) {
  std::vector<CasterMap> maps;
  maps.reserve(projections.size());
  for (const ShadowProjection& projection : projections) {
    absl::StatusOr<CasterMap> map = scene.RenderCasters(ray_space, projection);
    if (!map.ok()) return map.status();
    maps.push_back(*std::move(map));
  }

  ShadowMask mask(surface.size(), PixelLight::kNotConcerned);
  tbb::parallel_for(tbb::blocked_range<size_t>(0, surface.size(), 4096), [&](const auto& range) {
    for (size_t i = range.begin(); i != range.end(); ++i) {
      if (truth[i] == PixelLight::kNotConcerned) continue;
      const glm::dvec3& ws_point = surface.ws_point[i];
      const glm::dvec3 r = ray_space.RayFromPoint(ws_point);
      bool shadowed = false;
      for (const CasterMap& map : maps) {
        const glm::dvec3 u = map.projection.TexelFromRay(r);
        const MapSize size = map.projection.size;
        if (!(u.z > 0.0 && u.x >= 0.0 && u.x < size.width && u.y >= 0.0 && u.y < size.height)) continue;
        shadowed = TexelShadows(map, ray_space, int(u.x), int(u.y), surface.primitive[i], ws_point,
                                surface.ws_normal[i], kFacetSlope);
        break;
      }
      mask[i] = shadowed ? PixelLight::kShadowed : PixelLight::kLit;
    }
  });
  return mask;
}

int CountWrongPixels(const ShadowMask& truth, const ShadowMask& mask) {
  int wrong = 0;
  for (size_t i = 0; i < truth.size(); ++i) wrong += truth[i] != mask[i] ? 1 : 0;
  return wrong;
}

}  // namespace shadowfit
