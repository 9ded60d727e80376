#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
#include "client/compare/comparison_report.h"

namespace shadowfit {
namespace {

constexpr const char* kColors[] = {"#1b6ac9", "#d1495b", "#2f9e6e", "#e08e1b",
                                   "#7a5cc2", "#0f8b9d", "#8d6e63", "#555555"};
constexpr double kWidth = 640.0;
constexpr double kHeight = 360.0;
constexpr double kMargin = 48.0;

const char* Color(size_t method) { return kColors[method % std::size(kColors)]; }

std::string Escape(std::string_view text) {
  return absl::StrReplaceAll(std::string(text), {{"&", "&amp;"}, {"<", "&lt;"}, {">", "&gt;"}});
}

/// A decimal logarithmic axis from `low` to `high`, both powers of ten.
struct LogAxis {
  double low = 1.0;
  double high = 10.0;
  double At(double value) const {
    const double clamped = std::clamp(value, low, high);
    return std::log(clamped / low) / std::log(high / low);
  }
  std::vector<double> Decades() const {
    std::vector<double> decades = {low};
    while (decades.back() < 0.5 * high) decades.push_back(10.0 * decades.back());
    return decades;
  }
};

LogAxis AxisFor(double largest) {
  return {1.0, std::pow(10.0, std::ceil(std::log10(std::max(10.0, largest))))};
}

double PlotX(double share) { return kMargin + share * (kWidth - 2.0 * kMargin); }
double PlotY(double share) { return kHeight - kMargin - share * (kHeight - 2.0 * kMargin); }

std::string Text(double x, double y, const char* anchor, std::string_view text) {
  return absl::StrFormat("<text x='%.1f' y='%.1f' text-anchor='%s'>%s</text>", x, y, anchor,
                         Escape(std::string(text)));
}

std::string Frame(const LogAxis* x_axis, const LogAxis& y_axis, const char* x_title, const char* y_title) {
  std::string svg = absl::StrFormat("<svg viewBox='0 0 %.0f %.0f' role='img'>", kWidth, kHeight);
  const auto line = [&](double x0, double y0, double x1, double y1) {
    absl::StrAppendFormat(&svg, "<line class='grid' x1='%.1f' y1='%.1f' x2='%.1f' y2='%.1f'/>", PlotX(x0),
                          PlotY(y0), PlotX(x1), PlotY(y1));
  };
  for (const double v : y_axis.Decades()) {
    line(0.0, y_axis.At(v), 1.0, y_axis.At(v));
    svg += Text(kMargin - 6.0, PlotY(y_axis.At(v)) + 4.0, "end", absl::StrFormat("%.0f", v));
  }
  for (const double v : x_axis != nullptr ? x_axis->Decades() : std::vector<double>()) {
    line(x_axis->At(v), 0.0, x_axis->At(v), 1.0);
    svg += Text(PlotX(x_axis->At(v)), kHeight - kMargin + 16.0, "middle", absl::StrFormat("%.0f", v));
  }
  svg += Text(0.5 * kWidth, kHeight - 8.0, "middle", x_title);
  svg += Text(8.0, kMargin - 12.0, "start", y_title);
  return svg;
}

std::string Legend(const Comparison& comparison) {
  std::string html = "<p class='legend'>";
  for (size_t m = 0; m < comparison.options.methods.size(); ++m) {
    absl::StrAppendFormat(&html, "<span><i style='background:%s'></i>%s</span>", Color(m),
                          Escape(comparison.options.methods[m].name));
  }
  return html + "</p>";
}

double LargestCount(const Comparison& comparison) {
  double largest = 1.0;
  for (const LightRecord& light : comparison.lights) {
    for (const MethodRecord& record : light.methods) {
      largest = std::max({largest, double(record.wrong_pixels), record.predicted_pixels});
    }
  }
  return largest;
}

/// Every method's counts in rising order: a curve below another is better throughout.
std::string RankedCurves(const Comparison& comparison) {
  const LogAxis axis = AxisFor(LargestCount(comparison));
  std::string svg = Frame(nullptr, axis, "lights, each method's best first", "wrong pixels");
  for (size_t m = 0; m < comparison.options.methods.size(); ++m) {
    std::vector<int> wrong;
    wrong.reserve(comparison.lights.size());
    for (const LightRecord& light : comparison.lights) wrong.push_back(light.methods[m].wrong_pixels);
    std::ranges::sort(wrong);
    absl::StrAppendFormat(&svg, "<polyline fill='none' stroke-width='1.6' stroke='%s' points='", Color(m));
    for (size_t i = 0; i < wrong.size(); ++i) {
      const double share = wrong.size() > 1 ? double(i) / double(wrong.size() - 1) : 0.5;
      absl::StrAppendFormat(&svg, "%.1f,%.1f ", PlotX(share), PlotY(axis.At(wrong[i])));
    }
    svg += "'/>";
  }
  return svg + "</svg>";
}

std::string PredictionScatter(const Comparison& comparison) {
  const LogAxis axis = AxisFor(LargestCount(comparison));
  std::string svg = Frame(&axis, axis, "predicted wrong pixels", "true wrong pixels");
  absl::StrAppendFormat(&svg, "<line class='ideal' x1='%.1f' y1='%.1f' x2='%.1f' y2='%.1f'/>", PlotX(0),
                        PlotY(0), PlotX(1), PlotY(1));
  for (const LightRecord& light : comparison.lights) {
    for (size_t m = 0; m < light.methods.size(); ++m) {
      absl::StrAppendFormat(&svg, "<circle r='1.8' cx='%.1f' cy='%.1f' fill='%s' fill-opacity='0.5'/>",
                            PlotX(axis.At(light.methods[m].predicted_pixels)),
                            PlotY(axis.At(light.methods[m].wrong_pixels)), Color(m));
    }
  }
  return svg + "</svg>";
}

/// The few forms of Markdown that ReportMarkdown writes: headings, tables, paragraphs and `code`.
std::string HtmlFromMarkdown(const std::string& markdown) {
  std::string html;
  bool in_table = false;
  bool code = false;
  for (const std::string& raw : std::vector<std::string>(absl::StrSplit(markdown, '\n'))) {
    std::string line;
    for (const char c : Escape(raw)) {
      if (c != '`') {
        line += c;
        continue;
      }
      line += code ? "</code>" : "<code>";
      code = !code;
    }
    const bool is_row = line.starts_with("|");
    if (is_row && line.find("---") != std::string::npos) continue;
    if (is_row && !in_table) html += "<table>";
    if (!is_row && in_table) html += "</table>";
    if (is_row) {
      const char* tag = in_table ? "td" : "th";
      std::vector<std::string> cells = absl::StrSplit(line, '|');
      html += "<tr>";
      for (size_t i = 1; i + 1 < cells.size(); ++i)
        absl::StrAppendFormat(&html, "<%s>%s</%s>", tag, cells[i], tag);
      html += "</tr>\n";
    } else if (line.starts_with("## ")) {
      absl::StrAppend(&html, "<h2>", line.substr(3), "</h2>\n");
    } else if (line.starts_with("# ")) {
      absl::StrAppend(&html, "<h1>", line.substr(2), "</h1>\n");
    } else if (!line.empty()) {
      absl::StrAppend(&html, "<p>", line, "</p>\n");
    }
    in_table = is_row;
  }
  return html;
}

}  // namespace

std::string ReportHtml(const Comparison& comparison) {
  return absl::StrCat(
      "<!doctype html><html lang='en'><head><meta charset='utf-8'><title>shadowfit compare: ",
      Escape(comparison.scene),
      "</title><style>body{font:15px/1.5 system-ui,sans-serif;max-width:1100px;margin:2em auto;padding:0 1em;"
      "color:#222}table{border-collapse:collapse;margin:1em 0;font-size:13px}td,th{border-bottom:1px solid "
      "#ddd;padding:.3em .7em;text-align:right}td:first-child,th:first-child{text-align:left}svg{width:100%;"
      "max-width:760px;font:11px sans-serif}.grid{stroke:#ddd}.ideal{stroke:#999;stroke-dasharray:4 3}"
      ".legend span{margin-right:1.2em}.legend i{display:inline-block;width:.8em;height:.8em;"
      "margin-right:.35em}</style></head><body>",
      HtmlFromMarkdown(ReportMarkdown(comparison)), "<h2>Wrong pixels, ranked</h2>", Legend(comparison),
      RankedCurves(comparison), "<h2>Prediction against truth</h2>", Legend(comparison),
      PredictionScatter(comparison), "</body></html>\n");
}

}  // namespace shadowfit
