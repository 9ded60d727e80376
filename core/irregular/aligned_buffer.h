#pragma once

#include <sys/mman.h>

#include <cstddef>
#include <memory>
#include <new>
#include <type_traits>

namespace shadowfit::irregular {

/// Cache-line aligned scratch memory that only ever grows, so that a stream of frames of one size allocates
/// once. Contents are not initialised and do not survive growth. Large buffers ask for large pages: they are
/// read in no order that a table of small ones could follow.
template <typename T>
class AlignedBuffer {
  static_assert(std::is_trivially_copyable_v<T>);

 public:
  /// False where memory runs out; the buffer is then empty.
  [[nodiscard]] bool Reserve(size_t count) {
    if (count <= capacity_) return true;
    data_.reset();
    capacity_ = 0;
    const size_t bytes = count * sizeof(T);
    const bool large = bytes >= kLargePage;
    data_.get_deleter().alignment = std::align_val_t{large ? kLargePage : kCacheLine};
    data_.reset(static_cast<T*>(::operator new[](bytes, data_.get_deleter().alignment, std::nothrow)));
    if (data_ == nullptr) return false;
#ifdef MADV_HUGEPAGE
    if (large) madvise(data_.get(), bytes, MADV_HUGEPAGE);  // Without effect where it is refused.
#endif
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
  static constexpr size_t kCacheLine = 64;
  static constexpr size_t kLargePage = size_t{2} << 20;
  struct Delete {
    std::align_val_t alignment{kCacheLine};
    void operator()(T* p) const { ::operator delete[](p, alignment); }
  };
  std::unique_ptr<T, Delete> data_;
  size_t capacity_ = 0;
};

}  // namespace shadowfit::irregular
