#pragma once

#include "server/service_context.h"
#include "shadowfit/v1/info.grpc.pb.h"

namespace shadowfit {

class InfoServiceImpl final : public v1::InfoService::CallbackService {
 public:
  explicit InfoServiceImpl(ServiceContext& context) : context_(context) {}

  grpc::ServerUnaryReactor* GetInfo(grpc::CallbackServerContext* call, const v1::GetInfoRequest* request,
                                    v1::GetInfoResponse* response) override;

 private:
  ServiceContext& context_;
};

}  // namespace shadowfit
