#pragma once

#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include "core/irregular/shadow_masks.h"

namespace shadowfit {

/// Mask renderers and their working memory, which is large, shared by all calls and streams: never more than
/// run at a time. Thread-safe.
class MaskRenderers {
 public:
  /// A renderer for one call; gives it back when it goes.
  class Lease {
   public:
    Lease(MaskRenderers& owner, std::unique_ptr<MaskRenderer> renderer)
        : owner_(owner), renderer_(std::move(renderer)) {}
    ~Lease() {
      const std::lock_guard lock(owner_.mutex_);
      owner_.idle_.push_back(std::move(renderer_));
    }
    Lease(const Lease&) = delete;
    Lease& operator=(const Lease&) = delete;
    MaskRenderer* operator->() const { return renderer_.get(); }

   private:
    MaskRenderers& owner_;
    std::unique_ptr<MaskRenderer> renderer_;
  };

  Lease Take() {
    std::unique_ptr<MaskRenderer> renderer;
    {
      const std::lock_guard lock(mutex_);
      if (!idle_.empty()) {
        renderer = std::move(idle_.back());
        idle_.pop_back();
      }
    }
    if (renderer == nullptr) renderer = std::make_unique<MaskRenderer>();
    return Lease(*this, std::move(renderer));
  }

 private:
  std::mutex mutex_;
  std::vector<std::unique_ptr<MaskRenderer>> idle_;
};

}  // namespace shadowfit
