#pragma once

#include <grpcpp/server_context.h>
#include <grpcpp/support/server_callback.h>

#include <cstddef>
#include <functional>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "core/cancellation.h"
#include "server/job.h"
#include "server/service_context.h"

namespace shadowfit {

/// One unary call whose answer is computed on the worker pool. Keeps itself alive until gRPC is done with it.
class UnaryReactor final : public grpc::ServerUnaryReactor,
                           public std::enable_shared_from_this<UnaryReactor> {
 public:
  using Work = std::function<absl::Status(const JobContext&)>;

  /// Admits a request of `bytes`, then runs `work` on a worker and finishes the call with its status. The
  /// pointer is for gRPC.
  static grpc::ServerUnaryReactor* Start(grpc::CallbackServerContext* call, ServiceContext& context,
                                         std::string method, size_t bytes, Work work);

  UnaryReactor(grpc::CallbackServerContext* call, ServiceContext& context, std::string method, Work work);

  void OnCancel() override { cancellation_.Cancel(); }
  void OnDone() override;

 private:
  void Run();
  absl::Status RunWork(double queue_seconds);
  void FinishWith(const absl::Status& status);

  ServiceContext& context_;
  const std::string method_;
  const Cancellation::Clock::time_point arrival_ = Cancellation::Clock::now();
  Cancellation cancellation_;
  Work work_;
  Admission::Ticket ticket_;
  std::shared_ptr<UnaryReactor> self_;
};

}  // namespace shadowfit
