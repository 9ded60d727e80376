#include "server/resolution_service.h"

#include <memory>

#include "server/stream_reactor.h"
#include "server/unary_reactor.h"

namespace shadowfit {

grpc::ServerUnaryReactor* ResolutionServiceImpl::EstimateResolution(
    grpc::CallbackServerContext* call, const v1::EstimateResolutionRequest* request,
    v1::EstimateResolutionResponse* response) {
  return UnaryReactor::Start(call, context_, "EstimateResolution", request->ByteSizeLong(),
                             [this, request, response](const JobContext& job) {
                               return workers_.Take()->Answer(
                                   request->has_frame() ? &request->frame() : nullptr, request->options(),
                                   job, response->mutable_result());
                             });
}

grpc::ServerBidiReactor<v1::EstimateResolutionStreamRequest, v1::EstimateResolutionStreamResponse>*
ResolutionServiceImpl::EstimateResolutionStream(grpc::CallbackServerContext* call) {
  return StreamReactor<v1::EstimateResolutionStreamRequest, v1::EstimateResolutionStreamResponse>::Start(
      call, context_, "EstimateResolutionStream",
      [worker = std::make_shared<ResolutionWorker>()](const auto& request, const JobContext& job,
                                                      auto* response) {
        return worker->Answer(request.has_frame() ? &request.frame() : nullptr, request.options(), job,
                              response->mutable_result());
      });
}

}  // namespace shadowfit
