#include "server/request_deadline.h"

#include <chrono>

#include "absl/strings/str_cat.h"

namespace shadowfit {

Cancellation::Clock::time_point DeadlineAfter(Cancellation::Clock::time_point start, double seconds) {
  constexpr double kForever = 1e8;  // Three years; far below where a time_point would overflow.
  if (!(seconds > 0.0) || seconds > kForever) return Cancellation::Clock::time_point::max();
  return start +
         std::chrono::duration_cast<Cancellation::Clock::duration>(std::chrono::duration<double>(seconds));
}

Cancellation::Clock::time_point CallDeadline(const grpc::ServerContextBase& context) {
  const auto now = Cancellation::Clock::now();
  const double remaining =
      std::chrono::duration<double>(context.deadline() - std::chrono::system_clock::now()).count();
  return remaining <= 0.0 ? now : DeadlineAfter(now, remaining);
}

absl::Status CheckStillWanted(const Cancellation& cancellation, double queue_seconds) {
  // The message is made only where it is needed: this is asked for every frame.
  if (!cancellation.Requested()) return absl::OkStatus();
  return CancellationStatus(&cancellation, absl::StrCat(queue_seconds, " s in the queue"));
}

}  // namespace shadowfit
