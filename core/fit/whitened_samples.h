#pragma once

#include <glm/glm.hpp>
#include <optional>
#include <vector>

#include "core/fit/light_problem.h"
#include "core/fit/ray_hull.h"

namespace shadowfit {

/// One light's hull and shadow edges in whitened ray coordinates, where every axis is (alpha, beta, 1), the
/// hull is a convex polygon with the origin as its centroid and its second moments are those of a unit
/// square's sides: searches over the axis are then equally scaled for all lights, point or directional, near
/// or far.
///
/// An edge sample needs five numbers. Let p = T r be its whitened ray, X = p.x/p.z, Y = p.y/p.z, dp_j = T
/// dr_j, and dp_t = -n2 dp_1 + n1 dp_2 the derivative along the edge. The plane through the light and the
/// edge has the covector e = p x dp_t. In the image plane of the axis (alpha, beta, 1), with w = alpha p.x +
/// beta p.y + p.z and v = p.xy / w, the covector g = V^-T n (V = dv/dx), which gives the edge's displacement
/// in pixels g . b for a step b of the image plane, is
///
///   g = (w / D) (e1 - alpha e3, e2 - beta e3),    D = det(p, dp_1, dp_2).
///
/// Proof: V t = (w dp_t.xy - p.xy dw_t) / w^2 = (e2 - beta e3, -(e1 - alpha e3)) / w^2 up to orientation, g
/// is perpendicular to it and g . (V n) = 1, and det V = D / w^3. With E = l (p.z / D) e, l the sample's
/// length of edge,
///
///   l g = (1 + alpha X + beta Y) (E1 - alpha E3, E2 - beta E3).
struct WhitenedSamples {
  glm::dmat3 whitened_from_ray{1.0};
  std::vector<glm::dvec2>
      hull;  ///< Convex polygon, counter-clockwise, image-plane coordinates of the axis (0, 0, 1).

  // Padded with samples of no weight to the kernels' lanes (edge_kernels.h).
  std::vector<float> x;
  std::vector<float> y;
  std::vector<float> e1;
  std::vector<float> e2;
  std::vector<float> e3;
  /// One over the wrong pixels that the sample approaches as texels grow, l times its list's limit.
  std::vector<float> inverse_limit;
  std::vector<float> inverse_tail_limit;  ///< The same of its tail, see EdgePixels().
  std::vector<float> tail;                ///< BoundarySamples::tail.
};

/// Whitens what a hull (not empty) holds of the problem's samples; those outside it, which only an incomplete
/// hull has, and those without length and those seen edge-on by the light, whose covector does not exist,
/// are left out.
WhitenedSamples Whiten(const LightProblem& problem, const RayHull& hull);

/// Any map as its texels' steps in the image plane of its axis (alpha, beta, 1) of whitened coordinates:
/// texels are u = B^-1 p + t there, with B = (step1 step2).
struct TexelGrid {
  glm::dvec2 axis;
  glm::dvec2 step1;
  glm::dvec2 step2;
};

/// None where the map's axis plane cuts the hull's centroid off.
std::optional<TexelGrid> GridOf(const glm::dmat3& texel_from_whitened);

/// The samples' sum of l y, which searches and certificates minimise, is the `edge` metric only while texels
/// are small. That metric is a sum of concave functions f of l y (EdgePixels(), metric.h): it lies below
/// its tangent, the sum of f' l y, which touches it at one map. This weighs samples by f' at that map: what
/// has a lesser tangent than the map has a lesser metric, too, by as much at least. The map sees all samples;
/// `metric` is its own sum of f, where asked for.
WhitenedSamples TangentAt(const WhitenedSamples& samples, const TexelGrid& map, double* metric = nullptr);

/// Of every k-th sample alone, k the least that leaves at most `most`, with k times its length. Samples come
/// row by row over the screen, so that every k-th is an even choice.
WhitenedSamples WhitenSome(const LightProblem& problem, const RayHull& hull, int most);

}  // namespace shadowfit
