#pragma once

#include <atomic>
#include <cstddef>
#include <list>
#include <memory>
#include <mutex>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "core/irregular/mask_scene.h"

namespace shadowfit {

/// The scenes that the service keeps, by digest, in a bounded amount of memory. Thread-safe.
///
/// A scene is used for as long as somebody holds its handle; those that nobody uses are forgotten, the one
/// used longest ago first, where room is needed.
class SceneStore {
 public:
  /// Bytes of the quota that are taken; given back when it goes.
  class Room {
   public:
    Room() = default;
    Room(Room&& other) noexcept : taken_(std::move(other.taken_)), bytes_(std::exchange(other.bytes_, 0)) {}
    Room& operator=(Room&& other) noexcept {
      std::swap(taken_, other.taken_);
      std::swap(bytes_, other.bytes_);
      return *this;
    }
    ~Room() {
      if (taken_ != nullptr) *taken_ -= bytes_;
    }
    size_t bytes() const { return bytes_; }
    /// Gives back what is more than so many bytes.
    void ShrinkTo(size_t bytes) {
      if (bytes >= bytes_) return;
      *taken_ -= std::exchange(bytes_, bytes) - bytes;
    }

   private:
    friend class SceneStore;
    Room(std::shared_ptr<std::atomic<size_t>> taken, size_t bytes)
        : taken_(std::move(taken)), bytes_(bytes) {}
    std::shared_ptr<std::atomic<size_t>> taken_;
    size_t bytes_ = 0;
  };

  struct StoredScene {
    std::string digest;
    MaskScene scene;
    Room room;  ///< Lasts as long as the memory does, forgotten or not.
  };
  using Handle = std::shared_ptr<const StoredScene>;

  struct Entry {
    Handle scene;
    int uses = 0;  ///< Handles elsewhere.
  };

  explicit SceneStore(size_t quota_bytes)
      : quota_bytes_(quota_bytes), taken_(std::make_shared<std::atomic<size_t>>(0)) {}

  /// The scene, which counts as used now; null where there is none.
  Handle Find(const std::string& digest);

  /// Room for a scene of so many bytes, for which unused scenes are forgotten. ResourceExhausted where the
  /// quota is less, Unavailable with a RetryInfo where scenes in use leave too little of it.
  absl::StatusOr<Room> TakeRoom(size_t bytes);

  /// Keeps a scene in the room taken for it, unless its digest is there already; returns the one that is
  /// kept.
  Handle Insert(std::string digest, MaskScene scene, Room room);

  /// Forgets a scene; false where there is none.
  bool Erase(const std::string& digest);

  /// Most recently used first.
  std::vector<Entry> List() const;
  size_t bytes() const { return *taken_; }
  size_t quota_bytes() const { return quota_bytes_; }

 private:
  const size_t quota_bytes_;
  const std::shared_ptr<std::atomic<size_t>> taken_;
  mutable std::mutex mutex_;
  std::list<Handle> scenes_;  ///< Most recently used first.
  std::unordered_map<std::string, std::list<Handle>::iterator> by_digest_;
};

/// The scene of a request's field `scene_digest`. InvalidArgument where that is no digest, NotFound where the
/// store does not have it.
absl::StatusOr<SceneStore::Handle> FindScene(SceneStore& scenes, const std::string& digest);

}  // namespace shadowfit
