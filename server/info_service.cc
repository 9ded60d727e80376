#include "server/info_service.h"

#include <chrono>

#include "core/fit/frame_optimizer.h"

namespace shadowfit {

// Answered at once, not on the worker pool: a busy service must be able to say so.
grpc::ServerUnaryReactor* InfoServiceImpl::GetInfo(grpc::CallbackServerContext* call,
                                                   const v1::GetInfoRequest*, v1::GetInfoResponse* response) {
  response->set_version(SHADOWFIT_VERSION);
  v1::Limits& limits = *response->mutable_limits();
  limits.set_max_message_bytes(context_.options.max_message_bytes);
  limits.set_max_admitted_bytes(context_.options.max_admitted_bytes);
  limits.set_max_admitted_jobs(static_cast<uint32_t>(context_.options.max_admitted_jobs));
  limits.set_max_lights(kMaxLights);
  limits.set_max_frames_in_stream(static_cast<uint32_t>(context_.options.max_frames_in_stream));
  limits.set_max_streams(static_cast<uint32_t>(context_.options.max_streams));
  limits.set_workers(static_cast<uint32_t>(context_.pool.workers()));
  v1::Load& load = *response->mutable_load();
  load.set_admitted_bytes(context_.admission.bytes());
  load.set_admitted_jobs(static_cast<uint32_t>(context_.admission.jobs()));
  load.set_open_streams(static_cast<uint32_t>(context_.streams.count()));
  load.set_uptime_seconds(
      std::chrono::duration<double>(std::chrono::steady_clock::now() - context_.started).count());
  load.set_draining(context_.streams.draining());
  grpc::ServerUnaryReactor* reactor = call->DefaultReactor();
  reactor->Finish(grpc::Status::OK);
  return reactor;
}

}  // namespace shadowfit
