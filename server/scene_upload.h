#pragma once

#include <grpcpp/server_context.h>
#include <grpcpp/support/server_callback.h>

#include <memory>
#include <mutex>
#include <string>

#include "absl/status/status.h"
#include "core/cancellation.h"
#include "server/service_context.h"
#include "shadowfit/v1/scene.pb.h"

namespace shadowfit {

/// One upload: gathers the chunks, and verifies and stores the scene on a worker once the client has sent
/// all. Keeps itself alive until gRPC is done with it.
class SceneUpload final : public grpc::ServerReadReactor<v1::UploadSceneRequest>,
                          public std::enable_shared_from_this<SceneUpload> {
 public:
  /// The pointer is for gRPC.
  static grpc::ServerReadReactor<v1::UploadSceneRequest>* Start(grpc::CallbackServerContext* call,
                                                                ServiceContext& context,
                                                                v1::UploadSceneResponse* response);

  SceneUpload(grpc::CallbackServerContext* call, ServiceContext& context, v1::UploadSceneResponse* response);

  void OnReadDone(bool ok) override;
  void OnCancel() override { cancellation_.Cancel(); }
  void OnDone() override;

 private:
  /// Takes the message that was read. Not OK: nothing more is to be read.
  absl::Status Receive();
  absl::Status Begin();
  void Store();
  absl::Status TryStore();
  void FinishWith(const absl::Status& status);

  grpc::CallbackServerContext* const call_;
  ServiceContext& context_;
  v1::UploadSceneResponse* const response_;
  const Cancellation::Clock::time_point arrival_ = Cancellation::Clock::now();
  Cancellation cancellation_;
  v1::UploadSceneRequest chunk_;
  bool begun_ = false;
  std::string digest_;
  uint64_t total_bytes_ = 0;
  std::string bytes_;
  Admission::Ticket ticket_;
  std::shared_ptr<SceneUpload> self_;
};

}  // namespace shadowfit
