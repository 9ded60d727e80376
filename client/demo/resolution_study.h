#pragma once

#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/demo/walk.h"
#include "client/render/renderer.h"
#include "core/resolution/resolution.h"

namespace shadowfit {

/// Figures 3 and 4 of "Resolution Estimation for Shadow Mapping" for one light: a value a studied frame.
struct ResolutionRecord {
  std::string light;
  std::vector<double> recommended;     ///< Texels, the larger of width and height, as published.
  std::vector<double> recommended_99;  ///< The same for 99 % of the pixels.
  std::vector<double> share_used;      ///< Of the area of the light's ordinary frustum, per cent.
  std::vector<double> estimate_ms;     ///< From depth buffer to crop matrix.
  std::vector<double> reduced_ms;      ///< Drawing the recommended map (99 %).
  std::vector<double> fixed_ms;        ///< Drawing the fixed one over the ordinary frustum.
};

struct ResolutionFigures {
  MapSize screen;
  int limit = 4096;         ///< Of the recommended maps; the fixed map's size.
  std::vector<int> frames;  ///< Which frames of the walk were studied.
  std::vector<ResolutionRecord> lights;
  double seconds = 0.0;  ///< That the study took of the demo.
};

/// Estimates and draws the sun's and the first spot's recommended maps beside fixed ones.
class ResolutionStudy {
 public:
  /// Studies at most `frames` of the walk's frames, evenly spread. `renderer` must outlive the study.
  static absl::StatusOr<std::unique_ptr<ResolutionStudy>> Create(Renderer* renderer, const Walk& walk,
                                                                 int frames);

  /// `depth` is the frame's picture; `normal`, the lights with their ordinary matrices for it.
  absl::Status AddFrame(size_t frame, const CameraMatrices& camera, const DepthView& depth,
                        std::span<const LightView> normal);

  const ResolutionFigures& figures() const { return figures_; }

 private:
  ResolutionStudy(Renderer* renderer, std::vector<size_t> lights, ShadowMaps fixed_maps)
      : renderer_(renderer), lights_(std::move(lights)), fixed_maps_(std::move(fixed_maps)) {}

  absl::StatusOr<double> Milliseconds(const LightView& view, ShadowMaps* maps);

  Renderer* renderer_;
  std::vector<size_t> lights_;  // Which of the walk's.
  ShadowMaps fixed_maps_;
  ResolutionEstimator estimator_;
  ResolutionFigures figures_;
};

nlohmann::json ResolutionJson(const ResolutionFigures& figures);

/// The table for people.
std::string ResolutionTable(const ResolutionFigures& figures);

}  // namespace shadowfit
