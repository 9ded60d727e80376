#pragma once

#include <tbb/cache_aligned_allocator.h>

#include <algorithm>
#include <cstddef>
#include <vector>

namespace shadowfit {

/// The widest vector of 32-bit lanes that any code here uses: what may be touched beyond the end of a list or
/// of a row of pixels.
inline constexpr int kMostLanes = 16;

/// Vectors that begin at a cache line do not straddle two.
template <typename T>
using AlignedVector = std::vector<T, tbb::cache_aligned_allocator<T>>;

/// A list that is read and written a vector at a time, and keeps its memory.
template <typename T>
class LaneList {
 public:
  size_t size() const { return size_; }
  const T* data() const { return values_.data(); }
  T* data() { return values_.data(); }
  T operator[](size_t i) const { return values_[i]; }

  /// Room for `size` elements and a vector beyond. Those below size() stay.
  void Reserve(size_t size) {
    const size_t needed = size + kMostLanes;
    if (values_.size() < needed) values_.resize(std::max(needed, 2 * values_.size()));
  }
  void Resize(size_t size) {
    Reserve(size);
    size_ = size;
  }
  void Append(T value) {
    Resize(size_ + 1);
    values_[size_ - 1] = value;
  }
  /// Fills the vector beyond the end.
  void Pad(T value) {
    Reserve(size_);
    std::fill_n(values_.begin() + static_cast<std::ptrdiff_t>(size_), kMostLanes, value);
  }

 private:
  AlignedVector<T> values_;
  size_t size_ = 0;
};

}  // namespace shadowfit
