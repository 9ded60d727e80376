#pragma once

#include <array>
#include <glm/glm.hpp>

namespace shadowfit {

/// An axis-aligned box; empty until a point is added.
struct Bounds {
  glm::dvec3 min{1e300};
  glm::dvec3 max{-1e300};

  bool empty() const { return !(min.x <= max.x && min.y <= max.y && min.z <= max.z); }
  void Add(const glm::dvec3& p) {
    min = glm::min(min, p);
    max = glm::max(max, p);
  }
  glm::dvec3 Center() const { return 0.5 * (min + max); }
  std::array<glm::dvec3, 8> Corners() const {
    std::array<glm::dvec3, 8> corners;
    for (int i = 0; i < 8; ++i) {
      corners[static_cast<size_t>(i)] = {(i & 1) != 0 ? max.x : min.x, (i & 2) != 0 ? max.y : min.y,
                                         (i & 4) != 0 ? max.z : min.z};
    }
    return corners;
  }
};

}  // namespace shadowfit
