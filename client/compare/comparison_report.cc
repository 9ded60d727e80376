#include "client/compare/comparison_report.h"

#include <algorithm>
#include <numbers>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/compare/comparison_summary.h"

namespace shadowfit {
namespace {

using Json = nlohmann::json;

Json JsonOf(const glm::dvec3& v) { return Json::array({v.x, v.y, v.z}); }
Json JsonOf(MapSize size) { return {{"width", size.width}, {"height", size.height}}; }

Json LightJson(const Light& light) {
  if (const auto* point = std::get_if<PointLight>(&light)) return {{"position", JsonOf(point->ws_position)}};
  if (const auto* sun = std::get_if<DirectionalLight>(&light)) {
    return {{"direction", JsonOf(sun->ws_direction)}};
  }
  const auto& spot = std::get<SpotLight>(light);
  return {{"position", JsonOf(spot.ws_position)}, {"direction", JsonOf(spot.ws_direction)}};
}

std::span<const LightRecord> RecordsOf(const Comparison& comparison, LightPlacement placement) {
  const auto begin = std::ranges::find(comparison.lights, placement, &LightRecord::placement);
  const auto end = std::find_if(begin, comparison.lights.end(),
                                [&](const LightRecord& r) { return r.placement != placement; });
  return {begin, end};
}

Json MethodsJson(std::span<const LightRecord> records, const Comparison& comparison) {
  const std::vector<MethodVariant>& methods = comparison.options.methods;
  const ComparisonSummary summary = Summarize(records, methods);
  Json result = Json::object();
  for (size_t m = 0; m < methods.size(); ++m) {
    const MethodStatistics& statistics = summary.methods[m];
    Json worst = Json::object();
    for (size_t by = 0; by < methods.size(); ++by) worst[methods[by].name] = statistics.worst_tenth_mean[by];
    Json beaten = Json::array();
    for (const size_t i : statistics.beaten_by_baseline) {
      std::string best;
      const int baseline = BestBaseline(records[i], methods, &best);
      Json entry = LightJson(records[i].light);
      entry["set"] = LightPlacementName(records[i].placement);
      entry["light"] = records[i].index;
      entry["view"] = records[i].view;
      entry["wrongPixels"] = records[i].methods[m].wrong_pixels;
      entry["bestBaseline"] = best;
      entry["bestBaselineWrongPixels"] = baseline;
      beaten.push_back(std::move(entry));
    }
    Json artefacts = {{"lights", statistics.artefact_lights},
                      {"acne", statistics.mean_acne},
                      {"detached", statistics.mean_detached},
                      {"jagged", statistics.mean_jagged},
                      {"flicker", statistics.mean_flicker}};
    result[methods[m].name] = {{"meanWrongPixels", statistics.mean_wrong_pixels},
                               {"worstTenPercent", std::move(worst)},
                               {"medianMilliseconds", statistics.median_milliseconds},
                               {"mapSize", JsonOf(methods[m].map_size)},
                               {"prediction",
                                {{"rankCorrelation", statistics.rank_correlation},
                                 {"ratioLowerQuartile", statistics.ratio_lower_quartile},
                                 {"ratioMedian", statistics.ratio_median},
                                 {"ratioUpperQuartile", statistics.ratio_upper_quartile}}},
                               {"lightsWorseThanBestBaseline", std::move(beaten)},
                               {"failuresAndFallbacks", statistics.failures_and_fallbacks},
                               {"artefacts", std::move(artefacts)}};
    if (statistics.certified_lights > 0) {
      result[methods[m].name]["certificates"] = {{"lights", statistics.certified_lights},
                                                 {"complete", statistics.complete_certificates},
                                                 {"tolerance", comparison.options.certify_tolerance},
                                                 {"medianSeconds", statistics.median_certify_seconds},
                                                 {"worstSeconds", statistics.worst_certify_seconds},
                                                 {"medianLeastGap", statistics.median_least_gap},
                                                 {"worstLeastGap", statistics.worst_least_gap},
                                                 {"medianMostGap", statistics.median_most_gap},
                                                 {"worstMostGap", statistics.worst_most_gap}};
    }
  }
  return result;
}

std::optional<size_t> IndexOf(std::span<const MethodVariant> methods, std::string_view name) {
  const auto found = std::ranges::find(methods, name, &MethodVariant::name);
  if (found == methods.end()) return std::nullopt;
  return static_cast<size_t>(found - methods.begin());
}

/// "1234 (+56.7 %)"; the percentage against `anchor` where there is one.
std::string Cell(double value, std::optional<double> anchor) {
  if (!anchor || *anchor <= 0.0) return absl::StrFormat("%.0f", value);
  return absl::StrFormat("%.0f (%+.1f %%)", value, 100.0 * (value / *anchor - 1.0));
}

std::string TableOfMeans(const ComparisonSummary& summary, std::span<const MethodVariant> methods,
                         std::optional<size_t> anchor) {
  std::string table = "| wrong pixels |";
  std::string rule = "| --- |";
  for (const MethodVariant& method : methods) {
    absl::StrAppend(&table, " ", method.name, " |");
    rule += " ---: |";
  }
  absl::StrAppend(&table, "\n", rule, "\n| all lights |");
  for (size_t m = 0; m < methods.size(); ++m) {
    const auto base = anchor ? std::optional(summary.methods[*anchor].mean_wrong_pixels) : std::nullopt;
    absl::StrAppend(&table, " ", Cell(summary.methods[m].mean_wrong_pixels, base), " |");
  }
  for (size_t by = 0; by < methods.size(); ++by) {
    absl::StrAppend(&table, "\n| worst 10 % by ", methods[by].name, " |");
    for (size_t m = 0; m < methods.size(); ++m) {
      const auto base = anchor ? std::optional(summary.methods[*anchor].worst_tenth_mean[by]) : std::nullopt;
      absl::StrAppend(&table, " ", Cell(summary.methods[m].worst_tenth_mean[by], base), " |");
    }
  }
  return table + "\n";
}

std::string TableOfMethods(const ComparisonSummary& summary, std::span<const MethodVariant> methods) {
  std::string table =
      "| method | map | median ms | worse than best baseline | rank correlation | predicted / true: "
      "quartiles "
      "| fallbacks |\n| --- | --- | ---: | ---: | ---: | --- | ---: |\n";
  for (size_t m = 0; m < methods.size(); ++m) {
    const MethodStatistics& s = summary.methods[m];
    absl::StrAppendFormat(
        &table, "| %s | %dx%d | %.3f | %s | %.3f | %.2f  %.2f  %.2f | %d |\n", methods[m].name,
        methods[m].map_size.width, methods[m].map_size.height, s.median_milliseconds,
        IsBaseline(methods[m]) ? "-"
                               : absl::StrFormat("%d (%.1f %%)", s.beaten_by_baseline.size(),
                                                 100.0 * double(s.beaten_by_baseline.size()) /
                                                     std::max<double>(1.0, double(summary.lights))),
        s.rank_correlation, s.ratio_lower_quartile, s.ratio_median, s.ratio_upper_quartile,
        s.failures_and_fallbacks);
  }
  return table;
}

std::string TableOfArtefacts(const ComparisonSummary& summary, std::span<const MethodVariant> methods) {
  if (methods.empty() || summary.methods[0].artefact_lights == 0) return "";
  std::string table = absl::StrFormat(
      "Pixels that a renderer gets wrong with 24 bits of depth and the safe bias, by cause, and pixels whose "
      "answer changes when the camera turns by a degree; mean of %d lights:\n\n"
      "| method | acne | detached | jagged | flicker |\n| --- | ---: | ---: | ---: | ---: |\n",
      summary.methods[0].artefact_lights);
  for (size_t m = 0; m < methods.size(); ++m) {
    const MethodStatistics& s = summary.methods[m];
    absl::StrAppendFormat(&table, "| %s | %.1f | %.1f | %.1f | %.1f |\n", methods[m].name, s.mean_acne,
                          s.mean_detached, s.mean_jagged, s.mean_flicker);
  }
  return table + "\n";
}

std::string TableOfCertificates(const ComparisonSummary& summary, const ComparisonOptions& options) {
  std::string rows;
  for (size_t m = 0; m < options.methods.size(); ++m) {
    const MethodStatistics& s = summary.methods[m];
    if (s.certified_lights == 0) continue;
    absl::StrAppendFormat(&rows, "| %s | %d of %d | %.2f, %.2f | %.2f %%, %.2f %% | %.2f %%, %.2f %% |\n",
                          options.methods[m].name, s.complete_certificates, s.certified_lights,
                          s.median_certify_seconds, s.worst_certify_seconds, 100.0 * s.median_least_gap,
                          100.0 * s.worst_least_gap, 100.0 * s.median_most_gap, 100.0 * s.worst_most_gap);
  }
  if (rows.empty()) return "";
  return absl::StrFormat(
             "How far the maps are from the best single map there is by the metric that they minimise, "
             "bounded by "
             "branch and bound to %g %%; medians and worst lights:\n\n"
             "| method | certified | seconds | above the best by at least | by at most |\n"
             "| --- | ---: | ---: | ---: | ---: |\n",
             100.0 * options.certify_tolerance) +
         rows + "\n";
}

std::string Section(const std::string& title, std::span<const LightRecord> records,
                    const Comparison& comparison) {
  const std::vector<MethodVariant>& methods = comparison.options.methods;
  const ComparisonSummary summary = Summarize(records, methods);
  std::string text = absl::StrFormat(
      "## %s: %d lights\n\nOf %d pixels a light, %.0f concern it and %.0f are in shadow in the mean.\n\n",
      title, summary.lights, comparison.options.screen.width * comparison.options.screen.height,
      summary.mean_concerned_pixels, summary.mean_shadowed_pixels);
  bool anchored = false;
  for (const char* name : {"paper", "default"}) {
    const std::optional<size_t> anchor = IndexOf(methods, name);
    if (!anchor) continue;
    anchored = true;
    absl::StrAppend(&text, "Against `", name, "`:\n\n", TableOfMeans(summary, methods, anchor), "\n");
  }
  if (!anchored) absl::StrAppend(&text, TableOfMeans(summary, methods, std::nullopt), "\n");
  absl::StrAppend(&text, TableOfMethods(summary, methods), "\n", TableOfArtefacts(summary, methods),
                  TableOfCertificates(summary, comparison.options));

  for (size_t m = 0; m < methods.size(); ++m) {
    const std::vector<size_t>& beaten = summary.methods[m].beaten_by_baseline;
    if (beaten.empty()) continue;
    absl::StrAppend(&text, "`", methods[m].name, "` is worse than the best baseline on:");
    constexpr size_t kListed = 20;
    for (size_t k = 0; k < std::min(kListed, beaten.size()); ++k) {
      const LightRecord& record = records[beaten[k]];
      std::string best;
      const int baseline = BestBaseline(record, methods, &best);
      absl::StrAppendFormat(&text, "%s %s %d (%d, %s %d)", k == 0 ? "" : ",",
                            LightPlacementName(record.placement), record.index,
                            record.methods[m].wrong_pixels, best, baseline);
    }
    if (beaten.size() > kListed) absl::StrAppendFormat(&text, " and %d more", beaten.size() - kListed);
    absl::StrAppend(&text, ".\n\n");
  }
  return text;
}

std::string TableOfTimes(const Comparison& comparison) {
  std::string text =
      "## Time of a frame\n\nMilliseconds from decoded frame to all matrices on one thread, of which "
      "sampling, which all lights share.\n\n| lights | map |";
  std::string rule = "| ---: | --- |";
  for (const MethodVariant& method : comparison.options.methods) {
    absl::StrAppend(&text, " ", method.name, " |");
    rule += " ---: |";
  }
  absl::StrAppend(&text, "\n", rule, "\n");
  for (const FrameTime& time : comparison.times) {
    absl::StrAppendFormat(&text, "| %d | %dx%d |", time.lights, time.map_size.width, time.map_size.height);
    for (const FrameTime::Stages& stages : time.methods) {
      absl::StrAppendFormat(&text, " %.2f (%.2f) |", stages.total, stages.sampling);
    }
    text += "\n";
  }
  return text + "\n";
}

Json TimesJson(const Comparison& comparison) {
  Json rows = Json::array();
  for (const FrameTime& time : comparison.times) {
    Json methods = Json::object();
    for (size_t m = 0; m < time.methods.size(); ++m) {
      methods[comparison.options.methods[m].name] = {{"milliseconds", time.methods[m].total},
                                                     {"samplingMilliseconds", time.methods[m].sampling}};
    }
    rows.push_back({{"lights", time.lights}, {"mapSize", JsonOf(time.map_size)}, {"methods", methods}});
  }
  return rows;
}

}  // namespace

Json StudyJson(const Comparison& comparison) {
  const ComparisonOptions& options = comparison.options;
  Json stand_points = Json::array();
  for (const StandPoint& stand_point : comparison.stand_points) {
    stand_points.push_back({{"eye", JsonOf(stand_point.ws_eye)}, {"target", JsonOf(stand_point.ws_target)}});
  }
  return {{"scene", comparison.scene},
          {"triangles", comparison.triangles},
          {"seed", options.seed},
          {"screen", JsonOf(options.screen)},
          {"samples", JsonOf(options.samples)},
          {"verticalFieldOfView", options.view.vertical_fov},
          {"nearPlane", options.view.near},
          {"farPlane", options.view.far},
          {"up", JsonOf(options.view.ws_up)},
          {"views", std::move(stand_points)}};
}

Json ReportJson(const Comparison& comparison) {
  Json sets = Json::object();
  for (const LightSet& set : comparison.options.sets) {
    const std::span<const LightRecord> records = RecordsOf(comparison, set.placement);
    sets[std::string(LightPlacementName(set.placement))] = {{"lights", records.size()},
                                                            {"methods", MethodsJson(records, comparison)}};
  }
  return {{"scene", comparison.scene},
          {"triangles", comparison.triangles},
          {"lights", comparison.lights.size()},
          {"methods", MethodsJson(comparison.lights, comparison)},
          {"sets", std::move(sets)},
          {"frameTimes", TimesJson(comparison)},
          {"study", StudyJson(comparison)}};
}

std::string ReportMarkdown(const Comparison& comparison) {
  const ComparisonOptions& options = comparison.options;
  std::string text = absl::StrFormat(
      "# Wrong pixels in %s\n\n%d triangles, screen %dx%d, samples %dx%d, %d view%s, camera's near plane at "
      "%g, vertical field of view %.0f degrees, seed %d. Truth by Embree rays.\n\n",
      comparison.scene, comparison.triangles, options.screen.width, options.screen.height,
      options.samples.width, options.samples.height, comparison.stand_points.size(),
      comparison.stand_points.size() == 1 ? "" : "s", options.view.near,
      options.view.vertical_fov * 180.0 / std::numbers::pi, options.seed);
  for (const LightSet& set : options.sets) {
    text += Section(std::string(LightPlacementName(set.placement)), RecordsOf(comparison, set.placement),
                    comparison);
  }
  if (options.sets.size() > 1) text += Section("all", comparison.lights, comparison);
  if (!comparison.times.empty()) text += TableOfTimes(comparison);
  return text;
}

}  // namespace shadowfit
