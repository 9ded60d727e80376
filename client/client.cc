#include "client/client.h"

#include <grpcpp/channel.h>
#include <grpcpp/client_context.h>
#include <grpcpp/create_channel.h>
#include <grpcpp/security/credentials.h>

#include <algorithm>
#include <limits>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "client/grpc_status.h"
#include "proto/scene_upload_metadata.h"
#include "shadowfit/v1/info.grpc.pb.h"
#include "shadowfit/v1/mask.grpc.pb.h"
#include "shadowfit/v1/optimizer.grpc.pb.h"
#include "shadowfit/v1/resolution.grpc.pb.h"
#include "shadowfit/v1/scene.grpc.pb.h"

namespace shadowfit {
namespace {

// These calls depend on nothing but their frame, so that any replica can serve any call and a call that
// a dying replica lost may be sent again. Streams are not retried: their end is the caller's to know.
constexpr char kServiceConfig[] = R"({
  "loadBalancingConfig": [{"round_robin": {}}],
  "healthCheckConfig": {"serviceName": "shadowfit.v1.OptimizerService"},
  "methodConfig": [{
    "name": [
      {"service": "shadowfit.v1.OptimizerService", "method": "Optimize"},
      {"service": "shadowfit.v1.ResolutionService", "method": "EstimateResolution"},
      {"service": "shadowfit.v1.MaskService", "method": "RenderMasks"},
      {"service": "shadowfit.v1.SceneService", "method": "FindMissingScenes"},
      {"service": "shadowfit.v1.SceneService", "method": "ListScenes"}
    ],
    "retryPolicy": {
      "maxAttempts": 4,
      "initialBackoff": "0.02s",
      "maxBackoff": "0.5s",
      "backoffMultiplier": 2,
      "retryableStatusCodes": ["UNAVAILABLE"]
    }
  }]
})";

// Hands a message to a request for as long as a call lasts: a frame is megabytes that need no copy.
template <typename Frame, typename Request>
class BorrowedFrame {
 public:
  BorrowedFrame(const Frame& frame, Request& request) : request_(request) {
    request_.unsafe_arena_set_allocated_frame(const_cast<Frame*>(&frame));  // It is only read.
  }
  ~BorrowedFrame() { static_cast<void>(request_.unsafe_arena_release_frame()); }
  BorrowedFrame(const BorrowedFrame&) = delete;
  BorrowedFrame& operator=(const BorrowedFrame&) = delete;

 private:
  Request& request_;
};

template <typename Call>
absl::Status RunCall(const std::string& name, const CallOptions& options, const Call& call) {
  grpc::ClientContext context;
  if (options.timeout.count() > 0) {
    context.set_deadline(std::chrono::system_clock::now() + options.timeout);
  }
  const std::stop_callback cancel(options.stop, [&context] { context.TryCancel(); });
  return StatusFromGrpc(call(&context), name);
}

}  // namespace

absl::StatusOr<std::unique_ptr<Client>> Client::Connect(const std::string& address,
                                                        const ClientOptions& options) {
  if (address.empty()) return absl::InvalidArgumentError("address: empty; give HOST:PORT or unix:PATH");
  if (!absl::StrContains(address, ':')) {
    return absl::InvalidArgumentError(
        absl::StrCat("address: \"", address, "\" is neither HOST:PORT nor unix:PATH"));
  }
  const int max_message_bytes =
      static_cast<int>(std::min<size_t>(options.max_message_bytes, std::numeric_limits<int>::max()));
  grpc::ChannelArguments arguments;
  arguments.SetServiceConfigJSON(kServiceConfig);
  arguments.SetMaxSendMessageSize(max_message_bytes);
  arguments.SetMaxReceiveMessageSize(max_message_bytes);
  // A message above the retry buffer is never retried.
  arguments.SetInt(GRPC_ARG_PER_RPC_RETRY_BUFFER_SIZE, max_message_bytes);
  // A host that vanished without closing its connections is noticed all the same.
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIME_MS, 20000);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 5000);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_PERMIT_WITHOUT_CALLS, 0);
  std::shared_ptr<grpc::Channel> channel =
      grpc::CreateCustomChannel(address, grpc::InsecureChannelCredentials(), arguments);
  if (!channel->WaitForConnected(std::chrono::system_clock::now() + options.connect_timeout)) {
    return absl::UnavailableError(absl::StrCat(address, ": no shadowfit service answered within ",
                                               options.connect_timeout.count(), " ms"));
  }
  return FromChannel(std::move(channel), address);
}

std::unique_ptr<Client> Client::FromChannel(std::shared_ptr<grpc::Channel> channel, std::string name) {
  return std::unique_ptr<Client>(new Client(std::move(channel), std::move(name)));
}

Client::Client(std::shared_ptr<grpc::Channel> channel, std::string name)
    : channel_(std::move(channel)), name_(std::move(name)) {}

Client::~Client() = default;

absl::StatusOr<v1::FrameResult> Client::Optimize(const v1::Frame& frame, const CallOptions& options) {
  const auto stub = v1::OptimizerService::NewStub(channel_);
  v1::OptimizeRequest request;
  const BorrowedFrame borrowed(frame, request);
  v1::OptimizeResponse response;
  const absl::Status status = RunCall(name_, options, [&](grpc::ClientContext* context) {
    return stub->Optimize(context, request, &response);
  });
  if (!status.ok()) return status;
  return std::move(*response.mutable_result());
}

