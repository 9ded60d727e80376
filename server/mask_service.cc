#include "server/mask_service.h"

#include <cmath>

#include "absl/strings/str_format.h"
#include "server/errors.h"
#include "server/mask_worker.h"
#include "server/stream_reactor.h"
#include "server/unary_reactor.h"

namespace shadowfit {
namespace {

class MaskStreamReactor final
    : public StreamReactor<v1::RenderMasksStreamRequest, v1::RenderMasksStreamResponse> {
 public:
  MaskStreamReactor(grpc::CallbackServerContext* call, ServiceContext& context)
      : StreamReactor(call, context, "RenderMasksStream"), worker_(context.scenes, context.renderers) {}

 private:
  absl::StatusOr<double> Timeout(const v1::RenderMasksStreamRequest& request) const override {
    const double seconds = request.timeout_seconds();
    if (std::isfinite(seconds) && seconds >= 0.0) return seconds;
    return WithFieldViolation(absl::InvalidArgumentError(absl::StrFormat(
                                  "timeout_seconds: %g is not a finite number >= 0", seconds)),
                              "");
  }

  absl::Status Answer(const v1::RenderMasksStreamRequest& request, const JobContext& job,
                      v1::RenderMasksStreamResponse* response) override {
    response->set_frame_id(request.frame().frame_id());
    return worker_.Answer(request.has_frame() ? &request.frame() : nullptr, job, response->mutable_result());
  }

  void Refuse(const v1::RenderMasksStreamRequest& request, const absl::Status& reason,
              v1::RenderMasksStreamResponse* response) override {
    response->set_frame_id(request.frame().frame_id());
    *response->mutable_error() = ProtoFromStatus(reason);
  }

  void MakeDrainNotice(v1::RenderMasksStreamResponse* response) override { response->set_draining(true); }

  MaskWorker worker_;
};

}  // namespace

grpc::ServerUnaryReactor* MaskServiceImpl::RenderMasks(grpc::CallbackServerContext* call,
                                                       const v1::RenderMasksRequest* request,
                                                       v1::RenderMasksResponse* response) {
  return UnaryReactor::Start(call, context_, "RenderMasks", request->ByteSizeLong(),
                             [this, request, response](const JobContext& job) {
                               MaskWorker worker(context_.scenes, context_.renderers);
                               return worker.Answer(request->has_frame() ? &request->frame() : nullptr, job,
                                                    response->mutable_result());
                             });
}

grpc::ServerBidiReactor<v1::RenderMasksStreamRequest, v1::RenderMasksStreamResponse>*
MaskServiceImpl::RenderMasksStream(grpc::CallbackServerContext* call) {
  return MaskStreamReactor::Start<MaskStreamReactor>(call, context_);
}

}  // namespace shadowfit
