#include "server/admission.h"

#include <utility>

#include "absl/strings/str_format.h"
#include "server/errors.h"

namespace shadowfit {
Admission::Ticket::Ticket(Ticket&& other) noexcept
    : admission_(std::exchange(other.admission_, nullptr)), bytes_(other.bytes_) {}

Admission::Ticket& Admission::Ticket::operator=(Ticket&& other) noexcept {
  std::swap(admission_, other.admission_);
  std::swap(bytes_, other.bytes_);
  return *this;
}

Admission::Ticket::~Ticket() {
  if (admission_ == nullptr) return;
  const std::lock_guard lock(admission_->mutex_);
  admission_->bytes_ -= bytes_;
  --admission_->jobs_;
}

Admission::Admission(size_t max_bytes, int max_jobs) : max_bytes_(max_bytes), max_jobs_(max_jobs) {}

absl::StatusOr<Admission::Ticket> Admission::Admit(size_t bytes) {
  if (bytes > max_bytes_) {
    return absl::ResourceExhaustedError(absl::StrFormat(
        "request of %d bytes exceeds what this service admits at all, %d", bytes, max_bytes_));
  }
  const std::lock_guard lock(mutex_);
  if (jobs_ >= max_jobs_)
    return BusyError(absl::StrFormat("busy: %d requests are under way, the most allowed", jobs_));
  if (bytes_ + bytes > max_bytes_) {
    return BusyError(
        absl::StrFormat("busy: requests of %d bytes are under way; with this one of %d they would exceed %d",
                        bytes_, bytes, max_bytes_));
  }
  bytes_ += bytes;
  ++jobs_;
  return Ticket(this, bytes);
}

size_t Admission::bytes() const {
  const std::lock_guard lock(mutex_);
  return bytes_;
}

int Admission::jobs() const {
  const std::lock_guard lock(mutex_);
  return jobs_;
}

}  // namespace shadowfit
