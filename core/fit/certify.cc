#include "core/fit/certify.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <numbers>
#include <numeric>
#include <queue>
#include <utility>

#include "core/fit/rescale_previous.h"

namespace shadowfit {
namespace {

using SteadyClock = std::chrono::steady_clock;

constexpr double kPi = std::numbers::pi;
constexpr double kHuge = 1e300;
// What rounding may add to a bound: sums of thousands of doubles are good to 1e-12.
constexpr double kRounding = 1e-9;

/// A range about the value that something has at a box's centre. All rules below give radii that are
/// polynomials, without a constant term and with positive coefficients, in the radii that go in: in a box
/// shrunk to the share t of its size about the same centre every radius is at most t times as large.
struct Ball {
  double middle = 0.0;
  double radius = 0.0;
};
Ball operator+(Ball a, Ball b) { return {a.middle + b.middle, a.radius + b.radius}; }
Ball operator*(Ball a, Ball b) {
  return {a.middle * b.middle,
          std::abs(a.middle) * b.radius + a.radius * std::abs(b.middle) + a.radius * b.radius};
}
Ball operator*(double a, Ball b) { return {a * b.middle, std::abs(a) * b.radius}; }

// The variables of a box, in this order.
enum Variable { kNearing, kAlong, kDirection, kAngle, kLogStretch, kVariables };

/// A value and its partial derivatives over a box.
struct Dual {
  Ball value;
  std::array<Ball, kVariables> slope;
};
Dual operator+(const Dual& a, const Dual& b) {
  Dual sum{a.value + b.value, {}};
  for (size_t k = 0; k < kVariables; ++k) sum.slope[k] = a.slope[k] + b.slope[k];
  return sum;
}
Dual operator*(const Dual& a, const Dual& b) {
  Dual product{a.value * b.value, {}};
  for (size_t k = 0; k < kVariables; ++k) product.slope[k] = a.value * b.slope[k] + a.slope[k] * b.value;
  return product;
}
Dual operator*(double a, const Dual& b) {
  Dual product{a * b.value, {}};
  for (size_t k = 0; k < kVariables; ++k) product.slope[k] = a * b.slope[k];
  return product;
}
Dual Constant(double value) { return {{value, 0.0}, {}}; }

/// A value and its partial derivatives at the centre of a box.
using Center = std::array<double, kVariables + 1>;

/// Samples added up by the direction of their covectors at a cell's centre.
struct Cluster {
  glm::dvec2 g{0.0};       ///< Sum of G.
  glm::dmat2 g_by_x{0.0};  ///< Sum of G X^T.
  double f = 0.0;          ///< Sum of F.
  glm::dvec2 f_x{0.0};     ///< Sum of F X.
};

/// Gamma(d) = constant + linear d - (quadratic . d) d.
struct Polynomial {
  glm::dvec2 constant{0.0};
  glm::dmat2 linear{0.0};
  glm::dvec2 quadratic{0.0};

  void Add(double weight, const Cluster& cluster) {
    constant += weight * cluster.g;
    linear += weight * cluster.g_by_x - glm::dmat2(weight * cluster.f);
    quadratic += weight * cluster.f_x;
  }
};

struct ShapeBox {
  double direction = 0.0;
  double angle = 0.0;
  double log_stretch = 0.0;
  double direction_reach = 0.0;
  double angle_reach = 0.0;
  double log_stretch_reach = 0.0;
  double bound = 0.0;
};

glm::dvec2 DirectionOf(double angle) { return {std::cos(angle), std::sin(angle)}; }
glm::dvec2 Across(const glm::dvec2& side) { return {-side.y, side.x}; }

/// The axes that see the hull with vertex v nearest of all, w = 1 + a.v least. All axes are the interior of
/// the hull's polar dual, and these its triangle between the origin and the edge where w is 0. In coordinates
/// turned by `angle`, so that v lies along x.
struct Fan {
  double angle = 0.0;
  glm::dvec2 turn{1.0, 0.0};      ///< (cos, sin) of it.
  std::array<glm::dvec2, 2> rim;  ///< Ends of the edge.

