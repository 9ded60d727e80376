#pragma once

#include <memory>
#include <mutex>
#include <utility>
#include <vector>

namespace shadowfit {

/// Objects with large working memory, shared by calls so that each finds that memory warm: never more than
/// run at a time. Thread-safe.
template <typename T>
class IdlePool {
 public:
  /// An object for one call; gives it back when it goes.
  class Lease {
   public:
    Lease(IdlePool& owner, std::unique_ptr<T> object) : owner_(owner), object_(std::move(object)) {}
    ~Lease() {
      const std::lock_guard lock(owner_.mutex_);
      owner_.idle_.push_back(std::move(object_));
    }
    Lease(const Lease&) = delete;
    Lease& operator=(const Lease&) = delete;
    T* operator->() const { return object_.get(); }

   private:
    IdlePool& owner_;
    std::unique_ptr<T> object_;
  };

  /// An idle object, or a new one made from `args`, which are the same for all of a pool.
  template <typename... Args>
  Lease Take(Args&&... args) {
    std::unique_ptr<T> object;
    {
      const std::lock_guard lock(mutex_);
      if (!idle_.empty()) {
        object = std::move(idle_.back());
        idle_.pop_back();
      }
    }
    if (object == nullptr) object = std::make_unique<T>(std::forward<Args>(args)...);
    return Lease(*this, std::move(object));
  }

 private:
  std::mutex mutex_;
  std::vector<std::unique_ptr<T>> idle_;
};

}  // namespace shadowfit
