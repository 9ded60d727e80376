#include "core/fit/map_quality.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/fit/metric.h"
#include "core/fit/outer_samples.h"
#include "core/fit/prediction.h"
#include "core/math/convex_hull.h"

namespace shadowfit {
namespace {

/// Sums over edge samples.
struct Sums {
  double length = 0.0;
  double per_area = 0.0;   ///< l / a
  double root_area = 0.0;  ///< l sqrt(a)
  double displaced = 0.0;  ///< l y
  double predicted = 0.0;
};

/// The map that a ray belongs to; none where none holds it. A single map that holds the shadow whole is asked
/// for all that it sees.
const ShadowProjection* MapOf(const glm::dvec3& ray, std::span<const ShadowProjection> projections,
                              bool whole) {
  if (projections.size() == 1 && whole) return projections.data();
  for (const ShadowProjection& projection : projections) {
    if (projection.Holds(ray)) return &projection;
  }
  return nullptr;
}

void Add(const Camera& camera, const RaySpace& ray_space, const BoundarySamples& samples,
         std::span<const ShadowProjection> projections, bool whole, MapSize screen, Sums* sums) {
  const glm::dmat4 clip_rows = glm::transpose(camera.clip_from_world());
  std::vector<glm::dmat3> all_texel_rows;  // Rows of H G without its constant column.
  for (const ShadowProjection& projection : projections) {
    all_texel_rows.push_back(glm::transpose(projection.texel_from_ray * ray_space.linear()));
  }
  for (size_t i = 0; i < samples.size(); ++i) {
    const glm::dvec3 r = samples.Ray(i);
    const ShadowProjection* map = MapOf(r, projections, whole);
    if (map == nullptr) continue;
    const ShadowProjection& projection = *map;
    const glm::dmat3& texel_rows = all_texel_rows[static_cast<size_t>(map - projections.data())];
    const glm::dvec3 u = projection.TexelFromRay(r);
    if (!(u.z > 0.0)) continue;
    const glm::dvec4 ws(ray_space.PointFromRay(r, samples.q[i]), 1.0);
    const glm::dvec4 clip = camera.clip_from_world() * ws;
    const auto pixel_gradient = [&](int axis, int pixels) {
      return (glm::dvec3(clip_rows[axis]) - clip[axis] / clip.w * glm::dvec3(clip_rows[3])) *
             (0.5 * pixels / clip.w);
    };
    const glm::dvec3 pixel_beam =
        glm::cross(pixel_gradient(0, screen.width), pixel_gradient(1, screen.height));
    const glm::dvec3 texel_beam =
        glm::cross((texel_rows[0] - u.x * texel_rows[2]) / u.z, (texel_rows[1] - u.y * texel_rows[2]) / u.z);
    const double area = glm::length(pixel_beam) / glm::length(texel_beam);
    if (!std::isfinite(area) || !(area > 0.0)) continue;
    const double displacement = EdgeDisplacement(samples, i, projection.texel_from_ray);
    if (!(displacement > 0.0) || !std::isfinite(displacement)) continue;
    const double length = samples.length[i];
    sums->length += length;
    sums->per_area += length / area;
    sums->root_area += length * std::sqrt(area);
    sums->displaced += length * displacement;
    sums->predicted += EdgePixels(length, displacement, samples.limit, samples.tail[i]);
  }
}

/// Share of the maps' texels that the hulls of the shadow in them cover.
double Fill(const LightSamples& samples, std::span<const ShadowProjection> projections, bool whole) {
  std::vector<std::vector<glm::dvec2>> texels(projections.size());
  for (const int32_t i : HullSamples(samples, HullOf::kShadow)) {
    const glm::dvec3& r = samples.hull_rays[static_cast<size_t>(i)];
    const ShadowProjection* map = MapOf(r, projections, whole);
    if (map == nullptr) continue;
    const glm::dvec3 u = map->TexelFromRay(r);
    if (!(u.z > 0.0) || !std::isfinite(u.x) || !std::isfinite(u.y)) continue;
    texels[static_cast<size_t>(map - projections.data())].emplace_back(
        std::clamp(u.x, 0.0, double(map->size.width)), std::clamp(u.y, 0.0, double(map->size.height)));
  }
  double covered = 0.0;
  double all = 0.0;
  for (size_t k = 0; k < projections.size(); ++k) {
    all += projections[k].size.texels();
    const std::vector<int> hull = ConvexHull2(texels[k]);
    for (size_t i = 0; i + 2 < hull.size(); ++i) {
      const glm::dvec2 origin = texels[k][static_cast<size_t>(hull[0])];
      const glm::dvec2 a = texels[k][static_cast<size_t>(hull[i + 1])] - origin;
      const glm::dvec2 b = texels[k][static_cast<size_t>(hull[i + 2])] - origin;
      covered += 0.5 * (a.x * b.y - a.y * b.x);
    }
  }
  return std::clamp(covered / all, 1e-6, 1.0);
}

}  // namespace

std::string_view MapFlawName(MapFlaw flaw) {
  switch (flaw) {
    case MapFlaw::kNone:
      return "none";
    case MapFlaw::kPerspective:
      return "perspective";
    case MapFlaw::kProjection:
      return "projection";
    case MapFlaw::kFit:
      return "fit";
    case MapFlaw::kBudget:
      return "budget";
  }
  return "unknown";
}

MapFlaw MapQuality::Worst() const {
  if (!(predicted_pixels > 0.0)) return MapFlaw::kNone;
  MapFlaw worst = MapFlaw::kNone;
  double most = 1.0;
  const auto consider = [&](double factor, MapFlaw flaw) {
    if (factor <= most) return;
    most = factor;
    worst = flaw;
  };
  consider(budget, MapFlaw::kBudget);
  consider(fit, MapFlaw::kFit);
  consider(perspective, MapFlaw::kPerspective);
  consider(projection, MapFlaw::kProjection);
  return worst;
}

MapQuality AssessMaps(const Camera& camera, const RaySpace& ray_space, const LightSamples& samples,
                      std::span<const ShadowProjection> projections, MapSize screen) {
  MapQuality quality;
  Sums sums;
  const bool whole = HoldShadow(samples, projections);
  for (const BoundarySamples* boundary : samples.Boundaries()) {
    Add(camera, ray_space, *boundary, projections, whole, screen, &sums);
  }
  if (!(sums.length > 0.0)) return quality;
  const double fill = Fill(samples, projections, whole);
  const double root_even = std::sqrt(sums.length / sums.per_area);
  const double unseen = UnseenFactor(samples);
  quality.predicted_pixels = unseen * sums.predicted;
  quality.unit_pixels = unseen * kUnitPixelsPerLength * sums.length;
  quality.fit = std::sqrt(1.0 / fill);
  quality.budget = root_even / quality.fit;
  quality.perspective = sums.root_area / (sums.length * root_even);
  quality.projection = sums.displaced / (kUnitPixelsPerLength * sums.root_area);
  quality.saturation = sums.predicted / sums.displaced;
  return quality;
}

}  // namespace shadowfit