  /// w = e^-nearing at a point `along` the edge, 0 to 1.
  glm::dvec2 AxisAt(double nearing, double along) const {
    return -std::expm1(-nearing) * (rim[0] + along * (rim[1] - rim[0]));
  }
  glm::dvec2 TurnedBack(const glm::dvec2& a) const {
    return {turn.x * a.x - turn.y * a.y, turn.y * a.x + turn.x * a.y};
  }
};

/// A cell of such axes. Near the edge a step of `nearing` is a factor of w, so that cells need not shrink
/// with w.
struct FanCell {
  double nearing = 0.0;
  double along = 0.0;
  double nearing_reach = 0.0;
  double along_reach = 0.0;
};

/// One for each vertex; none where the hull has no area or does not hold the origin.
std::vector<Fan> FansOf(const std::vector<glm::dvec2>& hull) {
  std::vector<Fan> fans;
  const size_t n = hull.size();
  if (n < 3) return fans;
  // The axis that sees both ends of an edge with w = 0.
  const auto dual_of = [&](size_t i) {
    const glm::dvec2& a = hull[i];
    const glm::dvec2& b = hull[(i + 1) % n];
    return glm::dvec2(a.y - b.y, b.x - a.x) / (a.x * b.y - a.y * b.x);
  };
  for (size_t i = 0; i < n; ++i) {
    const glm::dvec2& v = hull[i];
    const glm::dvec2& next = hull[(i + 1) % n];
    // A sliver of an edge seen from the origin: axes reach out too far.
    if (!(v.x * next.y - v.y * next.x > 1e-9)) return {};
    Fan& fan = fans.emplace_back();
    fan.angle = std::atan2(v.y, v.x);
    fan.turn = glm::normalize(v);
    const std::array<glm::dvec2, 2> ends = {dual_of((i + n - 1) % n), dual_of(i)};
    for (size_t k = 0; k < 2; ++k) {
      fan.rim[k] = {-1.0 / glm::length(v), fan.turn.x * ends[k].y - fan.turn.y * ends[k].x};
    }
  }
  return fans;
}

struct Extent {
  size_t most = 0;
  size_t least = 0;
  double length = 0.0;
};
Extent ExtentOf(const std::vector<glm::dvec2>& hull, const glm::dvec2& normal) {
  Extent extent;
  double high = -kHuge;
  double low = kHuge;
  for (size_t i = 0; i < hull.size(); ++i) {
    const double along = glm::dot(normal, hull[i]);
    if (along > high) {
      high = along;
      extent.most = i;
    }
    if (along < low) {
      low = along;
      extent.least = i;
    }
  }
  extent.length = high - low;
  return extent;
}

/// m(p, q) and its partial derivatives.
struct EdgeNorm {
  double value = 0.0;
  double by_p = 0.0;
  double by_q = 0.0;
};
EdgeNorm EdgeNormOf(double p, double q) {
  const double a = std::abs(p);
  const double b = std::abs(q);
  const double s = std::max(a, b);
  const double t = std::min(a, b);
  if (!(s > 0.0)) return {};
  const double ratio = t / s;
  const double by_s = 0.25 - ratio * ratio / 12.0;
  const double by_t = ratio / 6.0;
  return {0.25 * s + t * ratio / 12.0, std::copysign(a >= b ? by_s : by_t, p),
          std::copysign(a >= b ? by_t : by_s, q)};
}

/// One cell of axes: everything that its boxes share. All coordinates are turned so that the fan's vertex
/// lies along x.
class Cell {
 public:
  Cell(const WhitenedSamples& samples, MapSize size, const Fan& fan, const FanCell& cell)
      : fan_(fan), cell_(cell), width_(size.width), height_(size.height), clusters_(kClusters) {
    const glm::dvec2 center = fan.AxisAt(cell.nearing, cell.along);
    const auto turned = [&fan](double x, double y) {
      return glm::dvec2(fan.turn.x * x + fan.turn.y * y, fan.turn.x * y - fan.turn.y * x);
    };
    for (const glm::dvec2& v : samples.hull) {
      const glm::dvec2 t = turned(v.x, v.y);
      hull_.push_back(t / (1.0 + glm::dot(center, t)));
    }
    for (const double nearing : {cell.nearing - cell.nearing_reach, cell.nearing + cell.nearing_reach}) {
      for (const double along : {cell.along - cell.along_reach, cell.along + cell.along_reach}) {
        corners_.push_back(fan.AxisAt(nearing, along) - center);
      }
    }
    PlaceAxis();
    for (size_t i = 0; i < samples.x.size(); ++i) {
      const glm::dvec2 x = turned(samples.x[i], samples.y[i]);
      const double w = 1.0 + glm::dot(center, x);
      glm::dvec2 g = w * (turned(samples.e1[i], samples.e2[i]) - center * double(samples.e3[i]));
      double f = w * samples.e3[i];
      if (g.y < 0.0) {
        g = -g;
        f = -f;
      }
      const double sum = std::abs(g.x) + g.y;
      if (!(sum > 0.0)) continue;
      // The diamond angle, as in edge_kernels.h.
      const auto bin = std::min(kClusters - 1, static_cast<size_t>((0.5 - 0.5 * g.x / sum) * kClusters));
      const glm::dvec2 centered = x / w;
      Cluster& cluster = clusters_[bin];
      cluster.g += g;
      cluster.g_by_x += glm::outerProduct(g, centered);
      cluster.f += f;
      cluster.f_x += f * centered;
    }
    std::erase_if(clusters_, [](const Cluster& cluster) { return cluster.g == glm::dvec2(0.0); });
  }

