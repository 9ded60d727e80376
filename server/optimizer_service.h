#pragma once

#include <memory>
#include <mutex>
#include <vector>

#include "server/frame_worker.h"
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
  // Unary calls share workers, so that they too find their memory warm: never more than run at a time.
  std::unique_ptr<FrameWorker> TakeWorker();
  void GiveBackWorker(std::unique_ptr<FrameWorker> worker);

  ServiceContext& context_;
  std::mutex mutex_;
  std::vector<std::unique_ptr<FrameWorker>> idle_workers_;
};

}  // namespace shadowfit
