#include "server/scene_store.h"

#include <algorithm>

#include "absl/strings/str_format.h"
#include "server/errors.h"
#include "server/scene_digest.h"

namespace shadowfit {

SceneStore::Handle SceneStore::Find(const std::string& digest) {
  const std::lock_guard lock(mutex_);
  const auto found = by_digest_.find(digest);
  if (found == by_digest_.end()) return nullptr;
  scenes_.splice(scenes_.begin(), scenes_, found->second);
  return *found->second;
}

absl::StatusOr<SceneStore::Room> SceneStore::TakeRoom(size_t bytes) {
  if (bytes > quota_bytes_) {
    return absl::ResourceExhaustedError(
        absl::StrFormat("scene of %d bytes in memory exceeds what this service keeps of scenes at all, %d",
                        bytes, quota_bytes_));
  }
  std::vector<Handle> forgotten;  // Destroyed after the lock is gone: that takes a while.
  const std::lock_guard lock(mutex_);
  size_t freed = 0;
  // Handles are only copied under the lock: who is alone with the store stays so.
  for (auto at = scenes_.end(); at != scenes_.begin() && *taken_ - freed + bytes > quota_bytes_;) {
    --at;
    if (at->use_count() > 1) continue;
    freed += (*at)->room.bytes();
    by_digest_.erase((*at)->digest);
    forgotten.push_back(std::move(*at));
    at = scenes_.erase(at);
  }
  if (*taken_ - freed + bytes > quota_bytes_) {
    return BusyError(
        absl::StrFormat("busy: scenes in use take %d bytes; with this one of %d they would exceed %d",
                        *taken_ - freed, bytes, quota_bytes_));
  }
  *taken_ += bytes;
  return Room(taken_, bytes);
}

SceneStore::Handle SceneStore::Insert(std::string digest, MaskScene scene, Room room) {
  auto stored = std::make_shared<StoredScene>();
  stored->digest = std::move(digest);
  stored->scene = std::move(scene);
  stored->room = std::move(room);
  const std::lock_guard lock(mutex_);
  const auto found = by_digest_.find(stored->digest);
  if (found != by_digest_.end()) return *found->second;
  scenes_.push_front(stored);
  by_digest_[stored->digest] = scenes_.begin();
  return stored;
}

bool SceneStore::Erase(const std::string& digest) {
  Handle forgotten;
  const std::lock_guard lock(mutex_);
  const auto found = by_digest_.find(digest);
  if (found == by_digest_.end()) return false;
  forgotten = std::move(*found->second);
  scenes_.erase(found->second);
  by_digest_.erase(found);
  return true;
}

std::vector<SceneStore::Entry> SceneStore::List() const {
  std::vector<Entry> entries;
  const std::lock_guard lock(mutex_);
  for (const Handle& scene : scenes_) {
    const int uses = static_cast<int>(scene.use_count()) - 1;  // Before this list makes one more.
    entries.push_back({scene, uses});
  }
  return entries;
}

absl::StatusOr<SceneStore::Handle> FindScene(SceneStore& scenes, const std::string& digest) {
  if (!IsSceneDigest(digest)) {
    return absl::InvalidArgumentError(absl::StrFormat(
        "scene_digest: %d characters, 64 lower-case hexadecimal digits expected", digest.size()));
  }
  SceneStore::Handle scene = scenes.Find(digest);
  if (scene != nullptr) return scene;
  return absl::NotFoundError(
      absl::StrFormat("scene_digest: no scene %s here; upload it and try again", digest));
}

}  // namespace shadowfit
