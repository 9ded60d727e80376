#include "server/server.h"

#include <grpcpp/ext/proto_server_reflection_plugin.h>
#include <grpcpp/health_check_service_interface.h>
#include <grpcpp/resource_quota.h>
#include <grpcpp/server.h>
#include <grpcpp/server_builder.h>
#include <malloc.h>
#include <prometheus/exposer.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <exception>
#include <limits>
#include <mutex>
#include <thread>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "server/info_service.h"
#include "server/listen_address.h"
#include "server/load_collector.h"
#include "server/mask_service.h"
#include "server/optimizer_service.h"
#include "server/resolution_service.h"
#include "server/scene_service.h"
#include "server/service_context.h"

namespace shadowfit {
namespace {

constexpr const char* kServiceNames[] = {
    v1::OptimizerService::service_full_name(), v1::ResolutionService::service_full_name(),
    v1::SceneService::service_full_name(), v1::MaskService::service_full_name(),
    v1::InfoService::service_full_name()};

// Reflection and the health service are plug-ins of every server that is built after they are enabled.
void EnablePlugins() {
  static std::once_flag once;
  std::call_once(once, [] {
    grpc::EnableDefaultHealthCheckService(true);
    grpc::reflection::InitProtoReflectionServerBuilderPlugin();
  });
}

absl::Status CheckPositive(const char* name, double value) {
  if (value > 0.0) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(name, ": ", value, " is not positive"));
}

absl::Status CheckSeconds(const char* name, double value) {
  if (value >= 0.0 && value <= 86400.0) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(name, ": ", value, " is outside 0 to 86400 seconds"));
}

std::string WithPort(const std::string& address, int port) {
  if (absl::StartsWith(address, "unix:")) return address;
  return absl::StrCat(address.substr(0, address.rfind(':') + 1), port);
}

}  // namespace

absl::Status CheckServerOptions(const ServerOptions& options) {
  absl::Status status;
  for (const std::string& address : options.listen) {
    status.Update(CheckListenAddress("listen", address, options.allow_plaintext));
  }
  if (absl::StartsWith(options.metrics_listen, "unix:")) {
    status.Update(
        absl::InvalidArgumentError("metrics_listen: Unix sockets are not supported, give HOST:PORT"));
  } else if (!options.metrics_listen.empty()) {
    status.Update(CheckListenAddress("metrics_listen", options.metrics_listen, options.allow_plaintext));
  }
  if (options.workers < 0) {
    status.Update(absl::InvalidArgumentError(absl::StrCat("workers: ", options.workers, " is negative")));
  }
  status.Update(CheckPositive("max_message_bytes", static_cast<double>(options.max_message_bytes)));
  if (options.max_message_bytes > static_cast<size_t>(std::numeric_limits<int>::max())) {
    status.Update(absl::InvalidArgumentError(
        absl::StrCat("max_message_bytes: ", options.max_message_bytes, " is above 2147483647")));
  }
  status.Update(CheckPositive("max_admitted_bytes", static_cast<double>(options.max_admitted_bytes)));
  status.Update(CheckPositive("max_admitted_jobs", options.max_admitted_jobs));
  status.Update(CheckPositive("max_scene_bytes", static_cast<double>(options.max_scene_bytes)));
  status.Update(CheckPositive("max_streams", options.max_streams));
  status.Update(CheckPositive("max_frames_in_stream", options.max_frames_in_stream));
  status.Update(CheckSeconds("lame_duck_seconds", options.lame_duck_seconds));
  status.Update(CheckSeconds("drain_seconds", options.drain_seconds));
  return status;
}

struct Server::Impl {
  explicit Impl(const ServerOptions& options)
      : context(options),
        optimizer(context),
        resolution(context),
        scenes(context),
        masks(context),
        info(context) {}

  void SetServing(bool serving) const {
    grpc::HealthCheckServiceInterface* health = grpc->GetHealthCheckService();
    health->SetServingStatus(serving);  // The server as a whole, and the services that were registered.
    for (const char* name : kServiceNames) health->SetServingStatus(name, serving);
  }

  ServiceContext context;
  OptimizerServiceImpl optimizer;
  ResolutionServiceImpl resolution;
  SceneServiceImpl scenes;
  MaskServiceImpl masks;
  InfoServiceImpl info;
  std::shared_ptr<LoadCollector> load;
  std::unique_ptr<prometheus::Exposer> exposer;
  std::unique_ptr<grpc::Server> grpc;
  std::once_flag drained;
};

