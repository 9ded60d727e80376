#include "server/worker_pool.h"

#include <gtest/gtest.h>
#include <tbb/parallel_for.h>

#include <atomic>
#include <chrono>
#include <future>
#include <thread>

namespace shadowfit {
namespace {

using namespace std::chrono_literals;

TEST(WorkerPool, RunsEveryJobAndNeverMoreThanItsWorkersAtATime) {
  std::atomic<int> running{0};
  std::atomic<int> most{0};
  std::atomic<int> ran{0};
  {
    WorkerPool pool(3);
    for (int i = 0; i < 60; ++i) {
      pool.Submit([&] {
        const int now = ++running;
        int seen = most;
        while (now > seen && !most.compare_exchange_weak(seen, now)) {
        }
        std::this_thread::sleep_for(1ms);
        --running;
        ++ran;
      });
    }
  }  // Waits.
  EXPECT_EQ(ran, 60);
  EXPECT_LE(most, 3);
}

// Two jobs that wait for each other can only end if both run at once, whatever the number of cores.
TEST(WorkerPool, HasAsManyThreadsAsItSays) {
  WorkerPool pool(4);
  std::atomic<int> arrived{0};
  std::promise<void> all;
  for (int i = 0; i < 4; ++i) {
    pool.Submit([&] {
      if (++arrived == 4) all.set_value();
      const auto until = std::chrono::steady_clock::now() + 20s;
      while (arrived < 4 && std::chrono::steady_clock::now() < until) std::this_thread::yield();
    });
  }
  EXPECT_EQ(all.get_future().wait_for(20s), std::future_status::ready);
}

TEST(WorkerPool, AJobThatWaitsForItsPartsStartsNoOtherJobMeanwhile) {
  WorkerPool pool(2);
  thread_local int depth = 0;
  std::atomic<int> deepest{0};
  std::atomic<int> left{40};
  std::promise<void> done;
  for (int i = 0; i < 40; ++i) {
    pool.Submit([&] {
      ++depth;
      if (depth > deepest) deepest = depth;
      tbb::parallel_for(0, 64, [](int) { std::this_thread::sleep_for(20us); });
      --depth;
      if (--left == 0) done.set_value();
    });
  }
  done.get_future().wait();
  EXPECT_EQ(deepest, 1);
}

TEST(WorkerPool, ReleasesWhatAJobOwnsBeforeItsDestructorReturns) {
  const auto owned = std::make_shared<int>(7);
  {
    WorkerPool pool(2);
    for (int i = 0; i < 20; ++i) pool.Submit([owned] { std::this_thread::sleep_for(100us); });
  }
  EXPECT_EQ(owned.use_count(), 1);
}

}  // namespace
}  // namespace shadowfit
