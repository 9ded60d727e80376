#pragma once

#include <glm/glm.hpp>
#include <limits>
#include <random>

namespace shadowfit {

inline constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
inline constexpr float kInf = std::numeric_limits<float>::infinity();

/// Random numbers and the things that frames are made of.
class Random {
 public:
  explicit Random(unsigned seed) : engine_(seed) {}
  double In(double low, double high) { return std::uniform_real_distribution<double>(low, high)(engine_); }
  int Int(int low, int high) { return std::uniform_int_distribution<int>(low, high)(engine_); }
  glm::dvec3 Vector(double size) { return {In(-size, size), In(-size, size), In(-size, size)}; }
  glm::dvec3 Direction() {
    for (;;) {
      const glm::dvec3 v = Vector(1.0);
      const double length = glm::length(v);
      if (length > 0.1 && length < 1.0) return v / length;
    }
  }
  std::mt19937& engine() { return engine_; }

 private:
  std::mt19937 engine_;
};

}  // namespace shadowfit
