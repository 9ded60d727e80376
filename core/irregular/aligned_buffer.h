#pragma once

#include <cstddef>
#include <memory>
#include <new>
#include <type_traits>

namespace shadowfit::irregular {

/// Cache-line aligned scratch memory that only ever grows, so that a stream of frames of one size allocates
/// once. Contents are not initialised and do not survive growth.
template <typename T>
class AlignedBuffer {
  static_assert(std::is_trivially_copyable_v<T>);

 public:
  /// False where memory runs out; the buffer is then empty.
  [[nodiscard]] bool Reserve(size_t count) {
    if (count <= capacity_) return true;
    data_.reset();
    capacity_ = 0;
    data_.reset(static_cast<T*>(::operator new[](count * sizeof(T), kAlignment, std::nothrow)));
    if (data_ == nullptr) return false;
    capacity_ = count;
    return true;
  }

  T* data() { return data_.get(); }
  const T* data() const { return data_.get(); }
  T& operator[](size_t i) { return data_.get()[i]; }
  const T& operator[](size_t i) const { return data_.get()[i]; }
  size_t capacity() const { return capacity_; }
  size_t MemoryBytes() const { return capacity_ * sizeof(T); }

 private:
  static constexpr std::align_val_t kAlignment{64};
  struct Delete {
    void operator()(T* p) const { ::operator delete[](p, kAlignment); }
  };
  std::unique_ptr<T, Delete> data_;
  size_t capacity_ = 0;
};

}  // namespace shadowfit::irregular
