#pragma once

#include <glm/glm.hpp>
#include <span>
#include <vector>

#include "core/frame/light_samples.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

/// The Jacobian du_i/dx_j of texel coordinates by screen coordinates, texels per pixel, at one sample
/// (TR-07-07, equations 7 and 8, with the surface's own tangents in place of dx3/dx_j):
///
///   J_ij = (h_i . dr_j - u_i h_3 . dr_j) / (h_3 . r)
///
/// GLM's column-major order: J[j][i]. `texel_from_ray` has rows h1, h2, h3.
glm::dmat2 TexelJacobian(const glm::dmat3& texel_from_ray, const glm::dvec3& r, const glm::dvec3& dr1,
                         const glm::dvec3& dr2);

/// The papers' objective h (TR-07-07, equation 9): the sum over samples of ||J^-1||_F^2 = (sum J_ij^2) /
/// det(J)^2, squared pixels. Samples with h3.r <= 0 or a singular Jacobian, which no matrix could serve, are
/// left out.
double FrobeniusMetric(const BoundarySamples& samples, const glm::dmat3& texel_from_ray);

/// The median over samples of ||J^-1||_F^2, by which the papers decide whether a new matrix is a sufficient
/// improvement. 0 without samples. `scratch` is working memory.
double FrobeniusMedian(const BoundarySamples& samples, const glm::dmat3& texel_from_ray,
                       std::vector<double>* scratch);

/// Expected number of misclassified pixels. One step of a texel moves a screen point by dx/du_k; across a
/// shadow edge with screen normal n that is |n . dx/du_k| pixels. Write s >= t for the two. A straight edge
/// crosses texels whose parallelogram footprint has, along n, the trapezoidal profile of the sum of two
/// independent uniform offsets of widths s and t: the stepped image of the edge is displaced by D = S + T, S
/// uniform in [-s/2, s/2], T in [-t/2, t/2], and per pixel of edge the misclassified area is
///
///   E|S + T| = s/4 + t^2 / (12 s).
///
/// (E|S + T| given T is s/4 + T^2/s, as |T| <= s/2; and E T^2 = t^2/12.)  The wrong strip is only as wide as
/// that, y, where the shadow and the light beside it are wider: elsewhere shadows are lost, and no more than
/// they. And of wide shadows some edges are not where they seem to be: what texels that are wider yet take of
/// them counts as well, if less. For each pixel of its length an edge counts
///
///   (1 - tail) y / (1 + y / limit) + tail y / (1 + y / kUnseenEdgeLimit)
///
/// pixels. Summed over the samples' lengths; samples with h3.r <= 0 or a singular Jacobian are left out.
double EdgeMetric(const BoundarySamples& samples, const glm::dmat3& texel_from_ray);

/// The same for several maps: each sample under the first that holds it; nothing for those that none holds.
double EdgeMetricOfHeld(const BoundarySamples& samples, std::span<const ShadowProjection> maps);

/// What an edge of a length gets wrong that is displaced by y, all in pixels.
inline double EdgePixels(double length, double y, double limit, double tail) {
  return length * y * ((1.0 - tail) / (1.0 + y / limit) + tail / (1.0 + y / kUnseenEdgeLimit));
}

/// The y of one sample's edge, pixels; 0 where it is left out.
double EdgeDisplacement(const BoundarySamples& samples, size_t i, const glm::dmat3& texel_from_ray);

/// One sample's part of the metric.
double EdgeMetricOfSample(const BoundarySamples& samples, size_t i, const glm::dmat3& texel_from_ray);

/// Boundary samples as a map sees them, structure of arrays.
struct EdgesOnMap {
  std::vector<float> x;       ///< Place on the map as a share of its width; NaN behind the map.
  std::vector<float> y;       ///< As a share of its height.
  std::vector<float> pixels;  ///< EdgeMetricOfSample().
  /// Its slopes along the logarithms of a texel's width and height.
  std::vector<float> per_width;
  std::vector<float> per_height;
};

/// Appends what a map makes of the samples.
void AppendEdges(const BoundarySamples& samples, const ShadowProjection& map, EdgesOnMap* edges);

}  // namespace shadowfit
