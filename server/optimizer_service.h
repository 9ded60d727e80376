#pragma once

#include "server/frame_worker.h"
#include "server/idle_pool.h"
#include "server/service_context.h"
#include "shadowfit/v1/optimizer.grpc.pb.h"

namespace shadowfit {

class OptimizerServiceImpl final : public v1::OptimizerService::CallbackService {
 public:
  explicit OptimizerServiceImpl(ServiceContext& context) : context_(context) {}

  grpc::ServerUnaryReactor* Optimize(grpc::CallbackServerContext* call, const v1::OptimizeRequest* request,
                                     v1::OptimizeResponse* response) override;
  grpc::ServerBidiReactor<v1::OptimizeStreamRequest, v1::OptimizeStreamResponse>* OptimizeStream(
      grpc::CallbackServerContext* call) override;

 private:
  ServiceContext& context_;
  IdlePool<FrameWorker> workers_;  // Of unary calls; each stream has its own.
};

}  // namespace shadowfit
