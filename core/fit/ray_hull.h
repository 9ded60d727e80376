#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <optional>
#include <span>
#include <vector>

#include "core/fit/light_problem.h"
#include "core/fit/outer_samples.h"

namespace shadowfit {

/// The rays that a map must hold, reduced to what a fit needs of them. Projective maps keep convex hulls, so
/// the same vertices serve every valid axis: they are found once.
struct RayHull {
  /// Affine for a directional light (centres and scales its plane coordinates, which are in world units, to a
  /// disc of radius one), the identity for a point light: makes angles of the axis mean something. Everything
  /// below is in these normalised coordinates.
  glm::dmat3 normalized_from_ray{1.0};
  /// Vertices of the hull, counter-clockwise about the axis.
  std::vector<glm::dvec3> vertices;
  /// Unit axis of the smallest cone around the rays: the best-centred valid axis.
  glm::dvec3 axis{0.0, 0.0, 1.0};
  /// Cosine of that cone's half angle.
  double cos_half_angle = 1.0;
  /// The centre of the cone that was kept; meaningless where the hull is complete.
  glm::dvec3 reduced_axis{0.0, 0.0, 1.0};
  /// False where the rays span a half space or more, so that no single map holds them: the hull then is that
  /// of the rays within kReducedHalfAngle of the axis that keeps most of them.
  bool complete = true;

  /// Of those that are in shadow (all are, where none is known to be), samples among which are all that are
  /// at their hull.
  std::vector<int32_t> shadow_samples;

  /// Whether a ray in normalised coordinates is one that the hull was made of: all are, where it is complete.
  bool Keeps(const glm::dvec3& normalized_ray) const;
};

/// What MakeRayHull() made of one problem's samples.
struct RayHulls {
  std::optional<RayHull> of_samples;
  std::optional<RayHull> of_shadow;
};

/// Half angle in radians (75 degrees) of the cone that is kept where the rays do not fit into any.
inline constexpr double kReducedHalfAngle = 1.3089969389957472;

/// Never empty: without any finite ray the hull is the axis alone, and not complete.
RayHull MakeRayHull(const RaySpace& ray_space, std::span<const glm::dvec3> rays);

/// The rays of the samples, or of their footprints' corners, or, where the light reaches nothing that is
/// visible, of the scene's bounds; never empty. Made once where the problem has LightProblem::hulls.
RayHull MakeRayHull(const LightProblem& problem, HullOf hull_of);

/// What the default method fits a map to: the shadow's footprints where one map holds them, the samples where
/// one holds those. Not complete, and of the shadow, where none does.
RayHull MakeFitHull(const LightProblem& problem);

/// Image-plane coordinates about a unit axis: v = (b1.r, b2.r) / (axis.r) with b1, b2 orthonormal to it.
struct ImagePlane {
  glm::dvec3 b1;
  glm::dvec3 b2;
  glm::dvec3 axis;

  static ImagePlane About(const glm::dvec3& axis);
  /// About the mean direction of some of the rays; none where not all are well in front of it.
  static std::optional<ImagePlane> Facing(std::span<const glm::dvec3> rays);
  glm::dvec2 Project(const glm::dvec3& r) const {
    const double w = glm::dot(axis, r);
    return {glm::dot(b1, r) / w, glm::dot(b2, r) / w};
  }
};

}  // namespace shadowfit
