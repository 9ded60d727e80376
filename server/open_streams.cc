#include "server/open_streams.h"

namespace shadowfit {

void OpenStreams::Add(const std::shared_ptr<DrainableStream>& stream) {
  bool draining = false;
  {
    const std::lock_guard lock(mutex_);
    streams_.insert(stream);
    draining = draining_;
  }
  if (draining) stream->Drain();
}

void OpenStreams::Remove(const std::shared_ptr<DrainableStream>& stream) {
  const std::lock_guard lock(mutex_);
  streams_.erase(stream);
  changed_.notify_all();
}

void OpenStreams::Drain() {
  {
    const std::lock_guard lock(mutex_);
    draining_ = true;
  }
  for (const auto& stream : Snapshot()) stream->Drain();
}

bool OpenStreams::draining() const {
  const std::lock_guard lock(mutex_);
  return draining_;
}

void OpenStreams::End() {
  for (const auto& stream : Snapshot()) stream->End();
}

bool OpenStreams::WaitUntilNone(std::chrono::duration<double> timeout) {
  std::unique_lock lock(mutex_);
  return changed_.wait_for(lock, timeout, [this] { return streams_.empty(); });
}

int OpenStreams::count() const {
  const std::lock_guard lock(mutex_);
  return static_cast<int>(streams_.size());
}

// Streams take their own locks, and leave this set while holding none: called on a copy, no order of locks
// can deadlock.
std::set<std::shared_ptr<DrainableStream>> OpenStreams::Snapshot() const {
  const std::lock_guard lock(mutex_);
  return streams_;
}

}  // namespace shadowfit
