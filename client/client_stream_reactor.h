#pragma once

#include <grpcpp/channel.h>
#include <grpcpp/client_context.h>
#include <grpcpp/support/client_callback.h>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "client/grpc_status.h"
#include "client/service_stream.h"

namespace shadowfit {

// Its destructor waits for OnDone, and gRPC has let go of it then. No reaction may keep it alive, or the stub
// or the context in it: with the last reference to a channel goes its completion queue, which waits for the
// threads that run reactions and would be freed on one of them while that is in it.
//
// One mutex guards all state; Start* calls are made under it, which is safe because gRPC never runs a
// reaction inside them.
//
// Traits: Request and Response of the stream, Frame in the one, Outcome for the caller, Service with the
// stub, and Call(), which makes the call.
template <typename Traits>
class ClientStreamReactor
    : public grpc::ClientBidiReactor<typename Traits::Request, typename Traits::Response> {
  using Request = typename Traits::Request;
  using Response = typename Traits::Response;
  using Frame = typename Traits::Frame;
  using Outcome = typename Traits::Outcome;
  using Clock = std::chrono::steady_clock;

 public:
  ClientStreamReactor(const std::shared_ptr<grpc::Channel>& channel, std::string name,
                      const FrameStreamOptions& options)
      : name_(std::move(name)),
        options_(options),
        stub_(Traits::Service::NewStub(channel)),
        slots_(std::max(1, options.max_in_flight)) {
    Traits::Call(*stub_, &context_, this);
    this->AddHold();  // Until the stream ends, so that Submit() may start writes from outside of reactions.
    this->StartRead(&response_);
    this->StartCall();
  }

  ~ClientStreamReactor() override { Cancel(); }

  Frame* Acquire() {
    const std::lock_guard lock(mutex_);
    for (Slot& slot : slots_) {
      if (slot.state != State::kFree || slot.writing) continue;
      slot.state = State::kAcquired;
      slot.request.Clear();
      return slot.request.mutable_frame();
    }
    return nullptr;
  }

  absl::Status Submit(Frame* frame) {
    const std::lock_guard lock(mutex_);
    Slot* slot = FindAcquired(frame);
    if (slot == nullptr) return absl::InvalidArgumentError("frame: not one that Acquire() returned");
    const uint64_t id = frame->frame_id();
    if (!status_.ok() || id <= last_id_) {
      slot->state = State::kFree;
      if (!status_.ok()) return status_;
      return absl::InvalidArgumentError(
          absl::StrCat("frame_id: ", id, " is not above that of the frame before, ", last_id_));
    }
    last_id_ = id;
    slot->state = State::kQueued;
    slot->submitted = Clock::now();
    slot->deadline = Clock::time_point::max();
    if (options_.frame_timeout.count() > 0) {
      slot->deadline = slot->submitted + options_.frame_timeout;
      slot->request.set_timeout_seconds(std::chrono::duration<double>(options_.frame_timeout).count());
    }
    queue_.push_back(slot);
    WriteNext();
    return absl::OkStatus();
  }

  void Discard(Frame* frame) {
    const std::lock_guard lock(mutex_);
    if (Slot* slot = FindAcquired(frame)) slot->state = State::kFree;
  }

  std::optional<Outcome> Wait(std::chrono::milliseconds timeout) {
    std::unique_lock lock(mutex_);
    const Clock::time_point until = Clock::now() + timeout;
    while (true) {
      const Clock::time_point next_deadline = FailOverdueFrames();
      if (!ready_.empty()) {
        Slot* slot = ready_.front();
        ready_.pop_front();
        slot->state = State::kFree;
        return std::exchange(slot->outcome, {});
      }
      if (CountInFlight() == 0 || Clock::now() >= until) return std::nullopt;
      changed_.wait_until(lock, std::min(until, next_deadline));
    }
  }

  int in_flight() const {
    const std::lock_guard lock(mutex_);
    return CountInFlight();
  }

  absl::Status status() const {
    const std::lock_guard lock(mutex_);
    return status_;
  }

  absl::Status Finish(std::chrono::milliseconds timeout) {
    std::unique_lock lock(mutex_);
    if (status_.ok()) status_ = absl::FailedPreconditionError("the stream was finished");
    closing_ = true;
    WriteNext();
    const Clock::time_point until = Clock::now() + timeout;
    while (!done_ && Clock::now() < until) {
      const Clock::time_point next_deadline = FailOverdueFrames();
      changed_.wait_until(lock, std::min(until, next_deadline));
    }
    if (!done_) {
      lock.unlock();
      Cancel();
      lock.lock();
      return absl::DeadlineExceededError(
          absl::StrCat(name_, ": the stream did not end within ", timeout.count(), " ms"));
    }
    return final_status_;
  }

  /// Returns when nothing is under way any more; the service has no say in that.
  void Cancel() {
    std::unique_lock lock(mutex_);
    if (!done_) {
      cancelled_ = true;
      if (status_.ok()) status_ = absl::CancelledError("the stream was cancelled");
      lock.unlock();  // TryCancel may run reactions.
      context_.TryCancel();
      lock.lock();
      changed_.wait(lock, [this] { return done_; });
    }
  }

  void OnReadDone(bool ok) override {
    const std::lock_guard lock(mutex_);
    if (!ok) {
      ended_ = true;
      if (status_.ok()) status_ = absl::UnavailableError(absl::StrCat(name_, ": the stream is ending"));
      this->RemoveHold();
      return;
    }
    if (response_.draining()) {
      closing_ = true;
      if (status_.ok()) {
        status_ =
            absl::UnavailableError(absl::StrCat(name_, ": the service is shutting down; open a new stream"));
      }
      WriteNext();
    } else if (Slot* slot = FindPending(response_.frame_id())) {
      switch (response_.outcome_case()) {
        case Response::kResult:
          Settle(*slot, std::move(*response_.mutable_result()));
          break;
        case Response::kError:
          Settle(*slot, StatusFromProto(response_.error(), name_));
          break;
        case Response::OUTCOME_NOT_SET:
          Settle(*slot, absl::InternalError(absl::StrCat(name_, ": an answer without an outcome")));
          break;
      }
    }  // Else the answer of a frame that has failed by its deadline already.
    this->StartRead(&response_);
  }

  void OnWriteDone(bool ok) override {
    const std::lock_guard lock(mutex_);
    writing_->writing = false;
    writing_ = nullptr;
    if (ok) WriteNext();  // Else the stream is ending, and OnDone will say why.
  }

  void OnDone(const grpc::Status& status) override {
    const std::lock_guard lock(mutex_);
    done_ = true;
    final_status_ = cancelled_ ? absl::CancelledError(absl::StrCat(name_, ": the stream was cancelled"))
                               : StatusFromGrpc(status, name_);
    absl::Status reason = final_status_;
    if (reason.ok()) {
      reason =
          absl::UnavailableError(absl::StrCat(name_, ": the service ended the stream before its answer"));
    }
    for (Slot& slot : slots_) {
      if (slot.state == State::kQueued || slot.state == State::kSent) Settle(slot, reason);
    }
    if (!closing_) status_ = reason;
    changed_.notify_all();
  }

 private:
  enum class State {
    kFree,
    kAcquired,  // The caller fills it.
    kQueued,    // Waits to be written.
    kSent,      // Was handed to gRPC; waits for its answer.
    kSettled,   // Its outcome waits in `ready_`.
  };

  struct Slot {
    State state = State::kFree;
    bool writing = false;  // gRPC still reads the message, even if the frame's fate is settled.
    Request request;
    Clock::time_point submitted;
    Clock::time_point deadline;
    Outcome outcome;
  };

  Slot* FindAcquired(const Frame* frame) {
    for (Slot& slot : slots_) {
      if (slot.state == State::kAcquired && &slot.request.frame() == frame) return &slot;
    }
    return nullptr;
  }

  Slot* FindPending(uint64_t frame_id) {
    for (Slot& slot : slots_) {
      if (slot.state == State::kSent && slot.request.frame().frame_id() == frame_id) return &slot;
    }
    return nullptr;
  }

  int CountInFlight() const {
    return static_cast<int>(std::count_if(slots_.begin(), slots_.end(), [](const Slot& slot) {
      return slot.state != State::kFree && slot.state != State::kAcquired;
    }));
  }

  void Settle(Slot& slot, decltype(Outcome::result) result) {
    slot.state = State::kSettled;
    slot.outcome.frame_id = slot.request.frame().frame_id();
    slot.outcome.result = std::move(result);
    slot.outcome.round_trip = Clock::now() - slot.submitted;
    ready_.push_back(&slot);
    changed_.notify_all();
  }

  // Returns when the next frame is due.
  Clock::time_point FailOverdueFrames() {
    const Clock::time_point now = Clock::now();
    Clock::time_point next = Clock::time_point::max();
    for (Slot& slot : slots_) {
      if (slot.state != State::kQueued && slot.state != State::kSent) continue;
      if (slot.deadline <= now) {
        if (slot.state == State::kQueued) queue_.erase(std::find(queue_.begin(), queue_.end(), &slot));
        Settle(slot, absl::DeadlineExceededError(
                         absl::StrCat(name_, ": frame ", slot.request.frame().frame_id(),
                                      " was not answered within ", options_.frame_timeout.count(), " ms")));
      } else {
        next = std::min(next, slot.deadline);
      }
    }
    return next;
  }

  // gRPC allows one write at a time.
  void WriteNext() {
    if (writing_ != nullptr || ended_ || half_closed_) return;
    if (!queue_.empty()) {
      writing_ = queue_.front();
      queue_.pop_front();
      writing_->writing = true;
      writing_->state = State::kSent;
      this->StartWrite(&writing_->request);
    } else if (closing_) {
      half_closed_ = true;
      this->StartWritesDone();
    }
  }

  const std::string name_;
  const FrameStreamOptions options_;
  const std::unique_ptr<typename Traits::Service::Stub> stub_;
  grpc::ClientContext context_;

  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<Slot> slots_;
  std::deque<Slot*> queue_;  // State::kQueued, in order.
  std::deque<Slot*> ready_;  // State::kSettled, in order.
  Slot* writing_ = nullptr;
  Response response_;
  uint64_t last_id_ = 0;  // Ids begin at 1: 0 is that of a frame without one.
  absl::Status status_;   // Why nothing can be submitted.
  absl::Status final_status_;
  bool closing_ = false;  // Half-close once the queue is empty.
  bool half_closed_ = false;
  bool cancelled_ = false;
  bool ended_ = false;  // Nothing more can be read or written.
  bool done_ = false;   // gRPC has let go of this object.
};

}  // namespace shadowfit
