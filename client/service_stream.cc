#include "client/service_stream.h"

#include <utility>

#include "client/client_stream_reactor.h"
#include "shadowfit/v1/mask.grpc.pb.h"
#include "shadowfit/v1/optimizer.grpc.pb.h"

namespace shadowfit {
namespace {

template <typename Frame>
struct Traits;

template <>
struct Traits<v1::Frame> {
  using Request = v1::OptimizeStreamRequest;
  using Response = v1::OptimizeStreamResponse;
  using Frame = v1::Frame;
  using Outcome = FrameOutcome;
  using Service = v1::OptimizerService;
  static void Call(Service::Stub& stub, grpc::ClientContext* context,
                   grpc::ClientBidiReactor<Request, Response>* reactor) {
    stub.async()->OptimizeStream(context, reactor);
  }
};

template <>
struct Traits<v1::MaskFrame> {
  using Request = v1::RenderMasksStreamRequest;
  using Response = v1::RenderMasksStreamResponse;
  using Frame = v1::MaskFrame;
  using Outcome = MaskOutcome;
  using Service = v1::MaskService;
  static void Call(Service::Stub& stub, grpc::ClientContext* context,
                   grpc::ClientBidiReactor<Request, Response>* reactor) {
    stub.async()->RenderMasksStream(context, reactor);
  }
};

}  // namespace

template <typename Frame, typename Result>
class ServiceStream<Frame, Result>::Reactor : public ClientStreamReactor<Traits<Frame>> {
 public:
  using ClientStreamReactor<Traits<Frame>>::ClientStreamReactor;
};

template <typename Frame, typename Result>
ServiceStream<Frame, Result>::ServiceStream(const std::shared_ptr<grpc::Channel>& channel, std::string name,
                                            const FrameStreamOptions& options)
    : reactor_(std::make_unique<Reactor>(channel, std::move(name), options)) {}

template <typename Frame, typename Result>
ServiceStream<Frame, Result>::~ServiceStream() = default;

template <typename Frame, typename Result>
Frame* ServiceStream<Frame, Result>::Acquire() {
  return reactor_->Acquire();
}

template <typename Frame, typename Result>
absl::Status ServiceStream<Frame, Result>::Submit(Frame* frame) {
  return reactor_->Submit(frame);
}

template <typename Frame, typename Result>
void ServiceStream<Frame, Result>::Discard(Frame* frame) {
  reactor_->Discard(frame);
}

template <typename Frame, typename Result>
std::optional<StreamOutcome<Result>> ServiceStream<Frame, Result>::Poll() {
  return reactor_->Wait(std::chrono::milliseconds(0));
}

template <typename Frame, typename Result>
std::optional<StreamOutcome<Result>> ServiceStream<Frame, Result>::Wait(std::chrono::milliseconds timeout) {
  return reactor_->Wait(timeout);
}

template <typename Frame, typename Result>
int ServiceStream<Frame, Result>::in_flight() const {
  return reactor_->in_flight();
}

template <typename Frame, typename Result>
absl::Status ServiceStream<Frame, Result>::status() const {
  return reactor_->status();
}

template <typename Frame, typename Result>
absl::Status ServiceStream<Frame, Result>::Finish(std::chrono::milliseconds timeout) {
  return reactor_->Finish(timeout);
}

template <typename Frame, typename Result>
void ServiceStream<Frame, Result>::Cancel() {
  reactor_->Cancel();
}

template class ServiceStream<v1::Frame, v1::FrameResult>;
template class ServiceStream<v1::MaskFrame, v1::MaskResult>;

}  // namespace shadowfit
