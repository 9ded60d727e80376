#include "client/mask_stream.h"

#include "client/client_stream_reactor.h"
#include "shadowfit/v1/mask.grpc.pb.h"

namespace shadowfit {
namespace {

struct MaskTraits {
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

class MaskStream::Reactor {
 public:
  Reactor(const std::shared_ptr<grpc::Channel>& channel, std::string name, const FrameStreamOptions& options)
      : stream(channel, std::move(name), options) {}

  ClientStreamReactor<MaskTraits> stream;
};

MaskStream::MaskStream(const std::shared_ptr<grpc::Channel>& channel, std::string name,
                       const FrameStreamOptions& options)
    : reactor_(std::make_unique<Reactor>(channel, std::move(name), options)) {}

MaskStream::~MaskStream() = default;

v1::MaskFrame* MaskStream::Acquire() { return reactor_->stream.Acquire(); }
absl::Status MaskStream::Submit(v1::MaskFrame* frame) { return reactor_->stream.Submit(frame); }
void MaskStream::Discard(v1::MaskFrame* frame) { reactor_->stream.Discard(frame); }
std::optional<MaskOutcome> MaskStream::Poll() { return reactor_->stream.Wait(std::chrono::milliseconds(0)); }
std::optional<MaskOutcome> MaskStream::Wait(std::chrono::milliseconds timeout) {
  return reactor_->stream.Wait(timeout);
}
int MaskStream::in_flight() const { return reactor_->stream.in_flight(); }
absl::Status MaskStream::status() const { return reactor_->stream.status(); }
absl::Status MaskStream::Finish(std::chrono::milliseconds timeout) {
  return reactor_->stream.Finish(timeout);
}
void MaskStream::Cancel() { reactor_->stream.Cancel(); }

}  // namespace shadowfit
