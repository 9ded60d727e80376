#pragma once

#include <memory>
#include <mutex>
#include <vector>

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
  // Unary calls share workers, as those of the optimizer do.
  std::unique_ptr<ResolutionWorker> TakeWorker();
  void GiveBackWorker(std::unique_ptr<ResolutionWorker> worker);

  ServiceContext& context_;
  std::mutex mutex_;
  std::vector<std::unique_ptr<ResolutionWorker>> idle_workers_;
};

}  // namespace shadowfit
