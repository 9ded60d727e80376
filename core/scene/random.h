#pragma once

#include <cmath>
#include <cstdint>
#include <glm/glm.hpp>
#include <numbers>

namespace shadowfit {

/// SplitMix64 (Steele, Lea, Flood 2014). The standard library's distributions differ from one implementation
/// to the next; a seed of ours means one scene everywhere.
class Random {
 public:
  explicit Random(uint64_t seed) : state_(seed) {}

  uint64_t Next() {
    state_ += 0x9e3779b97f4a7c15u;
    uint64_t z = state_;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
  }
  /// In [low, high).
  double Uniform(double low, double high) {
    return low + (high - low) * (static_cast<double>(Next() >> 11) * 0x1p-53);
  }
  /// Uniform on the unit sphere.
  glm::dvec3 Direction() {
    const double z = Uniform(-1.0, 1.0);
    const double angle = Uniform(0.0, 2.0 * std::numbers::pi);
    const double radius = std::sqrt(1.0 - z * z);
    return {radius * std::cos(angle), radius * std::sin(angle), z};
  }

 private:
  uint64_t state_;
};

}  // namespace shadowfit
