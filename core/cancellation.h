#pragma once

#include <atomic>
#include <chrono>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"

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

/// Null: nobody ever asks.
inline bool IsCancelled(const Cancellation* cancellation) {
  return cancellation != nullptr && cancellation->Requested();
}

/// OK as long as `cancellation` (may be null) does not ask. Then Cancelled or DeadlineExceeded, with a
/// message that says during what.
inline absl::Status CancellationStatus(const Cancellation* cancellation, absl::string_view during) {
  if (!IsCancelled(cancellation)) return absl::OkStatus();
  if (cancellation->DeadlinePassed()) {
    return absl::DeadlineExceededError(absl::StrCat("the deadline passed during ", during));
  }
  return absl::CancelledError(absl::StrCat("the caller cancelled during ", during));
}

}  // namespace shadowfit
