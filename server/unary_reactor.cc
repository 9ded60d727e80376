#include "server/unary_reactor.h"

#include <chrono>
#include <exception>
#include <utility>

#include "server/errors.h"
#include "server/request_deadline.h"

namespace shadowfit {

grpc::ServerUnaryReactor* UnaryReactor::Start(grpc::CallbackServerContext* call, ServiceContext& context,
                                              std::string method, size_t bytes, Work work) {
  auto reactor = std::make_shared<UnaryReactor>(call, context, std::move(method), std::move(work));
  reactor->self_ = reactor;
  context.metrics.CountReceivedBytes(reactor->method_, bytes);
  absl::StatusOr<Admission::Ticket> ticket = context.admission.Admit(bytes);
  if (!ticket.ok()) {
    reactor->FinishWith(ticket.status());
    return reactor.get();
  }
  reactor->ticket_ = *std::move(ticket);
  context.pool.Submit([reactor] { reactor->Run(); });
  return reactor.get();
}

UnaryReactor::UnaryReactor(grpc::CallbackServerContext* call, ServiceContext& context, std::string method,
                           Work work)
    : context_(context),
      method_(std::move(method)),
      cancellation_(CallDeadline(*call)),
      work_(std::move(work)) {}

void UnaryReactor::OnDone() { const auto keep = std::move(self_); }

void UnaryReactor::Run() {
  const auto start = Cancellation::Clock::now();
  const double queue_seconds = std::chrono::duration<double>(start - arrival_).count();
  const absl::Status status = RunWork(queue_seconds);
  context_.metrics.ObserveWork(method_, queue_seconds,
                               std::chrono::duration<double>(Cancellation::Clock::now() - start).count());
  ticket_ = {};
  FinishWith(status);
}

absl::Status UnaryReactor::RunWork(double queue_seconds) {
  if (absl::Status status = CheckStillWanted(cancellation_, queue_seconds); !status.ok()) return status;
  try {
    return work_({cancellation_, queue_seconds});
  } catch (const std::exception& error) {  // Out of memory, from a library: this request's misfortune alone.
    return absl::InternalError(error.what());
  }
}

void UnaryReactor::FinishWith(const absl::Status& status) {
  context_.metrics.CountAnswer(method_, status.code());
  Finish(GrpcFromStatus(status));
}

}  // namespace shadowfit
