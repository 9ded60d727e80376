#pragma once

#include "server/idle_pool.h"
#include "server/resolution_worker.h"
#include "server/service_context.h"
#include "shadowfit/v1/resolution.grpc.pb.h"

namespace shadowfit {

class ResolutionServiceImpl final : public v1::ResolutionService::CallbackService {
 public:
  explicit ResolutionServiceImpl(ServiceContext& context) : context_(context) {}

  grpc::ServerUnaryReactor* EstimateResolution(grpc::CallbackServerContext* call,
                                               const v1::EstimateResolutionRequest* request,
                                               v1::EstimateResolutionResponse* response) override;
  grpc::ServerBidiReactor<v1::EstimateResolutionStreamRequest, v1::EstimateResolutionStreamResponse>*
  EstimateResolutionStream(grpc::CallbackServerContext* call) override;

 private:
  ServiceContext& context_;
  IdlePool<ResolutionWorker> workers_;  // Of unary calls; each stream has its own.
};

}  // namespace shadowfit
