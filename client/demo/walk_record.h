#pragma once

#include <array>
#include <nlohmann/json.hpp>
#include <numeric>
#include <span>
#include <string>
#include <vector>

#include "client/render/light_block.h"

namespace shadowfit {

/// What one method did over a walk.
struct WalkRecord {
  std::string name;
  int latency = 0;  ///< Frames between what the service saw and what was drawn with it.
  std::vector<std::vector<int>> wrong_pixels;  ///< [frame][light], against shadow rays.
  std::vector<double> optimize_ms;             ///< One a light and frame.
  std::vector<double> round_trip_ms;           ///< One a frame.
  std::vector<double> samples_ms;              ///< One a frame, as all that follow.
  std::vector<double> wait_ms;
  std::vector<double> shadow_maps_ms;
  std::vector<double> picture_ms;  ///< Empty where no pictures were drawn.
  std::vector<double> frame_ms;    ///< All of the above; empty where no pictures were drawn.
  std::vector<std::vector<std::array<double, 16>>> matrices;  ///< [frame][light], column-major.

  void AddMatrices(std::span<const LightView> lights);

  int FrameTotal(size_t frame) const;
  double MeanOfLight(size_t light) const;
  double MeanPerLight() const;  ///< Mean over frames and lights.
  double MeanPerFrame() const;  ///< Mean over frames of the sum over lights.
};

/// 0 without values.
template <typename T>
double Mean(const std::vector<T>& values) {
  return values.empty()
             ? 0.0
             : std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

/// Value below which a share of the values lies (nearest rank); 0 without values.
double Percentile(std::vector<double> values, double share);

/// Mean wrong pixels of `record` over the tenth of all (frame, light) pairs that `ranked_by` gets most wrong:
/// the papers' question how a method does where another one fails.
double WorstTenPercent(const WalkRecord& record, const WalkRecord& ranked_by);

/// The document that `demo --json` prints.
nlohmann::json DemoJson(const std::string& scene, const std::vector<std::string>& light_names,
                        const std::vector<WalkRecord>& records);

/// The table for people.
std::string DemoTable(const std::vector<std::string>& light_names, const std::vector<WalkRecord>& records);

/// All matrices, exact to the last bit, so that two runs can be compared.
nlohmann::json MatricesJson(const std::string& scene, const std::vector<WalkRecord>& records);

}  // namespace shadowfit
