#pragma once

#include <sys/mman.h>

#include <cstddef>
#include <memory>
#include <new>
#include <type_traits>

namespace shadowfit::irregular {

/// Cache-line aligned scratch memory that only ever grows, so that a stream of frames of one size allocates
/// once. Contents are not initialised and do not survive growth. Large buffers are read in no order that a
/// table of small pages could follow. They are mapped by themselves and ask for large pages: what an
/// allocator hands out anew, in a process that has run for a while, lies on the small pages it had before.
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
    data_ = bytes < kLargePage ? Allocate(bytes) : Map(bytes);
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
  static constexpr size_t kCacheLine = 64;
  static constexpr size_t kLargePage = size_t{2} << 20;
  struct Delete {
    void* mapping = nullptr;  ///< Of a large buffer.
    size_t mapped_bytes = 0;
    void operator()(T* p) const {
      if (mapping != nullptr) {
        munmap(mapping, mapped_bytes);
      } else {
        ::operator delete[](p, std::align_val_t{kCacheLine});
      }
    }
  };

  using Data = std::unique_ptr<T, Delete>;

  static Data Allocate(size_t bytes) {
    return Data(static_cast<T*>(::operator new[](bytes, std::align_val_t{kCacheLine}, std::nothrow)));
  }

  static Data Map(size_t bytes) {
    const size_t mapped_bytes = bytes + kLargePage;  // Room to align it.
    void* const mapping =
        mmap(nullptr, mapped_bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (mapping == MAP_FAILED) return nullptr;
    void* aligned = mapping;
    size_t space = mapped_bytes;
    std::align(kLargePage, bytes, aligned, space);
#ifdef MADV_HUGEPAGE
    madvise(aligned, bytes, MADV_HUGEPAGE);  // Without effect where it is refused.
#endif
    return Data(static_cast<T*>(aligned), Delete{mapping, mapped_bytes});
  }

  Data data_;
  size_t capacity_ = 0;
};

}  // namespace shadowfit::irregular
