#include "core/fit/quasi_newton.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

namespace shadowfit {
namespace {

using Vector = DescentPoint<2>::Vector;

template <class Objective>
DescentPoint<2> StartAt(const Vector& at, const Objective& objective) {
  DescentPoint<2> start;
  start.at = at;
  start.inverse_hessian = {{{0.1, 0.0}, {0.0, 0.1}}};
  start.value = objective(at, &start.gradient);
  return start;
}

TEST(QuasiNewton, FollowsRosenbrocksValley) {
  const auto rosenbrock = [](const Vector& p, Vector* gradient) {
    const double x = p[0];
    const double across = p[1] - x * x;
    *gradient = {-2.0 * (1.0 - x) - 400.0 * x * across, 200.0 * across};
    return (1.0 - x) * (1.0 - x) + 100.0 * across * across;
  };
  const DescentPoint<2> end = DescendQuasiNewton(rosenbrock, StartAt({-1.2, 1.0}, rosenbrock), 200, 1e-14);
  EXPECT_LT(end.value, 1e-9);
  EXPECT_NEAR(end.at[0], 1.0, 1e-4);
  EXPECT_NEAR(end.at[1], 1.0, 1e-4);
}

TEST(QuasiNewton, FindsAMinimumOnAKink) {
  // A crease along y = 2 x, as where a side lies on an edge of the hull, and a bowl along it.
  const auto crease = [](const Vector& p, Vector* gradient) {
    const double across = p[1] - 2.0 * p[0];
    const double along = p[0] + 0.5 * p[1] - 1.0;
    const double sign = across > 0.0 ? 1.0 : -1.0;
    *gradient = {-20.0 * sign + 2.0 * along, 10.0 * sign + along};
    return 10.0 * std::abs(across) + along * along;
  };
  const DescentPoint<2> end = DescendQuasiNewton(crease, StartAt({3.0, -2.0}, crease), 120, 1e-9);
  EXPECT_LT(end.value, 1e-3);
  EXPECT_NEAR(end.at[0], 0.5, 0.05);
  EXPECT_NEAR(end.at[1], 1.0, 0.1);
}

TEST(QuasiNewton, StaysWhereTheObjectiveIsFinite) {
  // The minimum is beyond the wall.
  const auto walled = [](const Vector& p, Vector* gradient) {
    *gradient = {-1.0, 0.0};
    return p[0] > 1.0 ? std::numeric_limits<double>::infinity() : -p[0];
  };
  const DescentPoint<2> end = DescendQuasiNewton(walled, StartAt({0.0, 0.0}, walled), 60, 1e-9);
  EXPECT_LE(end.at[0], 1.0);
  EXPECT_GT(end.at[0], 0.95);
}

TEST(QuasiNewton, KeepsToItsEvaluationsAndNeverRises) {
  for (int most = 0; most < 12; ++most) {
    int used = 0;
    const auto bowl = [&used](const Vector& p, Vector* gradient) {
      ++used;
      *gradient = {2.0 * p[0], 200.0 * p[1]};
      return p[0] * p[0] + 100.0 * p[1] * p[1];
    };
    const DescentPoint<2> start = StartAt({5.0, 3.0}, bowl);
    used = 0;
    EXPECT_LE(DescendQuasiNewton(bowl, start, most, 0.0).value, start.value);
    EXPECT_LE(used, most);
  }
}

}  // namespace
}  // namespace shadowfit
