#include "server/mask_service.h"

#include <memory>

#include "server/mask_worker.h"
#include "server/stream_reactor.h"
#include "server/unary_reactor.h"

namespace shadowfit {

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
  return StreamReactor<v1::RenderMasksStreamRequest, v1::RenderMasksStreamResponse>::Start(
      call, context_, "RenderMasksStream",
      [worker = std::make_shared<MaskWorker>(context_.scenes, context_.renderers)](
          const auto& request, const JobContext& job, auto* response) {
        return worker->Answer(request.has_frame() ? &request.frame() : nullptr, job,
                              response->mutable_result());
      });
}

}  // namespace shadowfit
