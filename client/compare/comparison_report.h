#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "client/compare/comparison.h"

namespace shadowfit {

/// What is compared, without methods and results: comparisons with the same study may share a folder.
nlohmann::json StudyJson(const Comparison& comparison);

/// {"scene", "lights", "methods": {NAME: {"meanWrongPixels", "worstTenPercent": {RANKED_BY: mean},
/// "medianMilliseconds", ...}}, "sets": {KIND: {"lights", "methods"}}, "frameTimes", "study"}; the outer
/// methods are over all lights together.
nlohmann::json ReportJson(const Comparison& comparison);

/// Tables for people, in Markdown: TR-07-07's Table 1 for each set of lights and for all together.
std::string ReportMarkdown(const Comparison& comparison);

/// The same with curves, as one page that needs no other file.
std::string ReportHtml(const Comparison& comparison);

}  // namespace shadowfit
