#pragma once

#include <array>
#include <cmath>
#include <glm/glm.hpp>
#include <vector>

#include "core/frame/light_samples.h"

namespace shadowfit {

/// A straight line in the plane of a map's texels, and with the light a plane through the map's rays: where
/// dot(normal, u) = offset.
struct DividingLine {
  double angle = 0.0;   ///< Of the normal, in radians.
  double offset = 0.0;  ///< In texels.

  glm::dvec2 Normal() const { return {std::cos(angle), std::sin(angle)}; }
};

/// Lines that may divide what one map holds so that two do better.
///
/// The map's fit has made its texels as even as it can. So in its plane the cost of a part is about that of
/// its samples times the side of the square that holds it: the root of the area of their hull.
class DividingLines {
 public:
  /// Looks at some hundreds of the hull samples.
  DividingLines(const LightSamples& samples, const glm::dmat3& texel_from_ray);

  /// The best lines of several directions, the cheapest first. None where there are too few samples.
  std::vector<DividingLine> Promising() const;

  /// `line` turned both ways, and moved both ways, by `step` of what lies between neighbours in Promising().
  std::array<DividingLine, 4> Near(const DividingLine& line, double step) const;

  /// Positive on the side that the line's normal points to.
  glm::dvec3 Covector(const DividingLine& line) const;

 private:
  struct Choice;
  Choice BestOf(double angle) const;

  glm::dmat3 texel_from_ray_;
  std::vector<glm::dvec2> points_;
  glm::dvec2 middle_{0.0};
};

}  // namespace shadowfit
