#pragma once

#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <tuple>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/compare/comparison.h"

namespace shadowfit {

/// Keeps a comparison's results in a folder: study.json says what is compared, lights.jsonl has one line a
/// light and method. An interrupted run loses at most the light at work, and a later run with more methods
/// or lights adds to what is there.
class RecordStore {
 public:
  /// What one line says.
  struct Line {
    LightPlacement placement = LightPlacement::kNear;
    int index = 0;
    std::string method;
    int concerned_pixels = 0;
    int shadowed_pixels = 0;
    MethodRecord record;
  };

  /// Makes the folder, or reads what it holds. FailedPrecondition where its study.json differs from `study`
  /// (the message names the first entry that does); a broken last line is dropped.
  static absl::StatusOr<RecordStore> Open(const std::filesystem::path& folder, const nlohmann::json& study);

  const Line* Find(LightPlacement placement, int index, const std::string& method) const;
  absl::Status Append(const Line& line);

 private:
  std::map<std::tuple<LightPlacement, int, std::string>, Line> lines_;
  std::filesystem::path path_;
  std::ofstream file_;
};

}  // namespace shadowfit
