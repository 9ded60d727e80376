#pragma once

#include <cstdint>

#include "core/cancellation.h"
#include "core/fit/edge_fit.h"
#include "core/fit/whitened_samples.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

/// How far a fit is from the best matrix that there is, proven: of the sum of l y over samples, which is the
/// `edge` metric's tangent at the fit where they are weighed by it (TangentAt).
///
/// A matrix that holds the hull is an axis a (2 numbers), the directions of a parallelogram's sides (2) and,
/// where the aspect ratio is free, a stretch (1). Over all axes that see the hull from no nearer than
/// kCertifiedNearness, all sides with a sine of at least kCertifiedSine between them and all stretches up to
/// kCertifiedStretch either way, branch and bound finds the least `edge` metric up to a tolerance. Notation
/// of whitened_samples.h.
///
/// **The cost is a norm.** m(p, q) = s/4 + t^2/(12 s), s >= t the sorted |p|, |q|, is E|p U1 + q U2| for
/// independent uniform U1, U2 in [-1/2, 1/2] (metric.h): a norm of (p, q). So with mu_i, nu_i its partial
/// derivatives at one matrix, for any other
///
///   sum_i m(p_i, q_i) >= sum_i mu_i p_i + nu_i q_i.                                                     (1)
///
/// For the same reason m(p, q) of a sum of covectors is at most the sum of theirs: samples whose covectors
/// point nearly the same way may be added up, and what comes out is a bound from below, and closer to the
/// truth the finer they are sorted.
///
/// **A cell of axes.** The axes that see the hull are its polar dual, which falls into a triangle for every
/// vertex v, where w = 1 + a.v is least of all vertices'. Coordinates there are -log(w) and a position along
/// the triangle's outer edge: the cost grows as 1/w towards the edge, and cells stay as large there as
/// elsewhere. Let a = c + d run over a cell about c. In the image plane of c, hull points are v
/// / (1 + c.v) and samples X / (1 + c.X); call them v and X again. Then the axis is d there, and
///
///   g_i(d) = (1 + d.X_i) (G_i - d F_i)   with G_i = g_i(c), F_i = (1 + c.X_i) E3_i,
///
/// a polynomial of second degree in d, and so is Gamma_1(d) = sum mu_i g_i(d), and Gamma_2 with nu_i, whose
/// coefficients are summed once. The hull is v / (1 + d.v). The origin lies in it, so for a unit normal n the
/// hull reaches at least n.v / (1 + d.v) >= n.v (1 - d.v) along n for every vertex v, and at least the mean
/// of that over several vertices with weights of sum 1. Its width across n is at least
///
///   n . (e - M d),  e = sum (lambda_k - kappa_k) v_k,  M = sum (lambda_k - kappa_k) v_k v_k^T.
///
/// **A box** is such a cell with intervals of the side's direction theta, of the angle psi from it to the
/// other side, and of y = log(stretch). With n2 across side 2, step 1 is width_2 / (sin(psi) W e^y), and by
/// (1)
///
///   cost >= L = [   (Gamma_1(d).d1) (n2.(e2 - M2 d)) e^-y / W
///                 + (Gamma_2(d).d2) (n1.(e1 - M1 d)) e^y / H ] / sin psi
///
/// wherever both Gamma.d are positive (one that is not is left out: m is even in p and q, so that (1) holds
/// without mu or nu). L is smooth, equals the cost at the centre where the weights name the
/// vertices that the hull has there, and has its gradient. Let the slope by variable k differ by at most r_k
/// from that at the centre, over a box of half sides h_k, and by at most t r_k over the same box shrunk to t:
/// then, along the line from the centre to any point,
///
///   L >= L(centre) - sum_k h_k (|slope_k(centre)| + r_k / 2),
///
/// off by the square of the box's size. Arithmetic with balls (middle and radius) bounds r_k. Where two
/// vertices are extreme in turn the cost has a crease, which is where minima like to lie; the weights lambda,
/// kappa are chosen to make the bound greatest, and at a crease that mixes both sides' slopes into one that
/// is flat.
///
/// A box whose bound reaches the best cost known, over 1 + tolerance, holds no matrix that is better by more
/// than the tolerance, and is dropped. Others are halved.
struct Certificate {
  double cost = 0.0;         ///< Of the fit that was given.
  double best_cost = 0.0;    ///< Of the best matrix met, which may be the fit itself.
  double lower_bound = 0.0;  ///< No matrix of the class costs less.
  bool complete = false;     ///< best_cost <= (1 + tolerance) lower_bound.
  bool improved = false;     ///< `best` is set: better than the fit.
  ShadowProjection best;
  int64_t cells = 0;
  int64_t boxes = 0;
  double seconds = 0.0;

  /// The fit costs at most so much more than the best matrix that there is, as a share.
  double MostGap() const { return lower_bound > 0.0 ? cost / lower_bound - 1.0 : 0.0; }
  /// The fit costs at least so much more.
  double LeastGap() const { return best_cost > 0.0 ? cost / best_cost - 1.0 : 0.0; }
};

/// Least w over the hull, against that at the hull's centroid.
inline constexpr double kCertifiedNearness = 0.002;
inline constexpr double kCertifiedSine = 0.08;
inline constexpr double kCertifiedStretch = 2.7;

struct CertifyOptions {
  double tolerance = 0.01;   ///< Relative; above 0.
  double time_limit = 10.0;  ///< Seconds, after which the certificate is incomplete.
};

/// `fit` is a matrix of this light, of any method. Polls `cancellation`; a certificate that was cancelled is
/// incomplete. Without samples that have length every matrix is the best.
Certificate Certify(const WhitenedSamples& samples, MapSize size, bool free_aspect,
                    const ShadowProjection& fit, const CertifyOptions& options,
                    const Cancellation& cancellation);

/// The bound over one box, for tests. `direction`, `angle` and `log_stretch` are theta, psi and y.
struct CertifiedBox {
  size_t fan = 0;  ///< The hull's vertex that is nearest.
  double nearing = 0.0, nearing_reach = 0.0;
  double along = 0.0, along_reach = 0.0;
  double direction = 0.0, direction_reach = 0.0;
  double angle = 0.0, angle_reach = 0.0;
  double log_stretch = 0.0, log_stretch_reach = 0.0;
};
double LowerBoundOver(const WhitenedSamples& samples, MapSize size, const CertifiedBox& box);
/// The axis at these coordinates.
glm::dvec2 CertifiedAxis(const WhitenedSamples& samples, size_t fan, double nearing, double along);

/// The edge metric at an axis and a shape, in doubles and sample by sample; 1e300 where the axis does not see
/// the hull.
double ExactEdgeCost(const WhitenedSamples& samples, MapSize size, const glm::dvec2& axis, double direction,
                     double angle, double log_stretch);

}  // namespace shadowfit
