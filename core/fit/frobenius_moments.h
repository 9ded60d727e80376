#pragma once

#include <array>
#include <glm/glm.hpp>

#include "core/frame/light_samples.h"

namespace shadowfit {

/// The papers' objective h (metric.h) of any matrix from 36 numbers, gathered once.
///
/// Let p be a sample's ray, dp_j its screen derivatives, D = det(p, dp_1, dp_2) and H the homography with
/// rows h1, h2, h3. The displacement of the sample in pixels along screen axis j for a step of the texel grid
/// is the covector g_j, row j of J^-1. It vanishes along the image of the other screen axis, so it is
/// proportional to (H p) x (H dp_k) = cof(H) (p x dp_k), k the other axis, and g_j . dx_j = 1 gives, with e_1
/// = p x dp_2 and e_2 = dp_1 x p,
///
///   g_j = (h3 . p) / (D det H) (c1 . e_j, c2 . e_j),    c1 = h2 x h3, c2 = h3 x h1.
///
/// With E = sum_j e_j e_j^T / D^2, summed over samples,
///
///   h = [c1^T Q c1 + c2^T Q c2] / det(H)^2,    Q(h3) = sum (h3 . p)^2 E,
///
/// and Q is linear in the 6 products of h3's components: 6 x 6 moments sum (p_i p_j)(E_kl) hold everything.
class FrobeniusMoments {
 public:
  FrobeniusMoments() = default;
  /// Of the samples in the coordinates p = `normalized_from_ray` r. Those whose Jacobian is singular for
  /// every matrix (D = 0) are left out.
  FrobeniusMoments(const BoundarySamples& samples, const glm::dmat3& normalized_from_ray);

  /// h at a matrix that sees all samples (h3 . p > 0); those behind it would count as if they were in front.
  double Value(const glm::dmat3& texel_from_ray) const;

  /// The gradient of h by h3 with h1 and h2 held fixed.
  glm::dvec3 AxisGradient(const glm::dmat3& texel_from_ray) const;

 private:
  /// Sum over samples of (a^T p p^T a) E.
  glm::dmat3 WeightedCovectors(const glm::dvec3& a) const;
  /// Sum over samples of (c^T E c) p p^T.
  glm::dmat3 WeightedRays(const glm::dvec3& c) const;

  /// [products of p][products of e], each in the order xx, yy, zz, xy, xz, yz.
  double moments_[6][6] = {};
};

}  // namespace shadowfit