absl::StatusOr<std::unique_ptr<Server>> Server::Start(const ServerOptions& options) {
  if (absl::Status status = CheckServerOptions(options); !status.ok()) return status;
  EnablePlugins();
  auto impl = std::make_unique<Impl>(options);

  grpc::ServerBuilder builder;
  builder.RegisterService(&impl->optimizer);
  builder.RegisterService(&impl->resolution);
  builder.RegisterService(&impl->scenes);
  builder.RegisterService(&impl->masks);
  builder.RegisterService(&impl->info);
  builder.SetMaxReceiveMessageSize(static_cast<int>(options.max_message_bytes));
  builder.SetMaxSendMessageSize(-1);
  builder.SetDefaultCompressionAlgorithm(GRPC_COMPRESS_NONE);
  // A second server on the same port would silently share its clients.
  builder.AddChannelArgument(GRPC_ARG_ALLOW_REUSEPORT, 0);
  // Clients ping when nothing else moves; without this they would be told off with ENHANCE_YOUR_CALM.
  builder.AddChannelArgument(GRPC_ARG_HTTP2_MIN_RECV_PING_INTERVAL_WITHOUT_DATA_MS, 10000);
  // Only a backstop behind Admission: what gRPC itself buffers.
  grpc::ResourceQuota quota("shadowfit");
  quota.Resize(2 * options.max_admitted_bytes + 16 * options.max_message_bytes);
  builder.SetResourceQuota(quota);
  std::vector<int> ports(options.listen.size(), 0);
  for (size_t i = 0; i < options.listen.size(); ++i) {
    builder.AddListeningPort(options.listen[i], grpc::InsecureServerCredentials(), &ports[i]);
  }
  impl->grpc = builder.BuildAndStart();
  if (impl->grpc == nullptr) {
    return absl::UnavailableError(absl::StrCat("listen: cannot bind ", absl::StrJoin(options.listen, ", "),
                                               "; is the address in use or not this machine's?"));
  }
  if (!options.metrics_listen.empty()) {
    try {
      impl->exposer = std::make_unique<prometheus::Exposer>(options.metrics_listen, 1);
    } catch (const std::exception& error) {
      return absl::UnavailableError(
          absl::StrCat("metrics_listen: cannot bind ", options.metrics_listen, ": ", error.what()));
    }
    impl->load = std::make_shared<LoadCollector>(impl->context);
    impl->exposer->RegisterCollectable(impl->context.metrics.registry());
    impl->exposer->RegisterCollectable(impl->load);
  }
  impl->SetServing(true);
  std::unique_ptr<Server> server(new Server(std::move(impl)));
  for (size_t i = 0; i < options.listen.size(); ++i) {
    server->addresses_.push_back(WithPort(options.listen[i], ports[i]));
  }
  return server;
}

Server::Server(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}

Server::~Server() { Drain(); }

std::shared_ptr<grpc::Channel> Server::InProcessChannel() {
  grpc::ChannelArguments arguments;
  arguments.SetMaxSendMessageSize(-1);
  arguments.SetMaxReceiveMessageSize(-1);
  return impl_->grpc->InProcessChannel(arguments);
}

void Server::Drain() {
  std::call_once(impl_->drained, [this] {
    using std::chrono::duration;
    const ServerOptions& options = impl_->context.options;
    OpenStreams& streams = impl_->context.streams;
    const auto start = std::chrono::steady_clock::now();
    const auto remaining = [start](double seconds) {
      const duration<double> elapsed = std::chrono::steady_clock::now() - start;
      return std::max(duration<double>(0), duration<double>(seconds) - elapsed);
    };
    impl_->SetServing(false);
    streams.Drain();
    // Calls that were on their way when health turned are still taken.
    std::this_thread::sleep_for(remaining(options.lame_duck_seconds));
    if (!streams.WaitUntilNone(remaining(options.drain_seconds))) {
      spdlog::warn("streams did not end by themselves and are ended: count={}", streams.count());
      streams.End();
      streams.WaitUntilNone(duration<double>(1.0));
    }
    impl_->grpc->Shutdown(std::chrono::system_clock::now() + std::chrono::seconds(5));
    impl_->grpc->Wait();
  });
}

void KeepLargeBuffers() {
  // 32 MiB is the most that glibc takes for the first.
  mallopt(M_MMAP_THRESHOLD, 32 << 20);
  mallopt(M_TRIM_THRESHOLD, 512 << 20);
}

}  // namespace shadowfit
