#include "client/demo/render_path.h"

#include <chrono>
#include <memory>
#include <utility>

#include "absl/strings/str_format.h"
#include "client/demo/frame_loop.h"
#include "client/demo/output_files.h"
#include "client/demo/walk_record.h"
#include "client/render/renderer.h"

namespace shadowfit {

absl::StatusOr<RenderedPath> RenderPath(const Scene& scene, Client& client, CameraPath path,
                                        v1::Method method, int latency, const std::filesystem::path& out,
                                        const std::function<void(int, int)>& on_frame) {
  if (absl::Status status = MakeFolder(out); !status.ok()) return status;
  if (path.walk.lights.empty()) {
    constexpr int kDemoLights = 4;
    path.walk.lights =
        PlanWalk(scene, 1, kDemoLights, static_cast<double>(path.screen.width) / path.screen.height).lights;
  }
  RendererOptions renderer_options;
  renderer_options.screen = path.screen;
  absl::StatusOr<std::unique_ptr<Renderer>> renderer = Renderer::Create(scene, renderer_options);
  if (!renderer.ok()) return renderer.status();
  FrameLoopOptions loop_options;
  loop_options.method = method;
  loop_options.map_size = path.map_size;
  loop_options.latency = latency;
  FrameStreamOptions stream_options;
  stream_options.max_in_flight = latency + 1;
  stream_options.frame_timeout = std::chrono::seconds(30);
  const absl::StatusOr<std::unique_ptr<FrameLoop>> loop =
      FrameLoop::Create(renderer->get(), path.walk.lights, client.OpenStream(stream_options), loop_options);
  if (!loop.ok()) return loop.status();

  RenderedPath rendered;
  rendered.frames = path.walk.cameras.size();
  rendered.lights = path.walk.lights.size();
  WalkRecord record;
  record.name = v1::Method_Name(method);
  double seconds = 0.0;
  for (size_t frame = 0; frame < path.walk.cameras.size(); ++frame) {
    const absl::StatusOr<Camera> camera = Camera::Create(path.walk.cameras[frame]);
    if (!camera.ok()) return camera.status();
    const auto start = std::chrono::steady_clock::now();
    const absl::StatusOr<FrameTrace> trace = (*loop)->Step(path.walk.cameras[frame]);
    if (!trace.ok()) return trace.status();
    const absl::StatusOr<Picture> picture =
        (*renderer)->DrawPicture(*camera, (*loop)->maps(), /*antialiased=*/true);
    if (!picture.ok()) return picture.status();
    seconds += std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    record.AddMatrices((*loop)->maps().lights());
    if (absl::Status status = WritePng(out / absl::StrFormat("%03d.png", frame), *picture); !status.ok())
      return status;
    on_frame(static_cast<int>(frame) + 1, static_cast<int>(rendered.frames));
  }
  rendered.frames_per_second = static_cast<double>(rendered.frames) / seconds;
  if (absl::Status status = WriteText(out / "matrices.json", MatricesJson(scene.name, {record}).dump());
      !status.ok()) {
    return status;
  }
  return rendered;
}

}  // namespace shadowfit
