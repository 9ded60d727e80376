#include "server/resolution_service.h"

#include <cmath>
#include <utility>

#include "absl/strings/str_format.h"
#include "server/errors.h"
#include "server/stream_reactor.h"
#include "server/unary_reactor.h"

namespace shadowfit {
namespace {

class EstimateResolutionStreamReactor final
    : public StreamReactor<v1::EstimateResolutionStreamRequest, v1::EstimateResolutionStreamResponse> {
 public:
  EstimateResolutionStreamReactor(grpc::CallbackServerContext* call, ServiceContext& context)
      : StreamReactor(call, context, "EstimateResolutionStream") {}

 private:
  absl::StatusOr<double> Timeout(const v1::EstimateResolutionStreamRequest& request) const override {
    const double seconds = request.timeout_seconds();
    if (std::isfinite(seconds) && seconds >= 0.0) return seconds;
    return WithFieldViolation(absl::InvalidArgumentError(absl::StrFormat(
                                  "timeout_seconds: %g is not a finite number >= 0", seconds)),
                              "");
  }

  absl::Status Answer(const v1::EstimateResolutionStreamRequest& request, const JobContext& job,
                      v1::EstimateResolutionStreamResponse* response) override {
    response->set_frame_id(request.frame().frame_id());
    return worker_.Answer(request.has_frame() ? &request.frame() : nullptr, request.options(), job,
                          response->mutable_result());
  }

  void Refuse(const v1::EstimateResolutionStreamRequest& request, const absl::Status& reason,
              v1::EstimateResolutionStreamResponse* response) override {
    response->set_frame_id(request.frame().frame_id());
    *response->mutable_error() = ProtoFromStatus(reason);
  }

  void MakeDrainNotice(v1::EstimateResolutionStreamResponse* response) override {
    response->set_draining(true);
  }

  ResolutionWorker worker_;
};

}  // namespace

grpc::ServerUnaryReactor* ResolutionServiceImpl::EstimateResolution(
    grpc::CallbackServerContext* call, const v1::EstimateResolutionRequest* request,
    v1::EstimateResolutionResponse* response) {
  return UnaryReactor::Start(call, context_, "EstimateResolution", request->ByteSizeLong(),
                             [this, request, response](const JobContext& job) {
                               std::unique_ptr<ResolutionWorker> worker = TakeWorker();
                               const absl::Status status =
                                   worker->Answer(request->has_frame() ? &request->frame() : nullptr,
                                                  request->options(), job, response->mutable_result());
                               GiveBackWorker(std::move(worker));
                               return status;
                             });
}

grpc::ServerBidiReactor<v1::EstimateResolutionStreamRequest, v1::EstimateResolutionStreamResponse>*
ResolutionServiceImpl::EstimateResolutionStream(grpc::CallbackServerContext* call) {
  return EstimateResolutionStreamReactor::Start<EstimateResolutionStreamReactor>(call, context_);
}

std::unique_ptr<ResolutionWorker> ResolutionServiceImpl::TakeWorker() {
  const std::lock_guard lock(mutex_);
  if (idle_workers_.empty()) return std::make_unique<ResolutionWorker>();
  std::unique_ptr<ResolutionWorker> worker = std::move(idle_workers_.back());
  idle_workers_.pop_back();
  return worker;
}

void ResolutionServiceImpl::GiveBackWorker(std::unique_ptr<ResolutionWorker> worker) {
  const std::lock_guard lock(mutex_);
  idle_workers_.push_back(std::move(worker));
}

}  // namespace shadowfit
