#include "server/worker_pool.h"

#include <algorithm>
#include <memory>
#include <thread>
#include <utility>

namespace shadowfit {
namespace {

int WorkerCount(int wanted) {
  return wanted > 0 ? wanted : static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
}

}  // namespace

// oneTBB counts on the main thread to take part and so starts one thread less than there are cores; here
// nobody waits, and the arena needs threads of its own.
WorkerPool::WorkerPool(int workers)
    : workers_(WorkerCount(workers)),
      parallelism_(tbb::global_control::max_allowed_parallelism, static_cast<size_t>(workers_) + 1),
      arena_(workers_, /*reserved_for_masters=*/0) {}

WorkerPool::~WorkerPool() {
  std::unique_lock lock(mutex_);
  idle_.wait(lock, [this] { return unfinished_ == 0; });
}

void WorkerPool::Submit(std::function<void()> job) {
  {
    const std::lock_guard lock(mutex_);
    ++unfinished_;
  }
  arena_.enqueue([this, shared_job = std::make_shared<std::function<void()>>(std::move(job))] {
    // Isolated: a thread that waits inside one job for its parallel parts must not start another job
    // meanwhile.
    tbb::this_task_arena::isolate(*shared_job);
    *shared_job = nullptr;  // Before the pool may go: the job may own what needs the pool's owner.
    const std::lock_guard lock(mutex_);
    if (--unfinished_ == 0) idle_.notify_all();
  });
}

}  // namespace shadowfit
