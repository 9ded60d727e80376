#pragma once

#include <atomic>
#include <chrono>

namespace shadowfit {

/// Asked inside long computations: has the caller gone, or is its deadline past? Set from any thread.
class Cancellation {
 public:
  using Clock = std::chrono::steady_clock;

  Cancellation() = default;
  explicit Cancellation(Clock::time_point deadline) : deadline_(deadline) {}

  void Cancel() { cancelled_.store(true, std::memory_order_relaxed); }

  bool Requested() const { return cancelled_.load(std::memory_order_relaxed) || DeadlinePassed(); }
  bool DeadlinePassed() const { return deadline_ != Clock::time_point::max() && Clock::now() >= deadline_; }

 private:
  std::atomic<bool> cancelled_{false};
  Clock::time_point deadline_ = Clock::time_point::max();
};

}  // namespace shadowfit
