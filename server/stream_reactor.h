#pragma once

#include <grpcpp/server_context.h>
#include <grpcpp/support/server_callback.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <exception>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/cancellation.h"
#include "server/errors.h"
#include "server/job.h"
#include "server/request_deadline.h"
#include "server/service_context.h"

namespace shadowfit {

/// A bidirectional stream whose requests are computed on the worker pool, one at a time in the order of their
/// arrival, while the next ones are received. Each message read gets exactly one answer.
///
/// Request has `frame`, with its `frame_id`, and `timeout_seconds`, the client's own limit for this message,
/// 0 for none. Response has `frame_id` and one of `result`, `error` and `draining`, which asks the client to
/// end the stream.
///
/// The stream owns a few slots, each a request and its response, and uses their memory over and over. A slot
/// goes round:
///
///     free -> read -> waiting -> computed -> waiting to be written -> written -> free
///
/// No slot free, no read: a client that sends faster than the service computes is held back by flow control.
/// gRPC allows one read and one write at a time; `reading_` and `writing_` say which slot they use. One mutex
/// guards all; Start* and Finish are called under it, which is safe because gRPC never runs a reaction inside
/// them.
///
/// The object keeps itself alive until gRPC is done with it, and jobs keep it alive too.
template <typename Request, typename Response>
class StreamReactor final : public grpc::ServerBidiReactor<Request, Response>,
                            public DrainableStream,
                            public std::enable_shared_from_this<StreamReactor<Request, Response>> {
 public:
  /// Computes an answer's result, on a worker thread, one at a time. The response may hold an earlier one.
  using Work = std::function<absl::Status(const Request&, const JobContext&, Response*)>;

  /// The pointer is for gRPC.
  static grpc::ServerBidiReactor<Request, Response>* Start(grpc::CallbackServerContext* call,
                                                           ServiceContext& context, std::string method,
                                                           Work work) {
    auto reactor = std::make_shared<StreamReactor>(call, context, std::move(method), std::move(work));
    reactor->StartReading();
    return reactor.get();
  }

  StreamReactor(grpc::CallbackServerContext* call, ServiceContext& context, std::string method, Work work)
      : context_(context),
        method_(std::move(method)),
        call_deadline_(CallDeadline(*call)),
        work_(std::move(work)),
        slots_(static_cast<size_t>(std::max(1, context.options.max_frames_in_stream))) {}

  void OnReadDone(bool ok) final {
    const auto keep = this->shared_from_this();
    const std::lock_guard lock(mutex_);
    Slot* slot = std::exchange(reading_, nullptr);
    if (!ok || closed_) {
      half_closed_ = true;
      free_.push_back(slot);
      FinishIfIdle();
      return;
    }
    Receive(slot);
    ReadNext();
  }

  void OnWriteDone(bool ok) final {
    const auto keep = this->shared_from_this();
    const std::lock_guard lock(mutex_);
    if (Slot* slot = std::exchange(writing_, nullptr)) free_.push_back(slot);
    writing_notice_ = false;
    if (!ok) Abandon();
    WriteNext();
    ReadNext();
    FinishIfIdle();
  }

  void OnCancel() final {
    const auto keep = this->shared_from_this();
    const std::lock_guard lock(mutex_);
    Abandon();
    FinishIfIdle();
  }

  void OnDone() final {
    const auto keep = std::move(self_);
    context_.streams.Remove(keep);
  }

  void Drain() final {
    const auto keep = this->shared_from_this();
    const std::lock_guard lock(mutex_);
    if (closed_ || half_closed_) return;
    notice_due_ = true;
    WriteNext();
  }

  void End() final {
    const auto keep = this->shared_from_this();
    const std::lock_guard lock(mutex_);
    if (closed_) return;
    closed_ = true;
    closing_status_ = absl::UnavailableError("the service is shutting down");
    FinishIfIdle();
  }

 private:
  using Clock = Cancellation::Clock;

  struct Slot {
    Request request;
    Response response;
    std::optional<Cancellation> cancellation;
    Admission::Ticket ticket;
    Clock::time_point arrival;
  };

  void StartReading() {
    self_ = this->shared_from_this();
    for (Slot& slot : slots_) free_.push_back(&slot);
    {
      const std::lock_guard lock(mutex_);
      if (const int open = context_.streams.count(); open >= context_.options.max_streams) {
        closed_ = true;
        closing_status_ = BusyError(absl::StrCat("busy: ", open, " streams are open, the most allowed"));
        FinishIfIdle();
        return;
      }
      ReadNext();
    }
    context_.streams.Add(self_);
  }

  void ReadNext() {
    if (reading_ != nullptr || half_closed_ || closed_ || free_.empty()) return;
    reading_ = free_.back();
    free_.pop_back();
    this->StartRead(&reading_->request);
  }

  void Receive(Slot* slot) {
    slot->arrival = Clock::now();
    const size_t bytes = slot->request.ByteSizeLong();
    context_.metrics.CountReceivedBytes(method_, bytes);
    const absl::StatusOr<double> timeout = Timeout(slot->request);
    absl::StatusOr<Admission::Ticket> ticket =
        timeout.ok() ? context_.admission.Admit(bytes) : absl::StatusOr<Admission::Ticket>(timeout.status());
    if (!ticket.ok()) {
      RefuseSlot(slot, ticket.status());
      WriteNext();
      return;
    }
    slot->ticket = *std::move(ticket);
    slot->cancellation.emplace(std::min(call_deadline_, DeadlineAfter(slot->arrival, *timeout)));
    waiting_.push_back(slot);
    ComputeNext();
  }

  static absl::StatusOr<double> Timeout(const Request& request) {
    const double seconds = request.timeout_seconds();
    if (std::isfinite(seconds) && seconds >= 0.0) return seconds;
    return WithFieldViolation(absl::InvalidArgumentError(absl::StrFormat(
                                  "timeout_seconds: %g is not a finite number >= 0", seconds)),
                              "");
  }

  void ComputeNext() {
    if (computing_ != nullptr || waiting_.empty()) return;
    computing_ = waiting_.front();
    waiting_.pop_front();
    context_.pool.Submit([keep = this->shared_from_this()] { keep->Compute(); });
  }

  void Compute() {
    Slot* slot = computing_;  // Ours alone until it is given back below.
    const Clock::time_point start = Clock::now();
    const double queue_seconds = std::chrono::duration<double>(start - slot->arrival).count();
    const absl::Status status = ComputeAnswer(*slot, queue_seconds);
    context_.metrics.ObserveWork(method_, queue_seconds,
                                 std::chrono::duration<double>(Clock::now() - start).count());
    const std::lock_guard lock(mutex_);
    computing_ = nullptr;
    slot->ticket = {};
    if (abandoned_) {
      free_.push_back(slot);
    } else if (status.ok()) {
      context_.metrics.CountAnswer(method_, absl::StatusCode::kOk);
      answered_.push_back(slot);
    } else {
      RefuseSlot(slot, status);
    }
    WriteNext();
    ComputeNext();
    FinishIfIdle();
  }

  absl::Status ComputeAnswer(Slot& slot, double queue_seconds) {
    if (absl::Status status = CheckStillWanted(*slot.cancellation, queue_seconds); !status.ok())
      return status;
    try {
      slot.response.set_frame_id(slot.request.frame().frame_id());
      return work_(slot.request, {*slot.cancellation, queue_seconds}, &slot.response);
    } catch (
        const std::exception& error) {  // Out of memory, from a library: this request's misfortune alone.
      return absl::InternalError(error.what());
    }
  }

  void RefuseSlot(Slot* slot, const absl::Status& reason) {
    context_.metrics.CountAnswer(method_, reason.code());
    slot->response.set_frame_id(slot->request.frame().frame_id());
    *slot->response.mutable_error() = ProtoFromStatus(reason);
    answered_.push_back(slot);
  }

  void WriteNext() {
    if (writing_ != nullptr || writing_notice_ || finished_) return;
    if (!answered_.empty()) {
      writing_ = answered_.front();
      answered_.pop_front();
      this->StartWrite(&writing_->response);
    } else if (std::exchange(notice_due_, false)) {
      writing_notice_ = true;
      notice_.set_draining(true);
      this->StartWrite(&notice_);
    }
  }

  /// The client is gone: nothing more is computed or written.
  void Abandon() {
    abandoned_ = true;
    closed_ = true;
    closing_status_ = absl::CancelledError("the caller ended the stream");
    if (computing_ != nullptr) computing_->cancellation->Cancel();
    for (std::deque<Slot*>* queue : {&waiting_, &answered_}) {
      for (Slot* slot : *queue) {
        slot->ticket = {};
        free_.push_back(slot);
      }
      queue->clear();
    }
    notice_due_ = false;
  }

  void FinishIfIdle() {
    if (finished_ || !(half_closed_ || closed_)) return;
    if (computing_ != nullptr || writing_ != nullptr || writing_notice_ || !waiting_.empty() ||
        !answered_.empty())
      return;
    finished_ = true;
    this->Finish(GrpcFromStatus(closing_status_));
  }

  ServiceContext& context_;
  const std::string method_;
  const Clock::time_point call_deadline_;
  const Work work_;
  std::shared_ptr<StreamReactor> self_;

  std::mutex mutex_;
  std::vector<Slot> slots_;
  std::vector<Slot*> free_;
  Slot* reading_ = nullptr;
  std::deque<Slot*> waiting_;
  Slot* computing_ = nullptr;
  std::deque<Slot*> answered_;
  Slot* writing_ = nullptr;

  Response notice_;
  bool notice_due_ = false;
  bool writing_notice_ = false;

  bool half_closed_ = false;  // The client sends nothing more.
  bool closed_ = false;       // We read nothing more.
  bool abandoned_ = false;    // Nobody waits for answers.
  bool finished_ = false;
  absl::Status closing_status_;
};

}  // namespace shadowfit
