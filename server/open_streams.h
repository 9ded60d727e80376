#pragma once

#include <chrono>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <set>

namespace shadowfit {

/// A stream that can be asked to end.
class DrainableStream {
 public:
  virtual ~DrainableStream() = default;
  /// Tells the client to send nothing more; what it has sent is still answered.
  virtual void Drain() = 0;
  /// Answers what was read and ends the stream.
  virtual void End() = 0;
};

/// The streams that are open, so that a server that is to go can end them in good order. Thread-safe.
class OpenStreams {
 public:
  void Add(const std::shared_ptr<DrainableStream>& stream);
  void Remove(const std::shared_ptr<DrainableStream>& stream);

  /// Drains the streams that are open and, from now on, those that open.
  void Drain();
  bool draining() const;
  /// Ends those that are open.
  void End();
  /// Whether none is open any more before `timeout`.
  bool WaitUntilNone(std::chrono::duration<double> timeout);
  int count() const;

 private:
  std::set<std::shared_ptr<DrainableStream>> Snapshot() const;

  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::set<std::shared_ptr<DrainableStream>> streams_;
  bool draining_ = false;
};

}  // namespace shadowfit
