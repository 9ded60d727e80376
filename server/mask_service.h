#pragma once

#include "server/service_context.h"
#include "shadowfit/v1/mask.grpc.pb.h"

namespace shadowfit {

class MaskServiceImpl final : public v1::MaskService::CallbackService {
 public:
  explicit MaskServiceImpl(ServiceContext& context) : context_(context) {}

  grpc::ServerUnaryReactor* RenderMasks(grpc::CallbackServerContext* call,
                                        const v1::RenderMasksRequest* request,
                                        v1::RenderMasksResponse* response) override;
  grpc::ServerBidiReactor<v1::RenderMasksStreamRequest, v1::RenderMasksStreamResponse>* RenderMasksStream(
      grpc::CallbackServerContext* call) override;

 private:
  ServiceContext& context_;
};

}  // namespace shadowfit
