#include "server/optimizer_service.h"

#include <cmath>
#include <utility>

#include "absl/strings/str_format.h"
#include "server/errors.h"
#include "server/stream_reactor.h"
#include "server/unary_reactor.h"

namespace shadowfit {
namespace {

class OptimizeStreamReactor final
    : public StreamReactor<v1::OptimizeStreamRequest, v1::OptimizeStreamResponse> {
 public:
  OptimizeStreamReactor(grpc::CallbackServerContext* call, ServiceContext& context)
      : StreamReactor(call, context, "OptimizeStream"),
        worker_(FrameWorker::Memory::kLastFrame, context.scenes, context.renderers) {}

 private:
  absl::StatusOr<double> Timeout(const v1::OptimizeStreamRequest& request) const override {
    const double seconds = request.timeout_seconds();
    if (std::isfinite(seconds) && seconds >= 0.0) return seconds;
    return WithFieldViolation(absl::InvalidArgumentError(absl::StrFormat(
                                  "timeout_seconds: %g is not a finite number >= 0", seconds)),
                              "");
  }

  absl::Status Answer(const v1::OptimizeStreamRequest& request, const JobContext& job,
                      v1::OptimizeStreamResponse* response) override {
    response->set_frame_id(request.frame().frame_id());
    return worker_.Answer(request.has_frame() ? &request.frame() : nullptr, job, response->mutable_result());
  }

  void Refuse(const v1::OptimizeStreamRequest& request, const absl::Status& reason,
              v1::OptimizeStreamResponse* response) override {
    response->set_frame_id(request.frame().frame_id());
    *response->mutable_error() = ProtoFromStatus(reason);
  }

  void MakeDrainNotice(v1::OptimizeStreamResponse* response) override { response->set_draining(true); }

  FrameWorker worker_;
};

}  // namespace

grpc::ServerUnaryReactor* OptimizerServiceImpl::Optimize(grpc::CallbackServerContext* call,
                                                         const v1::OptimizeRequest* request,
                                                         v1::OptimizeResponse* response) {
  return UnaryReactor::Start(
      call, context_, "Optimize", request->ByteSizeLong(), [this, request, response](const JobContext& job) {
        std::unique_ptr<FrameWorker> worker = TakeWorker();
        const absl::Status status = worker->Answer(request->has_frame() ? &request->frame() : nullptr, job,
                                                   response->mutable_result());
        GiveBackWorker(std::move(worker));
        return status;
      });
}

grpc::ServerBidiReactor<v1::OptimizeStreamRequest, v1::OptimizeStreamResponse>*
OptimizerServiceImpl::OptimizeStream(grpc::CallbackServerContext* call) {
  return OptimizeStreamReactor::Start<OptimizeStreamReactor>(call, context_);
}

std::unique_ptr<FrameWorker> OptimizerServiceImpl::TakeWorker() {
  const std::lock_guard lock(mutex_);
  if (idle_workers_.empty())
    return std::make_unique<FrameWorker>(FrameWorker::Memory::kNone, context_.scenes, context_.renderers);
  std::unique_ptr<FrameWorker> worker = std::move(idle_workers_.back());
  idle_workers_.pop_back();
  return worker;
}

void OptimizerServiceImpl::GiveBackWorker(std::unique_ptr<FrameWorker> worker) {
  const std::lock_guard lock(mutex_);
  idle_workers_.push_back(std::move(worker));
}

}  // namespace shadowfit
