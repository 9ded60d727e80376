#pragma once

#include <span>

#include "absl/status/statusor.h"
#include "core/math/ray_space.h"
#include "core/math/shadow_projection.h"
#include "core/reference/truth_scene.h"
#include "core/reference/visible_surface.h"

namespace shadowfit {

/// Whether the caster of texel (x, y) hides from the light the tangent plane of a point, which is seen on a
/// triangle, on the ray through the texel's centre; see ShadowFromMaps. Casters do not count that are about
/// as near as the ray's meeting with the plane, and whose height above the plane is less than `facet_slope`
/// times the distance of that meeting.
bool TexelShadows(const CasterMap& map, const RaySpace& ray_space, int x, int y, uint32_t primitive,
                  const glm::dvec3& ws_point, const glm::dvec3& ws_normal, double facet_slope);

/// What a renderer with these shadow maps of one light would show, free of depth errors: a pixel looks up the
/// texel that contains its point, in the first map that does, and is in shadow where that texel's caster is
/// nearer to the light than the pixel's tangent plane is on the ray through the texel's centre. The triangle
/// that is seen never shadows itself, nor do its neighbours on a curved surface: casters near the point and
/// less than a fifth as high above the tangent plane as the texel's centre lies away do not count. Outside
/// all maps, and behind their planes of projection, all is lit. `truth` says which pixels the light concerns;
/// the others stay kNotConcerned.
absl::StatusOr<ShadowMask> ShadowFromMaps(const TruthScene& scene, const VisibleSurface& surface,
                                          const ShadowMask& truth, const RaySpace& ray_space,
                                          std::span<const ShadowProjection> projections);

/// Pixels in which two masks of one surface and light differ.
int CountWrongPixels(const ShadowMask& truth, const ShadowMask& mask);

}  // namespace shadowfit
