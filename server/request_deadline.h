#pragma once

#include <grpcpp/server_context.h>

#include "absl/status/status.h"
#include "core/cancellation.h"

namespace shadowfit {

/// The call's deadline on the clock that does not jump; `Clock::time_point::max()` where it has none.
Cancellation::Clock::time_point CallDeadline(const grpc::ServerContextBase& context);

/// `seconds` from `start`, or max() where it is 0 or longer than any call lasts.
Cancellation::Clock::time_point DeadlineAfter(Cancellation::Clock::time_point start, double seconds);

/// Whether anybody still waits for work that is about to begin: CancellationStatus(), of the queue.
absl::Status CheckStillWanted(const Cancellation& cancellation, double queue_seconds);

}  // namespace shadowfit
