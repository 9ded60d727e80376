#include "client/demo/report.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_replace.h"
#include "client/demo/output_files.h"

namespace shadowfit {
namespace {

constexpr const char* kColors[] = {"#8d6e63", "#d9534f", "#e0a030", "#2f7fd0",
                                   "#5a9e4b", "#8b5fbf", "#555555"};

std::string Escaped(const std::string& text) {
  return absl::StrReplaceAll(text, {{"&", "&amp;"}, {"<", "&lt;"}, {">", "&gt;"}, {"\"", "&quot;"}});
}

absl::StatusOr<std::string> DataUrl(const Picture& picture) {
  const absl::StatusOr<std::string> jpeg = EncodeJpeg(picture);
  if (!jpeg.ok()) return jpeg.status();
  return absl::StrCat("data:image/jpeg;base64,", absl::Base64Escape(*jpeg));
}

/// A round number not below `value`, for the top of an axis.
double AxisTop(double value) {
  if (!(value > 0.0)) return 1.0;
  const double power = std::pow(10.0, std::floor(std::log10(value)));
  for (const double step : {1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0}) {
    if (step * power >= value) return step * power;
  }
  return 10.0 * power;
}

/// One line of a chart.
struct Series {
  const char* color;
  std::vector<double> values;  // One a frame.
};

/// Lines over the numbers of `frames`, of which there is at least one.
std::string Chart(const std::string& title, const std::vector<Series>& series, const std::vector<int>& frames,
                  int width, int height) {
  constexpr int kLeft = 52;
  constexpr int kBottom = 24;
  constexpr int kTop = 26;
  double largest = 0.0;
  for (const Series& line : series) {
    for (const double value : line.values) largest = std::max(largest, value);
  }
  const double top = AxisTop(largest);
  const int first = frames.front();
  const int last = frames.back();
  const auto x = [&](int frame) {
    return kLeft +
           (width - kLeft - 8.0) * (last > first ? static_cast<double>(frame - first) / (last - first) : 0.5);
  };
  const auto y = [&](double v) { return height - kBottom - (height - kBottom - kTop) * v / top; };
  std::string svg =
      absl::StrFormat("<svg viewBox=\"0 0 %d %d\" role=\"img\"><text x=\"%d\" y=\"16\" class=\"t\">%s</text>",
                      width, height, kLeft, Escaped(title));
  for (int i = 0; i <= 4; ++i) {
    const double v = top * i / 4;
    absl::StrAppendFormat(&svg,
                          "<line x1=\"%d\" x2=\"%d\" y1=\"%.1f\" y2=\"%.1f\" class=\"g\"/>"
                          "<text x=\"%d\" y=\"%.1f\" class=\"a\" text-anchor=\"end\">%.*f</text>",
                          kLeft, width - 8, y(v), y(v), kLeft - 6, y(v) + 4, top < 8.0 ? 1 : 0, v);
  }
  absl::StrAppendFormat(&svg, "<text x=\"%d\" y=\"%d\" class=\"a\">frame %d</text>", kLeft, height - 6,
                        first);
  absl::StrAppendFormat(&svg, "<text x=\"%d\" y=\"%d\" class=\"a\" text-anchor=\"end\">%d</text>", width - 8,
                        height - 6, last);
  for (const Series& line : series) {
    absl::StrAppendFormat(&svg, "<polyline fill=\"none\" stroke-width=\"2\" stroke=\"%s\" points=\"",
                          line.color);
    for (size_t i = 0; i < frames.size(); ++i) {
      absl::StrAppendFormat(&svg, "%.1f,%.1f ", x(frames[i]), y(line.values[i]));
    }
    absl::StrAppend(&svg, "\"/>");
  }
  return absl::StrCat(svg, "</svg>");
}

/// Curves of one quantity over the frames, a line a method. `value(record, frame)`.
template <typename Value>
std::string Curves(const std::string& title, const std::vector<WalkRecord>& records, int width, int height,
                   const Value& value) {
  std::vector<int> frames(records[0].wrong_pixels.size());
  std::iota(frames.begin(), frames.end(), 0);
  std::vector<Series> series;
  for (size_t m = 0; m < records.size(); ++m) {
    Series& line = series.emplace_back(Series{kColors[m % std::size(kColors)], {}});
    for (size_t frame = 0; frame < frames.size(); ++frame) line.values.push_back(value(records[m], frame));
  }
  return Chart(title, series, frames, width, height);
}

std::string LegendOf(const std::vector<std::pair<const char*, std::string>>& entries) {
  std::string html = "<p class=\"legend\">";
  for (const auto& [color, text] : entries) {
    absl::StrAppendFormat(&html, "<span><i style=\"background:%s\"></i>%s</span>", color, Escaped(text));
  }
  return absl::StrCat(html, "</p>");
}

std::string Legend(const std::vector<WalkRecord>& records) {
  std::vector<std::pair<const char*, std::string>> entries;
  for (size_t m = 0; m < records.size(); ++m)
    entries.emplace_back(kColors[m % std::size(kColors)], records[m].name);
  return LegendOf(entries);
}

/// Figures 3 and 4 of "Resolution Estimation for Shadow Mapping".
std::string ResolutionSection(const ResolutionFigures& figures) {
  constexpr const char* kPublished = "#8d6e63";
  constexpr const char* kReduced = "#2f7fd0";
  constexpr const char* kFixed = "#d9534f";
  if (figures.frames.empty() || figures.lights.empty()) return "";
  std::string html = absl::StrFormat(
      "<h2>How large the maps must be</h2><p>Estimated from each picture's depth (%dx%d): the map that gives "
      "every pixel a whole texel, and the one that gives it to 99 %% of them; the larger of width and "
      "height, "
      "at most %d. The share is what the cropped map covers of the light's ordinary frustum. Times are those "
      "of "
      "the software renderer: the estimate and the map of 99 %% against a fixed %dx%d map.</p>",
      figures.screen.width, figures.screen.height, figures.limit, figures.limit, figures.limit);
  absl::StrAppend(&html,
                  LegendOf({{kPublished, "every pixel"},
                            {kReduced, "99 % of the pixels"},
                            {kFixed, absl::StrFormat("fixed %dx%d", figures.limit, figures.limit)}}),
                  "<div class=\"grid\">");
  for (const ResolutionRecord& record : figures.lights) {
    std::vector<double> total_ms;
    for (size_t i = 0; i < figures.frames.size(); ++i)
      total_ms.push_back(record.estimate_ms[i] + record.reduced_ms[i]);
    absl::StrAppend(&html,
                    Chart(absl::StrCat(record.light, ": texels needed"),
                          {{kPublished, record.recommended}, {kReduced, record.recommended_99}},
                          figures.frames, 500, 200),
                    Chart(absl::StrCat(record.light, ": share of the frustum, %"),
                          {{kReduced, record.share_used}}, figures.frames, 500, 200),
                    Chart(absl::StrCat(record.light, ": milliseconds"),
                          {{kReduced, total_ms}, {kFixed, record.fixed_ms}}, figures.frames, 500, 200),
                    "<p></p>");
  }
  return absl::StrCat(html, "</div>");
}

std::string WrongPixelTable(const std::vector<std::string>& light_names,
                            const std::vector<WalkRecord>& records) {
  std::string html = "<table><tr><th>method</th>";
  for (const std::string& name : light_names) absl::StrAppendFormat(&html, "<th>%s</th>", Escaped(name));
  absl::StrAppend(&html, "<th>all lights</th><th>matrices from</th><th>optimizer, ms a light</th></tr>");
  for (const WalkRecord& record : records) {
    absl::StrAppendFormat(&html, "<tr><td>%s</td>", Escaped(record.name));
    for (size_t light = 0; light < light_names.size(); ++light) {
      absl::StrAppendFormat(&html, "<td>%.0f</td>", record.MeanOfLight(light));
    }
    absl::StrAppendFormat(
        &html, "<td><b>%.0f</b></td><td>%s</td><td>%.3f</td></tr>", record.MeanPerFrame(),
        record.latency == 0 ? "the same frame" : absl::StrFormat("%d frames before", record.latency),
        Percentile(record.optimize_ms, 0.5));
  }
  return absl::StrCat(html, "</table>");
}

/// A picture over which another one's left part is drawn, up to a bar that can be dragged.
std::string DraggedPair(const std::string& left_url, const std::string& left_name,
                        const std::string& right_url, const std::string& right_name) {
  return absl::StrCat("<div class=\"pair\"><img alt=\"", Escaped(right_name), "\" src=\"", right_url,
                      "\"><img class=\"before\" alt=\"", Escaped(left_name), "\" src=\"", left_url,
                      "\"><b class=\"l\">", Escaped(left_name), "</b><b class=\"r\">", Escaped(right_name),
                      "</b><input type=\"range\" aria-label=\"where the pictures meet\" value=\"50\"></div>");
}

/// Exact masks beside the maps, and the shadows of the middle one of the frames.
absl::StatusOr<std::string> MaskSection(const MaskFigures& figures, const std::vector<ReportFrame>& frames,
                                        const std::string& map_name) {
  if (figures.frames.empty() || frames.empty()) return std::string();
  std::string html = absl::StrFormat(
      "<h2>Without aliasing</h2><p>Masks of the same pictures: for every pixel the answer of its shadow ray, "
      "from the scene that was uploaded once (%.2f s). Means of %d frames; undecided are pixels for which "
      "the "
      "depth buffer's rounding leaves it open.</p><table><tr><th>light</th><th>wrong by map</th><th>wrong by "
      "mask</th><th>undecided</th><th>mask, ms</th></tr>",
      figures.upload_seconds, figures.frames.size());
  for (const MaskRecord& record : figures.lights) {
    absl::StrAppendFormat(&html, "<tr><td>%s</td><td>%.0f</td><td>%.1f</td><td>%.1f</td><td>%.1f</td></tr>",
                          Escaped(record.light), Mean(record.wrong_by_map), Mean(record.wrong_by_mask),
                          Mean(record.undecided), Mean(record.mask_ms));
  }
  const ReportFrame& shown = frames[frames.size() / 2];
  const absl::StatusOr<std::string> by_map = DataUrl(shown.shadows_by_map);
  if (!by_map.ok()) return by_map.status();
  const absl::StatusOr<std::string> by_mask = DataUrl(shown.shadows_by_mask);
  if (!by_mask.ok()) return by_mask.status();
  return absl::StrCat(html, "</table><p></p>", DraggedPair(*by_map, map_name, *by_mask, "mask"));
}

constexpr char kHead[] = R"(<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>shadowfit</title><style>
:root{color-scheme:light dark}
body{font:16px/1.5 system-ui,sans-serif;max-width:1060px;margin:2rem auto;padding:0 1rem}
h1,h2{line-height:1.2}h2{margin-top:2.5rem}
table{border-collapse:collapse;font-variant-numeric:tabular-nums}
td,th{padding:.25rem .8rem;text-align:right;border-bottom:1px solid #8884}td:first-child,th:first-child{text-align:left}
.legend span{margin-right:1.2rem}.legend i{display:inline-block;width:1.4em;height:.35em;margin-right:.4em;vertical-align:middle}
svg{width:100%;height:auto}svg text{fill:currentColor}.t{font:600 13px system-ui}.a{font:11px system-ui}.g{stroke:#8884}
.grid{display:grid;grid-template-columns:1fr 1fr;gap:0 1rem}
.pair{position:relative;line-height:0;user-select:none}.pair img{width:100%;display:block}
.pair .before{position:absolute;inset:0;clip-path:inset(0 calc(100% - var(--at,50%)) 0 0)}
.pair::after{content:"";position:absolute;top:0;bottom:0;left:var(--at,50%);width:2px;background:#fff;box-shadow:0 0 3px #000}
.pair input{position:absolute;inset:0;width:100%;height:100%;opacity:0;cursor:ew-resize;margin:0}
.pair b{position:absolute;top:.6rem;font:600 13px/1 system-ui;color:#fff;background:#0009;padding:.4em .6em;border-radius:3px;pointer-events:none}
.pair b.l{left:.6rem}.pair b.r{right:.6rem}
img.diff{width:100%;margin-top:.5rem}
</style></head><body>
)";

constexpr char kTail[] = R"(<script>
for (const pair of document.querySelectorAll('.pair'))
  pair.querySelector('input').addEventListener('input', e => pair.style.setProperty('--at', e.target.value + '%'));
</script></body></html>
)";

}  // namespace

Picture DifferencePicture(const Picture& picture, const std::vector<uint8_t>& wrong_before,
                          const std::vector<uint8_t>& wrong_after) {
  Picture difference{picture.width, picture.height, {}};
  difference.rgb.reserve(picture.rgb.size());
  for (size_t i = 0; i < wrong_before.size(); ++i) {
    const uint8_t* p = &picture.rgb[3 * i];
    const auto grey = static_cast<uint8_t>((p[0] * 2 + p[1] * 5 + p[2]) / 8 / 3);
    if (wrong_before[i] != 0 && wrong_after[i] != 0) {
      difference.rgb.insert(difference.rgb.end(), {255, 255, 255});
    } else if (wrong_before[i] != 0) {
      difference.rgb.insert(difference.rgb.end(), {255, 70, 50});
    } else if (wrong_after[i] != 0) {
      difference.rgb.insert(difference.rgb.end(), {70, 160, 255});
    } else {
      difference.rgb.insert(difference.rgb.end(), {grey, grey, grey});
    }
  }
  return difference;
}

Picture SplitPicture(const Picture& left, const Picture& right) {
  Picture split = right;
  const auto width = static_cast<size_t>(split.width);
  for (size_t y = 0; y < static_cast<size_t>(split.height); ++y) {
    const auto row = static_cast<std::ptrdiff_t>(3 * y * width);
    const auto middle = row + static_cast<std::ptrdiff_t>(3 * (width / 2));
    std::copy(left.rgb.begin() + row, left.rgb.begin() + middle, split.rgb.begin() + row);
    std::fill_n(split.rgb.begin() + middle, 3, uint8_t{255});
  }
  return split;
}

absl::StatusOr<std::string> ReportHtml(const std::string& scene, const std::vector<std::string>& light_names,
                                       const std::vector<WalkRecord>& records, MapSize map_size,
                                       const std::vector<ReportFrame>& frames, const std::string& before_name,
                                       const std::string& after_name, const ResolutionFigures& resolution,
                                       const MaskFigures& masks) {
  std::string html = kHead;
  absl::StrAppendFormat(
      &html,
      "<h1>shadowfit: %s</h1><p>A walk of %d frames under %d lights, one %dx%d shadow map each. A pixel "
      "is wrong where the shadow map's answer differs from a shadow ray's.%s</p>",
      Escaped(scene), records[0].wrong_pixels.size(), light_names.size(), map_size.width, map_size.height,
      scene == "sterngarten" ? " The scene is the Sterngarten in Vienna, &copy; Georg Zotti, "
                               "<a href=\"https://creativecommons.org/licenses/by-sa/4.0/\">CC BY-SA "
                               "4.0</a>; so are these pictures of it."
                             : "");
  absl::StrAppend(&html, "<h2>Wrong pixels, mean of all frames</h2>", WrongPixelTable(light_names, records));
  const std::vector<double> round_trips = [&] {
    std::vector<double> all;
    for (const WalkRecord& r : records) {
      if (r.latency > 0) all.insert(all.end(), r.round_trip_ms.begin(), r.round_trip_ms.end());
    }
    return all;
  }();
  absl::StrAppendFormat(&html, "<p>Round trip to the service: median %.2f ms, 95 %% within %.2f ms.</p>",
                        Percentile(round_trips, 0.5), Percentile(round_trips, 0.95));

  absl::StrAppend(
      &html, "<h2>Over the frames</h2>", Legend(records),
      Curves("wrong pixels, all lights", records, 1000, 320,
             [](const WalkRecord& r, size_t frame) { return static_cast<double>(r.FrameTotal(frame)); }),
      "<div class=\"grid\">");
  for (size_t light = 0; light < light_names.size(); ++light) {
    absl::StrAppend(&html,
                    Curves(light_names[light], records, 500, 200, [light](const WalkRecord& r, size_t frame) {
                      return static_cast<double>(r.wrong_pixels[frame][light]);
                    }));
  }
  absl::StrAppend(&html, "</div>", ResolutionSection(resolution));
  const absl::StatusOr<std::string> mask_section = MaskSection(masks, frames, after_name);
  if (!mask_section.ok()) return mask_section.status();
  absl::StrAppend(&html, *mask_section);

  absl::StrAppendFormat(
      &html,
      "<h2>Before and after</h2><p>Drag across a picture. Below it, the wrong pixels: red where only %s is "
      "wrong, blue where only %s is, white where both are.</p>",
      Escaped(before_name), Escaped(after_name));
  for (const ReportFrame& frame : frames) {
    const absl::StatusOr<std::string> before = DataUrl(frame.before);
    if (!before.ok()) return before.status();
    const absl::StatusOr<std::string> after = DataUrl(frame.after);
    if (!after.ok()) return after.status();
    const absl::StatusOr<std::string> difference = DataUrl(frame.difference);
    if (!difference.ok()) return difference.status();
    absl::StrAppendFormat(&html, "<h3>Frame %d: %d wrong pixels before, %d after</h3>", frame.frame,
                          frame.wrong_before, frame.wrong_after);
    absl::StrAppend(&html, DraggedPair(*before, before_name, *after, after_name),
                    "<img class=\"diff\" alt=\"wrong pixels\" src=\"", *difference, "\">");
  }
  return absl::StrCat(html, kTail);
}

}  // namespace shadowfit
