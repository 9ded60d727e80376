#pragma once

#include <filesystem>
#include <functional>

#include "absl/status/statusor.h"
#include "client/client.h"
#include "client/demo/camera_path.h"
#include "core/scene/scene.h"
#include "shadowfit/v1/frame.pb.h"

namespace shadowfit {

/// Draws a camera path with one method through the service, frame f with the answer for frame f - `latency`,
/// and writes `out`/NNN.png and `out`/matrices.json. Lights that the path does not name are the scene's own
/// of the demo.
struct RenderedPath {
  size_t frames = 0;
  size_t lights = 0;
  double frames_per_second = 0.0;  ///< Without writing files.
};
absl::StatusOr<RenderedPath> RenderPath(const Scene& scene, Client& client, CameraPath path,
                                        v1::Method method, int latency, const std::filesystem::path& out,
                                        const std::function<void(int done, int total)>& on_frame);

}  // namespace shadowfit
