#pragma once

#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <condition_variable>
#include <functional>
#include <mutex>

namespace shadowfit {

/// The threads that compute. gRPC's own threads only move messages: were they to compute, a health check
/// would wait behind every frame.
class WorkerPool {
 public:
  /// `workers` jobs at a time; 0: one for each core.
  explicit WorkerPool(int workers);
  /// Waits for all jobs.
  ~WorkerPool();
  WorkerPool(const WorkerPool&) = delete;
  WorkerPool& operator=(const WorkerPool&) = delete;

  /// Never blocks; jobs start roughly in the order of submission. How many may wait is Admission's business.
  /// A job may use oneTBB itself: it then shares these threads.
  void Submit(std::function<void()> job);

  int workers() const { return workers_; }

 private:
  const int workers_;
  tbb::global_control parallelism_;
  tbb::task_arena arena_;
  std::mutex mutex_;
  std::condition_variable idle_;
  int unfinished_ = 0;
};

}  // namespace shadowfit
