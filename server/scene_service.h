#pragma once

#include "server/service_context.h"
#include "shadowfit/v1/scene.grpc.pb.h"

namespace shadowfit {

/// Takes scenes in and lists them; the store is ServiceContext's.
class SceneServiceImpl final : public v1::SceneService::CallbackService {
 public:
  explicit SceneServiceImpl(ServiceContext& context) : context_(context) {}

  grpc::ServerUnaryReactor* FindMissingScenes(grpc::CallbackServerContext* call,
                                              const v1::FindMissingScenesRequest* request,
                                              v1::FindMissingScenesResponse* response) override;
  grpc::ServerReadReactor<v1::UploadSceneRequest>* UploadScene(grpc::CallbackServerContext* call,
                                                               v1::UploadSceneResponse* response) override;
  grpc::ServerUnaryReactor* ListScenes(grpc::CallbackServerContext* call,
                                       const v1::ListScenesRequest* request,
                                       v1::ListScenesResponse* response) override;
  grpc::ServerUnaryReactor* DeleteScene(grpc::CallbackServerContext* call,
                                        const v1::DeleteSceneRequest* request,
                                        v1::DeleteSceneResponse* response) override;

 private:
  ServiceContext& context_;
};

}  // namespace shadowfit
