#include "client/demo/walk_record.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "absl/strings/str_format.h"

namespace shadowfit {
namespace {

/// Round trips of the methods that a renderer would run with the service behind it.
std::vector<double> PipelinedRoundTrips(const std::vector<WalkRecord>& records) {
  std::vector<double> all;
  for (const WalkRecord& record : records) {
    if (record.latency > 0) all.insert(all.end(), record.round_trip_ms.begin(), record.round_trip_ms.end());
  }
  return all;
}

}  // namespace

void WalkRecord::AddMatrices(std::span<const LightView> lights) {
  std::vector<std::array<double, 16>>& of_frame = matrices.emplace_back();
  for (const LightView& light : lights) {
    std::array<double, 16>& entries = of_frame.emplace_back();
    for (size_t entry = 0; entry < 16; ++entry) {
      entries[entry] = light.clip_from_world[static_cast<int>(entry) / 4][static_cast<int>(entry) % 4];
    }
  }
}

int WalkRecord::FrameTotal(size_t frame) const {
  return std::accumulate(wrong_pixels[frame].begin(), wrong_pixels[frame].end(), 0);
}

double WalkRecord::MeanOfLight(size_t light) const {
  double sum = 0.0;
  for (const std::vector<int>& frame : wrong_pixels) sum += frame[light];
  return sum / static_cast<double>(wrong_pixels.size());
}

double WalkRecord::MeanPerFrame() const {
  double sum = 0.0;
  for (size_t frame = 0; frame < wrong_pixels.size(); ++frame) sum += FrameTotal(frame);
  return sum / static_cast<double>(wrong_pixels.size());
}

double WalkRecord::MeanPerLight() const {
  return MeanPerFrame() / static_cast<double>(wrong_pixels[0].size());
}

double Percentile(std::vector<double> values, double share) {
  if (values.empty()) return 0.0;
  const auto rank = static_cast<size_t>(std::ceil(share * static_cast<double>(values.size())));
  const size_t index = std::clamp<size_t>(rank, 1, values.size()) - 1;
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(index), values.end());
  return values[index];
}

double WorstTenPercent(const WalkRecord& record, const WalkRecord& ranked_by) {
  std::vector<std::pair<int, int>> ranked;  // Wrong pixels of the ranking method, and of this one.
  for (size_t frame = 0; frame < record.wrong_pixels.size(); ++frame) {
    for (size_t light = 0; light < record.wrong_pixels[frame].size(); ++light) {
      ranked.emplace_back(ranked_by.wrong_pixels[frame][light], record.wrong_pixels[frame][light]);
    }
  }
  std::stable_sort(ranked.begin(), ranked.end(),
                   [](const auto& a, const auto& b) { return a.first > b.first; });
  ranked.resize((ranked.size() + 9) / 10);
  double sum = 0.0;
  for (const auto& [ranking, wrong] : ranked) sum += wrong;
  return sum / static_cast<double>(ranked.size());
}

nlohmann::json DemoJson(const std::string& scene, const std::vector<std::string>& light_names,
                        const std::vector<WalkRecord>& records) {
  nlohmann::json document;
  document["scene"] = scene;
  document["lights"] = light_names.size();
  document["lightNames"] = light_names;
  document["frames"] = records.empty() ? 0 : records[0].wrong_pixels.size();
  nlohmann::json& methods = document["methods"] = nlohmann::json::object();
  for (const WalkRecord& record : records) {
    nlohmann::json& method = methods[record.name];
    method["meanWrongPixels"] = record.MeanPerLight();
    method["meanWrongPixelsPerFrame"] = record.MeanPerFrame();
    for (size_t light = 0; light < light_names.size(); ++light) {
      method["meanWrongPixelsOfLight"].push_back(record.MeanOfLight(light));
    }
    for (const WalkRecord& ranked_by : records) {
      method["worstTenPercent"][ranked_by.name] = WorstTenPercent(record, ranked_by);
    }
    method["medianMilliseconds"] = Percentile(record.optimize_ms, 0.5);
    method["latencyFrames"] = record.latency;
    if (!record.frame_ms.empty()) method["framesPerSecond"] = 1e3 / Percentile(record.frame_ms, 0.5);
    method["wrongPixels"] = record.wrong_pixels;
  }
  const std::vector<double> round_trips = PipelinedRoundTrips(records);
  document["roundTripMilliseconds"] = {{"p50", Percentile(round_trips, 0.5)},
                                       {"p95", Percentile(round_trips, 0.95)}};
  return document;
}

std::string DemoTable(const std::vector<std::string>& light_names, const std::vector<WalkRecord>& records) {
  std::string text = absl::StrFormat("Wrong pixels against shadow rays, mean of %d frames\n\n%-14s",
                                     records[0].wrong_pixels.size(), "method");
  for (const std::string& name : light_names) absl::StrAppendFormat(&text, " %15s", name);
  absl::StrAppendFormat(&text, " %12s  %s\n", "all lights", "matrices from");
  for (const WalkRecord& record : records) {
    absl::StrAppendFormat(&text, "%-14s", record.name);
    for (size_t light = 0; light < light_names.size(); ++light) {
      absl::StrAppendFormat(&text, " %15.0f", record.MeanOfLight(light));
    }
    absl::StrAppendFormat(
        &text, " %12.0f  %s\n", record.MeanPerFrame(),
        record.latency == 0 ? "the same frame" : absl::StrFormat("%d frames before", record.latency));
  }
  absl::StrAppendFormat(&text, "\nMedian milliseconds\n\n%-14s %18s %12s %10s %12s\n", "method",
                        "optimizer a light", "samples", "wait", "shadow maps");
  for (const WalkRecord& record : records) {
    absl::StrAppendFormat(&text, "%-14s %18.3f %12.1f %10.2f %12.1f\n", record.name,
                          Percentile(record.optimize_ms, 0.5), Percentile(record.samples_ms, 0.5),
                          Percentile(record.wait_ms, 0.5), Percentile(record.shadow_maps_ms, 0.5));
  }
  const std::vector<double> round_trips = PipelinedRoundTrips(records);
  absl::StrAppendFormat(&text, "\nRound trip to the service: p50 %.2f ms, p95 %.2f ms\n",
                        Percentile(round_trips, 0.5), Percentile(round_trips, 0.95));
  for (const WalkRecord& record : records) {
    if (record.frame_ms.empty()) continue;
    const double frame_ms = Percentile(record.frame_ms, 0.5);
    absl::StrAppendFormat(&text, "Frames with %s: %.1f ms (%.1f ms of them the picture), %.1f a second\n",
                          record.name, frame_ms, Percentile(record.picture_ms, 0.5), 1e3 / frame_ms);
  }
  return text;
}

nlohmann::json MatricesJson(const std::string& scene, const std::vector<WalkRecord>& records) {
  nlohmann::json document;
  document["scene"] = scene;
  for (const WalkRecord& record : records) document["methods"][record.name] = record.matrices;
  return document;
}

}  // namespace shadowfit
