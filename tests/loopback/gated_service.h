#pragma once

#include <grpcpp/health_check_service_interface.h>
#include <grpcpp/server.h>
#include <grpcpp/server_builder.h>

#include <atomic>
#include <chrono>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "client/client.h"
#include "server/service_context.h"
#include "server/stream_reactor.h"
#include "server/unary_reactor.h"
#include "shadowfit/v1/optimizer.grpc.pb.h"

namespace shadowfit::testing {

/// An optimizer service whose computations wait until the test lets them go on: the reactors are the real
/// ones, what they compute is not.
class GatedService final : public v1::OptimizerService::CallbackService {
 public:
  explicit GatedService(const ServerOptions& options) : context_(options) {
    grpc::EnableDefaultHealthCheckService(true);  // The client looks before it calls.
    grpc::ServerBuilder builder;
    builder.RegisterService(this);
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port_);
    server_ = builder.BuildAndStart();
    if (server_ == nullptr) throw std::runtime_error("cannot listen");
    server_->GetHealthCheckService()->SetServingStatus(v1::OptimizerService::service_full_name(), true);
  }

  ~GatedService() override {
    LetThrough(1000000);
    server_->Shutdown(std::chrono::system_clock::now() + std::chrono::seconds(5));
  }

  std::unique_ptr<Client> Connect() const {
    auto client = Client::Connect("127.0.0.1:" + std::to_string(port_));
    if (!client.ok()) throw std::runtime_error(std::string(client.status().message()));
    return *std::move(client);
  }
  /// Without the client's retries.
  std::unique_ptr<Client> ConnectInProcess() const {
    return Client::FromChannel(server_->InProcessChannel({}), "in-process");
  }

  void LetThrough(int jobs) { permits_ += jobs; }
  void ThrowNext() { throw_next_ = true; }

  std::vector<uint64_t> started() const {
    const std::lock_guard lock(mutex_);
    return started_;
  }
  int most_at_a_time() const { return most_; }
  int cancelled() const { return cancelled_; }
  ServiceContext& context() { return context_; }

  grpc::ServerUnaryReactor* Optimize(grpc::CallbackServerContext* call, const v1::OptimizeRequest* request,
                                     v1::OptimizeResponse* response) override {
    return UnaryReactor::Start(call, context_, "Optimize", request->ByteSizeLong(),
                               [this, request, response](const JobContext& job) {
                                 return Compute(request->frame().frame_id(), job, response->mutable_result());
                               });
  }

  grpc::ServerBidiReactor<v1::OptimizeStreamRequest, v1::OptimizeStreamResponse>* OptimizeStream(
      grpc::CallbackServerContext* call) override {
    return StreamReactor<v1::OptimizeStreamRequest, v1::OptimizeStreamResponse>::Start(
        call, context_, "OptimizeStream", [this](const auto& request, const JobContext& job, auto* response) {
          return Compute(request.frame().frame_id(), job, response->mutable_result());
        });
  }

 private:
  absl::Status Compute(uint64_t frame_id, const JobContext& job, v1::FrameResult* result) {
    {
      const std::lock_guard lock(mutex_);
      started_.push_back(frame_id);
    }
    const int now = ++active_;
    int seen = most_;
    while (now > seen && !most_.compare_exchange_weak(seen, now)) {
    }
    absl::Status status = PassGate(job);
    --active_;
    if (throw_next_.exchange(false)) throw std::runtime_error("out of luck");
    result->set_frame_id(frame_id);
    return status;
  }

  absl::Status PassGate(const JobContext& job) {
    while (true) {
      int permits = permits_;
      if (permits > 0 && permits_.compare_exchange_weak(permits, permits - 1)) return absl::OkStatus();
      if (job.cancellation.Requested()) {
        ++cancelled_;
        return job.cancellation.DeadlinePassed() ? absl::DeadlineExceededError("too late at the gate")
                                                 : absl::CancelledError("cancelled at the gate");
      }
      std::this_thread::sleep_for(std::chrono::microseconds(200));
    }
  }

  ServiceContext context_;
  int port_ = 0;
  std::unique_ptr<grpc::Server> server_;
  mutable std::mutex mutex_;
  std::vector<uint64_t> started_;
  std::atomic<int> permits_{0};
  std::atomic<int> active_{0};
  std::atomic<int> most_{0};
  std::atomic<int> cancelled_{0};
  std::atomic<bool> throw_next_{false};
};

/// Whether `condition` becomes true before long.
template <typename Condition>
bool Eventually(const Condition& condition, std::chrono::milliseconds limit = std::chrono::seconds(20)) {
  const auto until = std::chrono::steady_clock::now() + limit;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > until) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return true;
}

}  // namespace shadowfit::testing
