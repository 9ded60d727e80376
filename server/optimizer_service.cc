#include "server/optimizer_service.h"

#include <memory>

#include "server/stream_reactor.h"
#include "server/unary_reactor.h"

namespace shadowfit {

grpc::ServerUnaryReactor* OptimizerServiceImpl::Optimize(grpc::CallbackServerContext* call,
                                                         const v1::OptimizeRequest* request,
                                                         v1::OptimizeResponse* response) {
  return UnaryReactor::Start(
      call, context_, "Optimize", request->ByteSizeLong(), [this, request, response](const JobContext& job) {
        const auto worker = workers_.Take(FrameWorker::Memory::kNone, context_.scenes, context_.renderers);
        return worker->Answer(request->has_frame() ? &request->frame() : nullptr, job,
                              response->mutable_result());
      });
}

grpc::ServerBidiReactor<v1::OptimizeStreamRequest, v1::OptimizeStreamResponse>*
OptimizerServiceImpl::OptimizeStream(grpc::CallbackServerContext* call) {
  return StreamReactor<v1::OptimizeStreamRequest, v1::OptimizeStreamResponse>::Start(
      call, context_, "OptimizeStream",
      [worker = std::make_shared<FrameWorker>(FrameWorker::Memory::kLastFrame, context_.scenes,
                                              context_.renderers)](const auto& request, const JobContext& job,
                                                                   auto* response) {
        return worker->Answer(request.has_frame() ? &request.frame() : nullptr, job,
                              response->mutable_result());
      });
}

}  // namespace shadowfit
