#pragma once

#include <cstddef>
#include <mutex>

#include "absl/status/statusor.h"

namespace shadowfit {

/// Bounds what the service has taken on: bytes of requests and number of jobs, waiting or worked on.
/// Thread-safe.
class Admission {
 public:
  /// Room for one job, given back when it goes.
  class Ticket {
   public:
    Ticket() = default;
    Ticket(Ticket&& other) noexcept;
    Ticket& operator=(Ticket&& other) noexcept;
    ~Ticket();

   private:
    friend class Admission;
    Ticket(Admission* admission, size_t bytes) : admission_(admission), bytes_(bytes) {}
    Admission* admission_ = nullptr;
    size_t bytes_ = 0;
  };

  Admission(size_t max_bytes, int max_jobs);

  /// Unavailable, with a google.rpc.RetryInfo payload, where there is no room now; ResourceExhausted where
  /// the request exceeds all the room there is.
  absl::StatusOr<Ticket> Admit(size_t bytes);

  size_t bytes() const;
  int jobs() const;

 private:
  const size_t max_bytes_;
  const int max_jobs_;
  mutable std::mutex mutex_;
  size_t bytes_ = 0;
  int jobs_ = 0;
};

}  // namespace shadowfit
