#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <limits>

namespace shadowfit {

/// A point of an N-dimensional descent, the objective's value and slopes there, and the inverse Hessian that
/// the descent goes by, which a further descent from the point may take over.
template <size_t N>
struct DescentPoint {
  using Vector = std::array<double, N>;
  Vector at{};
  double value = std::numeric_limits<double>::infinity();
  Vector gradient{};
  std::array<Vector, N> inverse_hessian{};
};

/// Broyden, Fletcher, Goldfarb and Shanno's quasi-Newton descent with a weak Wolfe line search by bisection,
/// which works on functions with kinks, too: Lewis, Overton, "Nonsmooth optimization via quasi-Newton
/// methods", Math. Program. 141 (2013). Its matrix learns the kink that minima of enclosing shapes lie on.
///
/// `objective(at, &gradient)` returns the value, infinite where `at` is not allowed, and fills the gradient
/// elsewhere. `point` has value and gradient. Ends after `most_evaluations`, or where two steps in a row gain
/// less than `tolerance`. Never ends above where it began.
template <size_t N, class Objective>
DescentPoint<N> DescendQuasiNewton(const Objective& objective, DescentPoint<N> point, int most_evaluations,
                                   double tolerance) {
  using Vector = typename DescentPoint<N>::Vector;
  constexpr double kSufficientDecrease = 1e-4;
  constexpr double kCurvature = 0.5;
  constexpr int kMostBisections = 10;
  const auto dot = [](const Vector& a, const Vector& b) {
    double sum = 0.0;
    for (size_t i = 0; i < N; ++i) sum += a[i] * b[i];
    return sum;
  };
  auto& h = point.inverse_hessian;
  int idle = 0;
  for (int used = 0; used < most_evaluations && idle < 2;) {
    Vector direction;
    for (size_t i = 0; i < N; ++i) direction[i] = -dot(h[i], point.gradient);
    const double slope = dot(direction, point.gradient);
    if (!(slope < 0.0)) break;
    double low = 0.0;
    double high = std::numeric_limits<double>::infinity();
    double step = 1.0;
    Vector at = point.at;
    Vector gradient = point.gradient;
    double value = point.value;
    // The best of the line, should the evaluations run out.
    bool found = false;
    for (int k = 0; k < kMostBisections && used < most_evaluations; ++k) {
      Vector tried;
      Vector tried_gradient;
      for (size_t i = 0; i < N; ++i) tried[i] = point.at[i] + step * direction[i];
      const double tried_value = objective(tried, &tried_gradient);
      ++used;
      if (!(tried_value <= point.value + kSufficientDecrease * step * slope)) {
        high = step;
      } else {
        found = true;
        at = tried;
        gradient = tried_gradient;
        value = tried_value;
        if (!(dot(tried_gradient, direction) < kCurvature * slope)) break;
        low = step;
      }
      step = high < std::numeric_limits<double>::infinity() ? 0.5 * (low + high) : 2.0 * step;
    }
    if (!found) break;
    Vector s;
    Vector y;
    for (size_t i = 0; i < N; ++i) {
      s[i] = at[i] - point.at[i];
      y[i] = gradient[i] - point.gradient[i];
    }
    idle = point.value - value < tolerance ? idle + 1 : 0;
    point.at = at;
    point.value = value;
    point.gradient = gradient;
    const double sy = dot(s, y);
    if (!(sy > 0.0)) continue;
    Vector hy;
    for (size_t i = 0; i < N; ++i) hy[i] = dot(h[i], y);
    const double scale = (1.0 + dot(y, hy) / sy) / sy;
    for (size_t i = 0; i < N; ++i) {
      for (size_t j = 0; j < N; ++j) h[i][j] += scale * s[i] * s[j] - (hy[i] * s[j] + s[i] * hy[j]) / sy;
    }
  }
  return point;
}

}  // namespace shadowfit
