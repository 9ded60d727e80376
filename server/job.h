#pragma once

#include "core/cancellation.h"

namespace shadowfit {

/// What a job on a worker knows about the request that it answers.
struct JobContext {
  const Cancellation& cancellation;  ///< To be polled: the caller is gone, or its deadline past.
  double queue_seconds = 0.0;        ///< From the request's arrival to the start of work.
};

}  // namespace shadowfit
