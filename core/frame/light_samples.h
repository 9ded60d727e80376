#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <vector>

namespace shadowfit {

/// Pixels; what an edge's displacement counts at most, see EdgeMetric() (metric.h). Of 1, 2, 4 and 16 this
/// ranks 1,280 lights of five scenes and views most as their counts against rays do.
inline constexpr double kEdgeLimit = 2.0;

/// The same of edges that may be anywhere: texels as wide as a wall get all of it wrong, about as many pixels
/// as such a sample stands for.
inline constexpr double kUnseenEdgeLimit = 1e4;

/// Share of an edge whose displacement counts up to kUnseenEdgeLimit where its shadow, or the light beside
/// it, is wide: texels may take all of that, and not only a strip along its edge. Of 0 to 1, for shadows
/// wider than 0 to 20 samples, this leaves scenes as they were whose shadows are small (plaza, Sterngarten),
/// and takes the worst from others (rooms, a warehouse, an atrium).
inline constexpr double kWideTail = 0.05;

/// What a fit weighs: samples of the shadow boundary, structure of arrays, in one light's ray coordinates.
/// The nine numbers r, dr/dx1, dr/dx2 are all that an objective needs of a sample, and none of them depends
/// on the matrix.
struct BoundarySamples {
  std::vector<double> r[3];    ///< Ray coordinates.
  std::vector<double> dr1[3];  ///< Their derivative along screen x, per pixel of the final screen.
  std::vector<double> dr2[3];  ///< Their derivative along screen y (upwards), per pixel of the final screen.
  std::vector<double> q;       ///< Along-ray coordinates (see RaySpace): with r they give the world position.
  std::vector<double> n1;      ///< Screen-space unit normal of the shadow edge, x.
  std::vector<double> n2;      ///< Screen-space unit normal of the shadow edge, y.
  std::vector<double> length;  ///< Length of edge that the sample stands for, in final-screen pixels.
  std::vector<double> tail;    ///< kWideTail where the edge's own side is wide, 0 elsewhere.
  double limit = kEdgeLimit;   ///< Of all of them.

  size_t size() const { return n1.size(); }
  void Resize(size_t count);
  void Set(size_t i, const glm::dvec3& ray, const glm::dvec3& ray_dx1, const glm::dvec3& ray_dx2,
           double along_ray, const glm::dvec2& normal, double edge_length, double edge_tail = 0.0) {
    for (glm::length_t k = 0; k < 3; ++k) {
      r[k][i] = ray[k];
      dr1[k][i] = ray_dx1[k];
      dr2[k][i] = ray_dx2[k];
    }
    q[i] = along_ray;
    n1[i] = normal.x;
    n2[i] = normal.y;
    length[i] = edge_length;
    tail[i] = edge_tail;
  }
  void Add(const glm::dvec3& ray, const glm::dvec3& ray_dx1, const glm::dvec3& ray_dx2, double along_ray,
           const glm::dvec2& normal, double edge_length, double edge_tail = 0.0);
  glm::dvec3 Ray(size_t i) const { return {r[0][i], r[1][i], r[2][i]}; }
  glm::dvec3 RayDx1(size_t i) const { return {dr1[0][i], dr1[1][i], dr1[2][i]}; }
  glm::dvec3 RayDx2(size_t i) const { return {dr2[0][i], dr2[1][i], dr2[2][i]}; }
};

/// Where the boundary samples came from.
enum class SampleSource {
  kShadowBoundary,  ///< Pixels whose shadow bit differs from a neighbour's: the normal case.
  kAllVisible,      ///< No such pixel, or no bits given: every visible pixel that the light reaches.
  kNone,            ///< Nothing visible faces this light; any valid matrix serves.
};

/// The median of 1,200 lights of the plaza, the Sterngarten and the hall is about this.
inline constexpr double kCommonNarrowShare = 0.45;

/// One light's view of one frame.
struct LightSamples {
  SampleSource source = SampleSource::kNone;
  double pixels_per_sample = 1.0;  ///< Final-screen pixels that one low-resolution pixel covers.
  /// Of the shadow's runs along rows and columns of the bits, the share that is one sample long: how much of
  /// it is too narrow to be seen. A common one where there are no bits to tell.
  double narrow_share = kCommonNarrowShare;
  BoundarySamples boundary;
  /// Boundary samples beside depth discontinuities and terminators or without reliable derivatives (leaves,
  /// thin things), with the best guess at both: a surface that faces the viewer where nothing is known.
  /// Lengths are times the edges that there are, on average, for each that shows. The papers leave them out.
  BoundarySamples rough_boundary;
  /// Samples of a shadow's inside and rim, where none of its edges shows. There are some that the samples do
  /// not resolve, or that are just out of sight, behind an outline, a crease or the border of the picture:
  /// where texels grow without bound, because nothing that is seen asks for them, light leaks in.
  BoundarySamples unseen_boundary;
  std::vector<glm::dvec3> hull_rays;   ///< Ray coordinates that the map must contain.
  std::vector<double> hull_along_ray;  ///< Their along-ray coordinates q (see RaySpace), for the depth row.
  /// Whether each is in shadow, 1 or 0; lit ones lie beside a shadow's edge. A map that does not hold these
  /// gets nothing wrong.
  std::vector<uint8_t> hull_in_shadow;
  /// Derivatives of the hull rays along screen x and y, per low-resolution pixel: with them the hull samples'
  /// footprints, over which the shadow that each stands for extends.
  std::vector<glm::dvec3> hull_rays_dx1;
  std::vector<glm::dvec3> hull_rays_dx2;

  /// All lists of edges.
  std::array<const BoundarySamples*, 3> Boundaries() const {
    return {&boundary, &rough_boundary, &unseen_boundary};
  }
  size_t EdgeSamples() const { return boundary.size() + rough_boundary.size() + unseen_boundary.size(); }

  /// How far a footprint reaches from its sample, in low-resolution pixels. A shadow that has the sample and
  /// not its neighbour ends anywhere between them, beyond a reach of r by (1 - r)^2 / 2 on average: 1/8 of a
  /// pixel beyond the pixel's own border, 1/32 beyond this.
  static constexpr double kFootprintReach = 0.75;

  /// A corner, 0 to 3, of a hull sample's footprint.
  glm::dvec3 FootprintCorner(size_t i, int corner) const {
    const glm::dvec3 along1 = (corner & 1) != 0 ? hull_rays_dx1[i] : -hull_rays_dx1[i];
    const glm::dvec3 along2 = (corner & 2) != 0 ? hull_rays_dx2[i] : -hull_rays_dx2[i];
    return hull_rays[i] + kFootprintReach * (along1 + along2);
  }
};

}  // namespace shadowfit
