#include "client/demo/frame_loop.h"

#include <cmath>
#include <utility>

#include "absl/strings/str_format.h"
#include "client/demo/wire_encoding.h"

namespace shadowfit {
namespace {

using SteadyClock = std::chrono::steady_clock;

double MillisecondsSince(SteadyClock::time_point start) {
  return std::chrono::duration<double, std::milli>(SteadyClock::now() - start).count();
}

/// The final picture's size, as far as the guard band reaches.
MapSize WithGuardBand(MapSize screen, double guard_band) {
  const double scale = 1.0 + 2.0 * guard_band;
  return {static_cast<int>(std::lround(screen.width * scale)),
          static_cast<int>(std::lround(screen.height * scale))};
}

}  // namespace

CameraMatrices WithGuardBand(CameraMatrices camera, double guard_band) {
  const double scale = 1.0 / (1.0 + 2.0 * guard_band);
  for (int column = 0; column < 4; ++column) {
    camera.clip_from_view[column].x *= scale;
    camera.clip_from_view[column].y *= scale;
  }
  return camera;
}

absl::StatusOr<std::unique_ptr<FrameLoop>> FrameLoop::Create(Renderer* renderer,
                                                             std::vector<SceneLight> lights,
                                                             std::unique_ptr<FrameStream> stream,
                                                             const FrameLoopOptions& options) {
  if (options.latency < 0) {
    return absl::InvalidArgumentError(absl::StrFormat("latency: %d is negative", options.latency));
  }
  if (!(options.guard_band >= 0.0 && options.guard_band <= 1.0)) {
    return absl::InvalidArgumentError(absl::StrFormat("guard_band: %g is outside [0,1]", options.guard_band));
  }
  const std::vector<MapSize> sizes(lights.size(), options.map_size);
  absl::StatusOr<ShadowMaps> maps = renderer->CreateShadowMaps(sizes);
  if (!maps.ok()) return maps.status();
  absl::StatusOr<ShadowMaps> standard_maps = renderer->CreateShadowMaps(sizes);
  if (!standard_maps.ok()) return standard_maps.status();
  return std::unique_ptr<FrameLoop>(new FrameLoop(renderer, std::move(lights), std::move(stream), options,
                                                  *std::move(maps), *std::move(standard_maps)));
}

FrameLoop::FrameLoop(Renderer* renderer, std::vector<SceneLight> lights, std::unique_ptr<FrameStream> stream,
                     const FrameLoopOptions& options, ShadowMaps maps, ShadowMaps standard_maps)
    : renderer_(renderer),
      lights_(std::move(lights)),
      stream_(std::move(stream)),
      options_(options),
      maps_(std::move(maps)),
      standard_maps_(std::move(standard_maps)) {}

absl::StatusOr<FrameTrace> FrameLoop::Step(const CameraMatrices& camera_matrices) {
  FrameTrace trace;
  ++frame_id_;
  const CameraMatrices widened = WithGuardBand(camera_matrices, options_.guard_band);
  const absl::StatusOr<Camera> camera = Camera::Create(widened);
  if (!camera.ok()) return camera.status();

  const SteadyClock::time_point start = SteadyClock::now();
  if (absl::Status status = DrawSamples(*camera); !status.ok()) return status;
  if (absl::Status status = Submit(widened); !status.ok()) return status;
  trace.samples_ms = MillisecondsSince(start);

  const SteadyClock::time_point submitted = SteadyClock::now();
  if (frame_id_ > static_cast<uint64_t>(options_.latency)) {
    const absl::StatusOr<FrameOutcome> outcome = Await(frame_id_ - static_cast<uint64_t>(options_.latency));
    if (!outcome.ok()) return outcome.status();
    if (!outcome->result.ok()) return outcome->result.status();
    trace.wait_ms = MillisecondsSince(submitted);
    trace.round_trip_ms = std::chrono::duration<double, std::milli>(outcome->round_trip).count();
    for (const v1::LightResult& light : outcome->result->lights()) {
      trace.optimize_ms.push_back(light.optimize_seconds() * 1e3);
    }
    if (absl::Status status = DrawMaps(*outcome->result); !status.ok()) return status;
  } else {
    // No answer is due yet: a renderer starts with what it would do without the service.
    const absl::StatusOr<Camera> screen_camera = Camera::Create(camera_matrices);
    if (!screen_camera.ok()) return screen_camera.status();
    if (absl::Status status = DrawStandardMaps(*screen_camera, &maps_); !status.ok()) return status;
  }
  maps_drawn_ = true;
  trace.shadow_maps_ms = MillisecondsSince(submitted) - trace.wait_ms;
  return trace;
}

absl::Status FrameLoop::DrawSamples(const Camera& camera) {
  const bool due =
      options_.standard_maps_every > 0 && frame_id_ % static_cast<uint64_t>(options_.standard_maps_every) ==
                                              1 % static_cast<uint64_t>(options_.standard_maps_every);
  if (maps_drawn_ && !due) return renderer_->DrawSamples(camera, maps_, &samples_);
  // Conventional maps need to know how far the picture reaches, which takes a depth pass of its own.
  if (absl::Status status = renderer_->DrawSamples(camera, standard_maps_, &samples_); !status.ok())
    return status;
  if (absl::Status status = DrawStandardMaps(camera, &standard_maps_); !status.ok()) return status;
  return renderer_->DrawSamples(camera, standard_maps_, &samples_);
}

absl::Status FrameLoop::DrawStandardMaps(const Camera& camera, ShadowMaps* maps) {
  FrameRequest request;
  request.camera = {camera.view_from_world(), camera.clip_from_view(), camera.clip_depth()};
  request.depth = samples_.Depth();
  request.screen = renderer_->options().screen;
  if (!renderer_->ws_bounds().empty()) request.ws_scene_bounds = renderer_->ws_bounds();
  for (size_t i = 0; i < lights_.size(); ++i) {
    request.lights.push_back({static_cast<uint32_t>(i), lights_[i].light, options_.map_size, std::nullopt});
  }
  Options options;
  options.method = Method::kFocused;
  if (absl::Status status = optimizer_.Optimize(request, options, Cancellation(), &summary_); !status.ok()) {
    return status;
  }
  std::vector<LightView> views;
  for (size_t i = 0; i < lights_.size(); ++i) {
    views.push_back(
        {lights_[i].light, lights_[i].power, summary_.lights[i].clip_from_world, options_.map_size});
  }
  return renderer_->DrawShadowMaps(views, maps);
}

absl::Status FrameLoop::Submit(const CameraMatrices& camera) {
  v1::Frame* frame = stream_->Acquire();
  if (frame == nullptr) {
    return absl::FailedPreconditionError(
        absl::StrFormat("the stream takes %d frames at a time, too few for a latency of %d",
                        stream_->in_flight(), options_.latency));
  }
  frame->set_frame_id(frame_id_);
  Encode(camera, frame->mutable_camera());
  EncodeDepth(samples_.width, samples_.height, samples_.depth, frame->mutable_depth());
  v1::BitBuffer* bits = frame->mutable_shadow_bits();
  bits->set_width(frame->depth().width());
  bits->set_height(frame->depth().height());
  bits->set_row_order(v1::ROW_ORDER_BOTTOM_FIRST);
  Encode(samples_.bits, bits->mutable_data());

  frame->clear_lights();
  for (size_t i = 0; i < lights_.size(); ++i) {
    v1::Light* light = frame->add_lights();
    light->set_id(static_cast<uint32_t>(i));
    Encode(lights_[i].light, light);
    light->mutable_shadow_map()->set_width(static_cast<uint32_t>(options_.map_size.width));
    light->mutable_shadow_map()->set_height(static_cast<uint32_t>(options_.map_size.height));
  }
  const MapSize screen = WithGuardBand(renderer_->options().screen, options_.guard_band);
  frame->mutable_screen()->set_width(static_cast<uint32_t>(screen.width));
  frame->mutable_screen()->set_height(static_cast<uint32_t>(screen.height));
  if (const Bounds& bounds = renderer_->ws_bounds(); !bounds.empty()) {
    Encode(bounds.min, frame->mutable_scene_bounds()->mutable_min());
    Encode(bounds.max, frame->mutable_scene_bounds()->mutable_max());
  }
  frame->mutable_options()->set_method(options_.method);
  frame->mutable_options()->set_most_maps(1);  // The renderer has one map a light.
  frame->mutable_options()->set_output_clip_depth(v1::CLIP_DEPTH_NEGATIVE_ONE_TO_ONE);
  return stream_->Submit(frame);
}

absl::StatusOr<FrameOutcome> FrameLoop::Await(uint64_t frame_id) {
  for (;;) {
    if (const auto early = early_.find(frame_id); early != early_.end()) {
      FrameOutcome outcome = std::move(early->second);
      early_.erase(early);
      return outcome;
    }
    // Every submitted frame has an outcome in the end; the stream's own timeout bounds the wait.
    std::optional<FrameOutcome> outcome = stream_->Wait(std::chrono::milliseconds(1000));
    if (outcome) {
      const uint64_t id = outcome->frame_id;
      early_.emplace(id, *std::move(outcome));
    } else if (stream_->in_flight() == 0) {
      return absl::InternalError(absl::StrFormat("frame %d: the stream holds no answer", frame_id));
    }
  }
}

absl::Status FrameLoop::DrawMaps(const v1::FrameResult& result) {
  if (static_cast<size_t>(result.lights_size()) != lights_.size()) {
    return absl::InternalError(
        absl::StrFormat("the service answered %d lights for %d", result.lights_size(), lights_.size()));
  }
  std::vector<LightView> views;
  for (size_t i = 0; i < lights_.size(); ++i) {
    const v1::Matrix4& m = result.lights(static_cast<int>(i)).world_to_shadow_clip();
    if (m.m_size() != 16)
      return absl::InternalError(absl::StrFormat("lights[%d]: no matrix in the answer", i));
    LightView view{lights_[i].light, lights_[i].power, glm::dmat4(0.0), options_.map_size};
    for (int entry = 0; entry < 16; ++entry) view.clip_from_world[entry / 4][entry % 4] = m.m(entry);
    views.push_back(view);
  }
  return renderer_->DrawShadowMaps(views, &maps_);
}

}  // namespace shadowfit
