#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/demo/mask_study.h"
#include "client/demo/resolution_study.h"
#include "client/demo/walk_record.h"
#include "client/render/picture_pass.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

/// One frame as the report shows it.
struct ReportFrame {
  int frame = 0;
  Picture before;
  Picture after;
  Picture difference;
  Picture shadows_by_map;   ///< Of `after`.
  Picture shadows_by_mask;  ///< Exact.
  int wrong_before = 0;     ///< Wrong pixels of all lights.
  int wrong_after = 0;
};

/// A dimmed picture on which wrong pixels stand out: red where only `before` is wrong, blue where only
/// `after` is, white where both are.
Picture DifferencePicture(const Picture& picture, const std::vector<uint8_t>& wrong_before,
                          const std::vector<uint8_t>& wrong_after);

/// Left half of one picture, right half of another of the same size, a white line between them.
Picture SplitPicture(const Picture& left, const Picture& right);

/// A page that needs no other file: tables, curves over the frames, pictures before and after.
absl::StatusOr<std::string> ReportHtml(const std::string& scene, const std::vector<std::string>& light_names,
                                       const std::vector<WalkRecord>& records, MapSize map_size,
                                       const std::vector<ReportFrame>& frames, const std::string& before_name,
                                       const std::string& after_name, const ResolutionFigures& resolution,
                                       const MaskFigures& masks);

}  // namespace shadowfit