absl::StatusOr<v1::ResolutionResult> Client::EstimateResolution(
    const v1::Frame& frame, const v1::ResolutionOptions& resolution_options, const CallOptions& options) {
  const auto stub = v1::ResolutionService::NewStub(channel_);
  v1::EstimateResolutionRequest request;
  *request.mutable_options() = resolution_options;
  const BorrowedFrame borrowed(frame, request);
  v1::EstimateResolutionResponse response;
  const absl::Status status = RunCall(name_, options, [&](grpc::ClientContext* context) {
    return stub->EstimateResolution(context, request, &response);
  });
  if (!status.ok()) return status;
  return std::move(*response.mutable_result());
}

std::unique_ptr<FrameStream> Client::OpenStream(const FrameStreamOptions& options) {
  return std::make_unique<FrameStream>(channel_, name_, options);
}

absl::StatusOr<v1::MaskResult> Client::RenderMasks(const v1::MaskFrame& frame, const PackedScene* scene,
                                                   const CallOptions& options) {
  const auto stub = v1::MaskService::NewStub(channel_);
  v1::RenderMasksRequest request;
  const BorrowedFrame borrowed(frame, request);
  v1::RenderMasksResponse response;
  const auto render = [&] {
    return RunCall(name_, options, [&](grpc::ClientContext* context) {
      return stub->RenderMasks(context, request, &response);
    });
  };
  absl::Status status = render();
  // Several replicas take turns, each with scenes of its own. Were each attempt to upload once, calls and
  // uploads could miss each other for ever; more uploads from attempt to attempt reach all replicas. Those
  // that have the scene answer at once.
  constexpr int kMostUploads = 8;
  for (int uploads = 1; scene != nullptr && absl::IsNotFound(status) && uploads <= kMostUploads; ++uploads) {
    for (int i = 0; i < uploads; ++i) {
      const auto uploaded = UploadScene(*scene, options);
      if (!uploaded.ok()) return uploaded.status();
    }
    status = render();
  }
  if (!status.ok()) return status;
  return std::move(*response.mutable_result());
}

std::unique_ptr<MaskStream> Client::OpenMaskStream(const FrameStreamOptions& options) {
  return std::make_unique<MaskStream>(channel_, name_, options);
}

absl::StatusOr<std::vector<std::string>> Client::FindMissingScenes(std::span<const std::string> digests,
                                                                   const CallOptions& options) {
  const auto stub = v1::SceneService::NewStub(channel_);
  v1::FindMissingScenesRequest request;
  request.mutable_digests()->Add(digests.begin(), digests.end());
  v1::FindMissingScenesResponse response;
  const absl::Status status = RunCall(name_, options, [&](grpc::ClientContext* context) {
    return stub->FindMissingScenes(context, request, &response);
  });
  if (!status.ok()) return status;
  return std::vector<std::string>(response.missing_digests().begin(), response.missing_digests().end());
}

absl::StatusOr<v1::UploadSceneResponse> Client::UploadScene(const PackedScene& scene,
                                                            const CallOptions& options) {
  constexpr size_t kChunkBytes = size_t{1} << 20;
  const auto stub = v1::SceneService::NewStub(channel_);
  v1::UploadSceneResponse response;
  const absl::Status status = RunCall(name_, options, [&](grpc::ClientContext* context) {
    const auto writer = stub->UploadScene(context, &response);
    v1::UploadSceneRequest chunk;
    chunk.set_digest(scene.digest);
    chunk.set_total_bytes(scene.bytes.size());
    // The first message goes alone. A service that has the scene, or will not have it, answers it and asks
    // for no byte; those that came after its answer would leave some of gRPC's transports waiting.
    bool open = writer->Write(chunk);
    writer->WaitForInitialMetadata();
    open = open && context->GetServerInitialMetadata().count(kSceneWantedKey) > 0;
    chunk.Clear();
    for (size_t at = 0; open && at < scene.bytes.size(); at += chunk.data().size()) {
      chunk.set_data(scene.bytes.substr(at, kChunkBytes));
      open = writer->Write(chunk);
    }
    if (open) writer->WritesDone();
    return writer->Finish();  // Says why where the service would not read on.
  });
  if (!status.ok()) return status;
  return response;
}

absl::StatusOr<v1::ListScenesResponse> Client::ListScenes(const CallOptions& options) {
  const auto stub = v1::SceneService::NewStub(channel_);
  v1::ListScenesResponse response;
  const absl::Status status = RunCall(
      name_, options, [&](grpc::ClientContext* context) { return stub->ListScenes(context, {}, &response); });
  if (!status.ok()) return status;
  return response;
}

absl::Status Client::DeleteScene(const std::string& digest, const CallOptions& options) {
  const auto stub = v1::SceneService::NewStub(channel_);
  v1::DeleteSceneRequest request;
  request.set_digest(digest);
  v1::DeleteSceneResponse response;
  return RunCall(name_, options, [&](grpc::ClientContext* context) {
    return stub->DeleteScene(context, request, &response);
  });
}

absl::StatusOr<v1::GetInfoResponse> Client::GetInfo(const CallOptions& options) {
  const auto stub = v1::InfoService::NewStub(channel_);
  v1::GetInfoResponse response;
  const absl::Status status = RunCall(
      name_, options, [&](grpc::ClientContext* context) { return stub->GetInfo(context, {}, &response); });
  if (!status.ok()) return status;
  return response;
}

}  // namespace shadowfit
