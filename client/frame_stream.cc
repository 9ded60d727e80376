#include "client/frame_stream.h"

#include "client/client_stream_reactor.h"
#include "shadowfit/v1/optimizer.grpc.pb.h"

namespace shadowfit {
namespace {

struct OptimizeTraits {
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

}  // namespace

class FrameStream::Reactor {
 public:
  Reactor(const std::shared_ptr<grpc::Channel>& channel, std::string name, const FrameStreamOptions& options)
      : stream(channel, std::move(name), options) {}

  ClientStreamReactor<OptimizeTraits> stream;
};

FrameStream::FrameStream(const std::shared_ptr<grpc::Channel>& channel, std::string name,
                         const FrameStreamOptions& options)
    : reactor_(std::make_unique<Reactor>(channel, std::move(name), options)) {}

FrameStream::~FrameStream() = default;

v1::Frame* FrameStream::Acquire() { return reactor_->stream.Acquire(); }
absl::Status FrameStream::Submit(v1::Frame* frame) { return reactor_->stream.Submit(frame); }
void FrameStream::Discard(v1::Frame* frame) { reactor_->stream.Discard(frame); }
std::optional<FrameOutcome> FrameStream::Poll() {
  return reactor_->stream.Wait(std::chrono::milliseconds(0));
}
std::optional<FrameOutcome> FrameStream::Wait(std::chrono::milliseconds timeout) {
  return reactor_->stream.Wait(timeout);
}
int FrameStream::in_flight() const { return reactor_->stream.in_flight(); }
absl::Status FrameStream::status() const { return reactor_->stream.status(); }
absl::Status FrameStream::Finish(std::chrono::milliseconds timeout) {
  return reactor_->stream.Finish(timeout);
}
void FrameStream::Cancel() { reactor_->stream.Cancel(); }

}  // namespace shadowfit