  struct Bound {
    double low = -kHuge;                    ///< Of the cost over the box.
    double center = kHuge;                  ///< Of the cost at the box's centre.
    std::array<double, kVariables> drop{};  ///< What each variable takes off the bound.
  };
  Bound BoundOf(const ShapeBox& box) const;

 private:
  static constexpr size_t kClusters = 64;

  struct Place {
    Dual d1x, d1y, d2x, d2y;  ///< Sides; across them lie (-y, x).
    Dual dx, dy;              ///< The axis.
    Dual first;               ///< e^-y / (W sin psi)
    Dual second;              ///< e^y / (H sin psi)
  };
  Place PlaceOf(const ShapeBox& box) const;

  void PlaceAxis();

  Fan fan_;
  FanCell cell_;
  double width_;
  double height_;
  Dual dx_;  ///< The axis, against the centre.
  Dual dy_;
  std::vector<glm::dvec2> corners_;  ///< Of the cell, likewise.
  std::vector<glm::dvec2> hull_;
  std::vector<Cluster> clusters_;
};

void Cell::PlaceAxis() {
  // a = (1 - e^-s) rim(along). All of e^-s lies within e^-s0 (e^reach - 1) of e^-s0.
  const double w = std::exp(-cell_.nearing);
  const Ball nearness{w, w * std::expm1(cell_.nearing_reach)};
  const Ball share{1.0 - w, nearness.radius};
  for (const glm::length_t axis : {0, 1}) {
    const double edge = fan_.rim[1][axis] - fan_.rim[0][axis];
    const Ball rim{fan_.rim[0][axis] + cell_.along * edge, cell_.along_reach * std::abs(edge)};
    Dual& d = axis == 0 ? dx_ : dy_;
    d.value = {0.0, (share * rim).radius};
    d.slope[kNearing] = nearness * rim;
    d.slope[kAlong] = edge * share;
  }
}

Cell::Place Cell::PlaceOf(const ShapeBox& box) const {
  Place place;
  // |cos(theta + phi) - cos(theta)| <= |sin(theta)| |phi| + |cos(theta)| phi^2 / 2, and so for the sine.
  const auto side = [](double angle, double reach, Dual* x, Dual* y) {
    const double c = std::cos(angle);
    const double s = std::sin(angle);
    x->value = {c, std::abs(s) * reach + 0.5 * std::abs(c) * reach * reach};
    y->value = {s, std::abs(c) * reach + 0.5 * std::abs(s) * reach * reach};
    x->slope[kDirection] = -1.0 * y->value;
    y->slope[kDirection] = x->value;
  };
  const double direction = box.direction - fan_.angle;
  side(direction, box.direction_reach, &place.d1x, &place.d1y);
  side(direction + box.angle, box.direction_reach + box.angle_reach, &place.d2x, &place.d2y);
  place.d2x.slope[kAngle] = place.d2x.slope[kDirection];
  place.d2y.slope[kAngle] = place.d2y.slope[kDirection];
  place.dx = dx_;
  place.dy = dy_;
  // 1 / sin is convex, e^y and e^-y are; so is what the slope -cos / sin^2 differs by, on either side.
  const auto ball = [](auto&& function, double at, double reach) {
    const double middle = function(at);
    return Ball{middle,
                std::max(std::abs(function(at + reach) - middle), std::abs(function(at - reach) - middle))};
  };
  const Ball inverse = ball([](double angle) { return 1.0 / std::sin(angle); }, box.angle, box.angle_reach);
  Ball by_angle = ball([](double angle) { return -std::cos(angle) / (std::sin(angle) * std::sin(angle)); },
                       box.angle, box.angle_reach);
  // Rising, concave below a right angle and convex above: its radius is that of the steepest line.
  const double steep = std::min(std::sin(box.angle - box.angle_reach), std::sin(box.angle + box.angle_reach));
  const double steepest = (2.0 - steep * steep) / (steep * steep * steep);
  by_angle.radius = std::max(by_angle.radius, steepest * box.angle_reach);
  const auto exponential = [](double y) { return std::exp(y); };
  const Ball stretch = ball(exponential, box.log_stretch, box.log_stretch_reach);
  const Ball shrink = ball(exponential, -box.log_stretch, box.log_stretch_reach);
  place.first.value = (1.0 / width_) * (inverse * shrink);
  place.first.slope[kAngle] = (1.0 / width_) * (by_angle * shrink);
  place.first.slope[kLogStretch] = -1.0 * place.first.value;
  place.second.value = (1.0 / height_) * (inverse * stretch);
  place.second.slope[kAngle] = (1.0 / height_) * (by_angle * stretch);
  place.second.slope[kLogStretch] = place.second.value;
  return place;
}

Dual GammaAlong(const Polynomial& gamma, const Dual& dx, const Dual& dy, const Dual& side_x,
                const Dual& side_y) {
  const Dual quadratic = -gamma.quadratic.x * dx + -gamma.quadratic.y * dy;
  const Dual x =
      Constant(gamma.constant.x) + gamma.linear[0][0] * dx + gamma.linear[1][0] * dy + quadratic * dx;
  const Dual y =
      Constant(gamma.constant.y) + gamma.linear[0][1] * dx + gamma.linear[1][1] * dy + quadratic * dy;
  return x * side_x + y * side_y;
}

/// n.v (1 - d.v) for n across a side.
Dual ReachAlong(const glm::dvec2& v, const Dual& dx, const Dual& dy, const Dual& side_x, const Dual& side_y) {
  const Dual along = v.y * side_x + -v.x * side_y;
  return along * (Constant(1.0) + -v.x * dx + -v.y * dy);
}

Cell::Bound Cell::BoundOf(const ShapeBox& box) const {
  Bound bound;
  const double direction1 = box.direction - fan_.angle;
  const double direction2 = direction1 + box.angle;
  const glm::dvec2 d1 = DirectionOf(direction1);
  const glm::dvec2 d2 = DirectionOf(direction2);
  // The normal of a side is the side turned by 90 degrees; its sign does not matter to a width.
  const glm::dvec2 n1 = Across(d1);
  const glm::dvec2 n2 = Across(d2);
  const Place at = PlaceOf(box);
  const double step1 = ExtentOf(hull_, n2).length * at.first.value.middle;
  const double step2 = ExtentOf(hull_, n1).length * at.second.value.middle;
  Polynomial gamma1;
  Polynomial gamma2;
  bound.center = 0.0;
  for (const Cluster& cluster : clusters_) {
    const EdgeNorm norm = EdgeNormOf(glm::dot(cluster.g, d1) * step1, glm::dot(cluster.g, d2) * step2);
    bound.center += norm.value;
    gamma1.Add(norm.by_p, cluster);
    gamma2.Add(norm.by_q, cluster);
  }

  // Vertices that are extreme somewhere in the box: at both ends of the normal's interval, and a little
  // beyond, for a change of axis turns the hull's edges. Any choice gives a bound.
  const double turn = std::min(0.1, cell_.nearing_reach + cell_.along_reach);
  const auto ends = [&](double angle, double swing) {
    return std::array{ExtentOf(hull_, Across(DirectionOf(angle - swing))),
                      ExtentOf(hull_, Across(DirectionOf(angle + swing)))};
  };
  const std::array<Extent, 2> across2 = ends(direction2, box.direction_reach + box.angle_reach + turn);
  const std::array<Extent, 2> across1 = ends(direction1, box.direction_reach + turn);

  // n.v (1 - d.v) is below the hull's reach wherever n.v is positive, or 1 - d.v is.
  const auto serves = [&](const glm::dvec2& v, double sign, double angle, double swing) {
    const auto near = [&v](const glm::dvec2& corner) { return glm::dot(corner, v) <= 1.0; };
    if (std::all_of(corners_.begin(), corners_.end(), near)) return true;
    const double length = glm::length(v);
    const double along = sign * glm::dot(v, Across(DirectionOf(angle))) / length;
    return along > std::sin(std::min(swing, 0.5 * kPi));
  };
  // The four sides of the parallelogram: the hull's reach along n2 and -n2, n1 and -n1.
  struct Side {
    std::array<glm::dvec2, 2> vertex;
    double sign = 1.0;
    bool second = false;  ///< Across side 1: of step 2.
    double weight = 0.0;  ///< Of vertex[1].
  };
  std::array<Side, 4> sides = {
      Side{{hull_[across2[0].most], hull_[across2[1].most]}, 1.0, false, 0.0},
      Side{{hull_[across2[0].least], hull_[across2[1].least]}, -1.0, false, 0.0},
      Side{{hull_[across1[0].most], hull_[across1[1].most]}, 1.0, true, 0.0},
      Side{{hull_[across1[0].least], hull_[across1[1].least]}, -1.0, true, 0.0},
  };
  const std::array<double, kVariables> reach = {cell_.nearing_reach, cell_.along_reach, box.direction_reach,
                                                box.angle_reach, box.log_stretch_reach};
  const auto gives_up = [&] {
    bound.low = -kHuge;
    // Large boxes: halve what is largest for its kind.
    bound.drop = reach;
    return bound;
  };
  for (const Side& side : sides) {
    const double angle = side.second ? direction1 : direction2;
    const double swing = side.second ? box.direction_reach : box.direction_reach + box.angle_reach;
    for (const glm::dvec2& v : side.vertex) {
      if (!serves(v, side.sign, angle, swing)) return gives_up();
    }
  }

  // Both products need factors that are not negative. Where a Gamma.d may be, its share of the cost is small,
  // and goes without: m is even in p and in q, so (0, nu) bounds it as (mu, nu) does.
  Dual gamma_1 = GammaAlong(gamma1, at.dx, at.dy, at.d1x, at.d1y);
  Dual gamma_2 = GammaAlong(gamma2, at.dx, at.dy, at.d2x, at.d2y);
  const bool without_1 = !(gamma_1.value.middle >= gamma_1.value.radius);
  const bool without_2 = !(gamma_2.value.middle >= gamma_2.value.radius);
  if (without_1 && without_2) return gives_up();
  if (without_1) gamma_1 = {};
  if (without_2) gamma_2 = {};
  const Dual factor1 = gamma_1 * at.first;
  const Dual factor2 = gamma_2 * at.second;

  // Weights: the bound is value - sum reach |slope|, and value and slopes are linear in each weight.
  std::array<std::array<Dual, 2>, 4> reaches;
  std::array<std::array<Center, 2>, 4> terms;
  Center sum{};
  for (size_t s = 0; s < sides.size(); ++s) {
    const Side& side = sides[s];
    const Dual& factor = side.second ? factor2 : factor1;
    for (size_t k = 0; k < 2; ++k) {
      if (k == 1 && side.vertex[0] == side.vertex[1]) {
        terms[s][1] = terms[s][0];
        break;
      }
      reaches[s][k] = side.sign * (side.second ? ReachAlong(side.vertex[k], at.dx, at.dy, at.d1x, at.d1y)
                                               : ReachAlong(side.vertex[k], at.dx, at.dy, at.d2x, at.d2y));
      // The product's centre alone.
      Center& center = terms[s][k];
      center[0] = reaches[s][k].value.middle * factor.value.middle;
      for (size_t v = 0; v < kVariables; ++v) {
        center[v + 1] = reaches[s][k].value.middle * factor.slope[v].middle +
                        reaches[s][k].slope[v].middle * factor.value.middle;
      }
    }
    for (size_t v = 0; v <= kVariables; ++v) sum[v] += terms[s][0][v];
  }
  const auto bound_of = [&](const Center& center) {
    double low = center[0];
    for (size_t k = 0; k < kVariables; ++k) low -= reach[k] * std::abs(center[k + 1]);
    return low;
  };
  for (int sweep = 0; sweep < 2; ++sweep) {
    for (size_t s = 0; s < sides.size(); ++s) {
      if (sides[s].vertex[0] == sides[s].vertex[1]) continue;
      Center change;
      Center without;
      for (size_t v = 0; v <= kVariables; ++v) {
        change[v] = terms[s][1][v] - terms[s][0][v];
        without[v] = sum[v] - sides[s].weight * change[v];
      }
      double best = -kHuge;
      const auto attempt = [&](double weight) {
        if (!(weight >= 0.0 && weight <= 1.0)) return;
        Center center;
        for (size_t v = 0; v <= kVariables; ++v) center[v] = without[v] + weight * change[v];
        const double low = bound_of(center);
        if (low <= best) return;
        best = low;
        sum = center;
        sides[s].weight = weight;
      };
      attempt(0.0);
      attempt(1.0);
      for (size_t v = 0; v < kVariables; ++v) {
        if (reach[v] > 0.0 && change[v + 1] != 0.0) attempt(-without[v + 1] / change[v + 1]);
      }
    }
  }

  Dual width1;
  Dual width2;
  for (size_t s = 0; s < sides.size(); ++s) {
    Dual& width = sides[s].second ? width1 : width2;
    if (sides[s].weight < 1.0) width = width + (1.0 - sides[s].weight) * reaches[s][0];
    if (sides[s].weight > 0.0) width = width + sides[s].weight * reaches[s][1];
  }
  const Dual cost = factor1 * width2 + factor2 * width1;
  bound.low = cost.value.middle;
  for (size_t k = 0; k < kVariables; ++k) {
    bound.drop[k] = reach[k] * (std::abs(cost.slope[k].middle) + 0.5 * cost.slope[k].radius);
    bound.low -= bound.drop[k];
  }
  // Where slopes explain less of the loss than curvature does, halving by slopes could go on in one variable
  // while another, without a slope here, keeps the bound down: then what is largest for its kind.
  const double curved = bound.center - cost.value.middle;
  if (curved > std::accumulate(bound.drop.begin(), bound.drop.end(), 0.0)) {
    const double all_reaches = std::accumulate(reach.begin(), reach.end(), 0.0);
    for (size_t k = 0; k < kVariables; ++k) bound.drop[k] = curved * reach[k] / all_reaches;
  }
  bound.low -= kRounding * bound.center;
  // What is added up is not negative.
  bound.low = std::max(bound.low, 0.0);
  return bound;
}

struct QueuedCell {
  size_t fan = 0;
  FanCell cell;
  std::vector<ShapeBox> boxes;
  double bound = 0.0;
  bool operator<(const QueuedCell& other) const { return bound > other.bound; }  // Least bound on top.
};

double CostOfSteps(const WhitenedSamples& samples, const glm::dvec2& axis, const glm::dvec2& b1,
                   const glm::dvec2& b2) {
  double sum = 0.0;
  for (size_t i = 0; i < samples.x.size(); ++i) {
    const double w = 1.0 + axis.x * samples.x[i] + axis.y * samples.y[i];
    const glm::dvec2 g = w * (glm::dvec2(samples.e1[i], samples.e2[i]) - axis * double(samples.e3[i]));
    sum += EdgeNormOf(glm::dot(g, b1), glm::dot(g, b2)).value;
  }
  return sum;
}

/// The metric at a matrix as it is, borders and all.
double CostOfFit(const WhitenedSamples& samples, const ShadowProjection& fit) {
  const glm::dmat3 h = fit.texel_from_ray * glm::inverse(samples.whitened_from_ray);
  const glm::dmat3 rows = glm::transpose(h);
  if (!(std::abs(rows[2].z) > 0.0)) return kHuge;
  const glm::dvec2 axis = glm::dvec2(rows[2]) / rows[2].z;
  for (const glm::dvec2& v : samples.hull) {
    if (!(1.0 + glm::dot(axis, v) > 0.0)) return kHuge;
  }
  // u_k = (h_k.xy - h_k.z axis) . v + h_k.z, h scaled so that its axis is (a, b, 1).
  const glm::dvec2 k1 = (glm::dvec2(rows[0]) - rows[0].z * axis) / rows[2].z;
  const glm::dvec2 k2 = (glm::dvec2(rows[1]) - rows[1].z * axis) / rows[2].z;
  const double det = k1.x * k2.y - k1.y * k2.x;
  return CostOfSteps(samples, axis, glm::dvec2(k2.y, -k2.x) / det, glm::dvec2(-k1.y, k1.x) / det);
}

}  // namespace

double ExactEdgeCost(const WhitenedSamples& samples, MapSize size, const glm::dvec2& axis, double direction,
                     double angle, double log_stretch) {
  std::vector<glm::dvec2> hull;
  for (const glm::dvec2& v : samples.hull) {
    const double w = 1.0 + glm::dot(axis, v);
    if (!(w > 0.0)) return kHuge;
    hull.push_back(v / w);
  }
  const glm::dvec2 d1 = DirectionOf(direction);
  const glm::dvec2 d2 = DirectionOf(direction + angle);
  const double sine = std::sin(angle);
  const double stretch = std::exp(log_stretch);
  const double step1 = ExtentOf(hull, Across(d2)).length / (size.width * stretch * sine);
  const double step2 = ExtentOf(hull, Across(d1)).length * stretch / (size.height * sine);
  return CostOfSteps(samples, axis, d1 * step1, d2 * step2);
}

double LowerBoundOver(const WhitenedSamples& samples, MapSize size, const CertifiedBox& box) {
  const std::vector<Fan> fans = FansOf(samples.hull);
  const Cell cell(samples, size, fans[box.fan], {box.nearing, box.along, box.nearing_reach, box.along_reach});
  return cell
      .BoundOf({box.direction, box.angle, box.log_stretch, box.direction_reach, box.angle_reach,
                box.log_stretch_reach, 0.0})
      .low;
}

glm::dvec2 CertifiedAxis(const WhitenedSamples& samples, size_t fan, double nearing, double along) {
  const std::vector<Fan> fans = FansOf(samples.hull);
  return fans[fan].TurnedBack(fans[fan].AxisAt(nearing, along));
}

Certificate Certify(const WhitenedSamples& samples, MapSize size, bool free_aspect,
                    const ShadowProjection& fit, const CertifyOptions& options,
                    const Cancellation& cancellation) {
  const SteadyClock::time_point start = SteadyClock::now();
  const auto seconds = [&start] { return std::chrono::duration<double>(SteadyClock::now() - start).count(); };
  Certificate certificate;
  certificate.cost = certificate.best_cost = CostOfFit(samples, fit);
  if (!(certificate.cost > 0.0)) {
    certificate.complete = true;
    return certificate;
  }
  // A hull without area is seen by axes without limit.
  const std::vector<Fan> fans = FansOf(samples.hull);
  if (fans.empty()) return certificate;

  glm::dvec2 best_axis(0.0);
  ShapeBox best_shape;
  const auto consider = [&](const glm::dvec2& axis, const ShapeBox& shape) {
    const double cost = ExactEdgeCost(samples, size, axis, shape.direction, shape.angle, shape.log_stretch);
    if (!(cost < certificate.best_cost * (1.0 - 1e-6))) return;
    certificate.best_cost = cost;
    certificate.improved = true;
    best_axis = axis;
    best_shape = shape;
  };
  const auto enough = [&] { return certificate.best_cost / (1.0 + options.tolerance); };

  // All shapes: sixteen directions in half a turn; where the map is square its sides may change places.
  constexpr int kDirections = 8;
  const double least_angle = std::asin(kCertifiedSine);
  const double most_angle = size.width == size.height ? 0.5 * kPi : kPi - least_angle;
  const int angles = size.width == size.height ? 4 : 8;
  const double most_stretch = free_aspect ? std::log(kCertifiedStretch) : 0.0;
  const int stretches = free_aspect ? 4 : 1;
  QueuedCell first;
  for (int i = 0; i < kDirections; ++i) {
    for (int j = 0; j < angles; ++j) {
      for (int k = 0; k < stretches; ++k) {
        ShapeBox& box = first.boxes.emplace_back();
        box.direction_reach = 0.5 * kPi / kDirections;
        box.direction = (2 * i + 1) * box.direction_reach;
        box.angle_reach = 0.5 * (most_angle - least_angle) / angles;
        box.angle = least_angle + (2 * j + 1) * box.angle_reach;
        box.log_stretch_reach = most_stretch / stretches;
        box.log_stretch = -most_stretch + (2 * k + 1) * box.log_stretch_reach;
      }
    }
  }
  std::priority_queue<QueuedCell> queue;
  for (size_t fan = 0; fan < fans.size(); ++fan) {
    first.fan = fan;
    first.cell.nearing = first.cell.nearing_reach = -0.5 * std::log(kCertifiedNearness);
    first.cell.along = first.cell.along_reach = 0.5;
    queue.push(first);
  }
  double dropped = kHuge;  ///< The least bound of the boxes that are done with.
  bool stopped = false;
  const auto halve = [](double& low_center, double& low_reach, double& high_center, double& high_reach) {
    low_reach *= 0.5;
    high_reach = low_reach;
    low_center -= low_reach;
    high_center += low_reach;
  };
  while (!queue.empty()) {
    if (cancellation.Requested() || seconds() > options.time_limit) {
      stopped = true;
      break;
    }
    const QueuedCell parent = queue.top();
    queue.pop();
    ++certificate.cells;
    const Fan& fan = fans[parent.fan];
    const Cell cell(samples, size, fan, parent.cell);
    const glm::dvec2 center = fan.TurnedBack(fan.AxisAt(parent.cell.nearing, parent.cell.along));
    std::vector<ShapeBox> open = parent.boxes;
    QueuedCell rest;
    rest.bound = kHuge;
    glm::dvec2 drop(0.0);
    while (!open.empty()) {
      ShapeBox box = open.back();
      open.pop_back();
      ++certificate.boxes;
      const Cell::Bound bound = cell.BoundOf(box);
      box.bound = std::max(bound.low, box.bound);
      if (bound.center < certificate.best_cost) consider(center, box);
      if (box.bound >= enough()) {
        dropped = std::min(dropped, box.bound);
        continue;
      }
      const auto worst =
          static_cast<size_t>(std::max_element(bound.drop.begin(), bound.drop.end()) - bound.drop.begin());
      if (worst == kNearing || worst == kAlong) {
        drop += glm::dvec2(bound.drop[kNearing], bound.drop[kAlong]);
        rest.bound = std::min(rest.bound, box.bound);
        rest.boxes.push_back(box);
        continue;
      }
      ShapeBox upper = box;
      if (worst == kDirection) {
        halve(box.direction, box.direction_reach, upper.direction, upper.direction_reach);
      } else if (worst == kAngle) {
        halve(box.angle, box.angle_reach, upper.angle, upper.angle_reach);
      } else {
        halve(box.log_stretch, box.log_stretch_reach, upper.log_stretch, upper.log_stretch_reach);
      }
      open.push_back(box);
      open.push_back(upper);
    }
    if (rest.boxes.empty()) continue;
    rest.fan = parent.fan;
    rest.cell = parent.cell;
    QueuedCell other = rest;
    if (drop.x >= drop.y) {
      halve(rest.cell.nearing, rest.cell.nearing_reach, other.cell.nearing, other.cell.nearing_reach);
    } else {
      halve(rest.cell.along, rest.cell.along_reach, other.cell.along, other.cell.along_reach);
    }
    queue.push(std::move(rest));
    queue.push(std::move(other));
  }

  certificate.lower_bound = std::min(dropped, certificate.best_cost);
  if (stopped && !queue.empty()) {
    certificate.lower_bound = std::min(certificate.lower_bound, std::max(queue.top().bound, 0.0));
  }
  certificate.complete = !stopped;
  if (certificate.improved) {
    const AffineShape shape{DirectionOf(best_shape.direction),
                            DirectionOf(best_shape.direction + best_shape.angle),
                            std::exp(best_shape.log_stretch)};
    const EdgeFit edge_fit(samples, size, free_aspect);
    certificate.best.size = edge_fit.SizeOf(shape);
    certificate.best.texel_from_ray = WithUnitAxis(
        edge_fit.TexelFromWhitened(best_axis, shape, certificate.best.size) * samples.whitened_from_ray);
  }
  certificate.seconds = seconds();
  return certificate;
}

}  // namespace shadowfit
