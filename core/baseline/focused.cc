#include <cstddef>
#include <utility>
#include <vector>

#include "core/baseline/light_frustum.h"
#include "core/baseline/methods.h"
#include "core/baseline/view_body.h"
#include "core/math/convex_hull.h"
#include "core/math/enclosing_rectangle.h"

namespace shadowfit {
namespace {

std::vector<glm::dvec2> HullOf(const std::vector<glm::dvec2>& points) {
  std::vector<glm::dvec2> hull;
  for (const int i : ConvexHull2(points)) hull.push_back(points[static_cast<size_t>(i)]);
  return hull;
}

/// The part of a convex polygon where dot(normal, p) <= offset (Sutherland, Hodgman).
std::vector<glm::dvec2> Clip(const std::vector<glm::dvec2>& polygon, const glm::dvec2& normal,
                             double offset) {
  std::vector<glm::dvec2> clipped;
  for (size_t i = 0; i < polygon.size(); ++i) {
    const glm::dvec2 p = polygon[i];
    const glm::dvec2 q = polygon[i + 1 < polygon.size() ? i + 1 : 0];
    const double at_p = offset - glm::dot(normal, p);
    const double at_q = offset - glm::dot(normal, q);
    if (at_p >= 0.0) clipped.push_back(p);
    if ((at_p >= 0.0) != (at_q >= 0.0)) clipped.push_back(p + (at_p / (at_p - at_q)) * (q - p));
  }
  return clipped;
}

}  // namespace

absl::StatusOr<LightFit> FitFocused(const LightProblem& problem) {
  const RaySpace& ray_space = *problem.ray_space;
  const LightFrustum frustum = NormalFrustum(problem);
  LightFit fit;
  fit.outcome = frustum.outcome;
  fit.note = frustum.note;

  // The view frustum's image on the light's plane. Of a point light's view only the part in front of the
  // plane has an image; cut at a sliver of w the image is large but finite, and the extents cut it again.
  ViewBody body(*problem.camera, problem.nearest_ndc_depth, problem.farthest_ndc_depth);
  body.ClipToFront(ray_space, frustum.plane);
  std::vector<glm::dvec2> image;
  for (const glm::dvec3& vertex : body.Vertices()) {
    image.push_back(frustum.plane.Project(ray_space.RayFromPoint(vertex)));
  }
  image = HullOf(image);
  const EnclosingRectangle& extents = frustum.extents;
  const glm::dvec2 axes[2] = {extents.axis, {-extents.axis.y, extents.axis.x}};
  const double half[2] = {0.5 * extents.width, 0.5 * extents.height};
  for (int i = 0; i < 2; ++i) {
    const double center = glm::dot(axes[i], extents.center);
    image = Clip(image, axes[i], half[i] + center);
    image = Clip(image, -axes[i], half[i] - center);
  }

  const std::vector<glm::dvec3>& hull_rays = problem.samples->hull_rays;
  EnclosingRectangle rectangle = MinimumAreaRectangle(HullOf(image));
  if (image.empty() || !InFrontMeansInside(frustum.plane, rectangle, hull_rays)) {
    // Visible samples are in the view; where rounding, or a caller's depth range, says otherwise they rule.
    for (const glm::dvec3& ray : hull_rays) {
      if (glm::dot(frustum.plane.w, ray) > 0.0) image.push_back(frustum.plane.Project(ray));
    }
    rectangle = MinimumAreaRectangle(HullOf(image));
  }
  if (image.empty()) {
    fit.projection = MapRectangle(frustum.plane, extents, problem.map_size);
    fit.outcome = FitOutcome::kFallback;
    fit.note = "the light's frustum and the view frustum do not meet: the light's own frustum";
    return fit;
  }
  fit.projection = MapLongSideToLongSide(frustum.plane, rectangle, problem.map_size);
  return fit;
}

}  // namespace shadowfit
