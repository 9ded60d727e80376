#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "core/frame/camera.h"
#include "core/frame/light_samples.h"
#include "core/math/ray_space.h"

namespace shadowfit {

// What the sampler computes of each pixel that it looks at, and of each light on it: vectorised with run-time
// dispatch (Highway), in doubles.

/// What pixels' surfaces are unprojected from, structure of arrays.
struct PixelDepths {
  std::vector<double> ndc[3];     ///< Of the pixels' centres.
  std::vector<double> dz1, dz2;   ///< NDC depth per low-resolution pixel along screen x and y.
  std::vector<uint8_t> reliable;  ///< 1 where the derivatives follow the surface.

  size_t size() const { return reliable.size(); }
  void Clear();
  void Reserve(size_t count);
};

/// Surfaces of pixels in world space, structure of arrays; derivatives are per low-resolution pixel.
struct PixelSurfaces {
  std::vector<double> ws_position[3];
  std::vector<double> ws_dx1[3];
  std::vector<double> ws_dx2[3];
  std::vector<double> ws_normal[3];  ///< Towards the viewer, unit length; 0 where there is none.
  std::vector<uint8_t> reliable;     ///< 1 where the derivatives follow the surface.

  size_t size() const { return reliable.size(); }
};

/// `width` and `height` are those of the low-resolution picture.
void UnprojectPixels(const Camera& camera, int width, int height, const PixelDepths& pixels,
                     PixelSurfaces* surfaces);

/// Pixels to look at. Arrays are read a vector at a time: the vectors behind such lists are padded.
class PixelList {
 public:
  void Clear() { count_ = 0; }
  void Add(size_t pixel) {
    if (count_ + kPadding >= indices_.size()) indices_.resize(2 * (count_ + kPadding));
    indices_[count_++] = static_cast<int32_t>(pixel);
  }
  /// Repeats the last pixel beyond the end, so that a vector that begins before it may be read.
  void Pad() {
    for (size_t i = 0; i < kPadding && count_ > 0; ++i) indices_[count_ + i] = indices_[count_ - 1];
  }
  size_t size() const { return count_; }
  size_t operator[](size_t i) const { return static_cast<size_t>(indices_[i]); }
  const int32_t* data() const { return indices_.data(); }

  static constexpr size_t kPadding = 8;

 private:
  std::vector<int32_t> indices_;
  size_t count_ = 0;
};

/// A pixel that the light does not shine on at all, outside a spot's cone.
inline constexpr double kUnlit = -2.0;

/// The cosines between the listed pixels' normals and their directions to the light, or kUnlit; `cosines` is
/// resized to the list's size.
void LightCosines(const PixelSurfaces& surfaces, const PixelList& pixels, const RaySpace& ray_space,
                  std::vector<double>* cosines);

/// Fills the hull samples of `samples` with the listed pixels.
void FillHull(const PixelSurfaces& surfaces, const PixelList& pixels, const RaySpace& ray_space,
              LightSamples* samples);

}  // namespace shadowfit
