#pragma once

#include <cstddef>
#include <cstdint>

namespace shadowfit {

/// A borrowed picture of one value a pixel. Row 0 is at the bottom, as clip-space y runs: a picture that is
/// stored top row first is described by a pointer to its last row and a negative stride, and needs no copy.
template <typename T>
struct ImageView {
  const T* bottom_row = nullptr;
  std::ptrdiff_t row_stride = 0;  ///< In elements; negative for pictures stored top row first.
  int width = 0;
  int height = 0;

  const T* Row(int y) const { return bottom_row + y * row_stride; }
  T At(int x, int y) const { return Row(y)[x]; }
};

/// Window depth in [0,1] as a depth buffer holds it. NaN, infinities and the far plane's value are
/// background.
using DepthView = ImageView<float>;

/// Bit i set: light i leaves this pixel in shadow.
using BitsView = ImageView<uint32_t>;

template <typename T>
ImageView<T> BottomFirst(const T* data, int width, int height) {
  return {data, width, width, height};
}
template <typename T>
ImageView<T> TopFirst(const T* data, int width, int height) {
  return {data + std::ptrdiff_t(width) * (height - 1), -std::ptrdiff_t(width), width, height};
}

}  // namespace shadowfit
