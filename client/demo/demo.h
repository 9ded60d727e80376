#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/client.h"
#include "client/demo/mask_study.h"
#include "client/demo/resolution_study.h"
#include "client/demo/walk.h"
#include "client/demo/walk_record.h"
#include "core/math/shadow_projection.h"
#include "core/scene/scene.h"

namespace shadowfit {

struct DemoOptions {
  int frames = 48;
  int lights = 4;
  MapSize screen{1024, 768};
  MapSize map_size{512, 512};
  /// Frames between what the service saw and what is drawn with its answer. Methods that need no service draw
  /// with the matrices of the same frame.
  int latency = 2;
  int report_pictures = 6;    ///< Frames that the report shows, and for which exact masks are rendered.
  int resolution_frames = 9;  ///< Frames whose needed map sizes the report shows.
};

struct DemoResult {
  std::string scene;
  std::vector<std::string> light_names;
  std::vector<WalkRecord> records;
  ResolutionFigures resolution;
  MaskFigures masks;
};

/// Walks through the scene with every method side by side, counts each one's wrong pixels with shadow rays,
/// and writes to `out` (which is made if need be): frames/NNN.png, comparison.png (one frame, Focused on the
/// left and the default method on the right), matrices.json, report.html. `on_frame` is called after every
/// frame.
absl::StatusOr<DemoResult> RunDemo(const Scene& scene, Client& client, const DemoOptions& options,
                                   const std::filesystem::path& out,
                                   const std::function<void(int done, int total)>& on_frame);

}  // namespace shadowfit
