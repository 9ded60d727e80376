#include "client/compare/comparison_summary.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace shadowfit {
namespace {

/// Linear interpolation between order statistics; 0 of nothing.
double Quantile(std::vector<double> values, double share) {
  if (values.empty()) return 0.0;
  std::ranges::sort(values);
  const double place = share * static_cast<double>(values.size() - 1);
  const auto low = static_cast<size_t>(std::floor(place));
  const size_t high = std::min(low + 1, values.size() - 1);
  return std::lerp(values[low], values[high], place - std::floor(place));
}

std::vector<double> MeanRanks(std::span<const double> values) {
  std::vector<size_t> order(values.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::ranges::stable_sort(order, [&](size_t a, size_t b) { return values[a] < values[b]; });
  std::vector<double> ranks(values.size());
  for (size_t begin = 0; begin < order.size();) {
    size_t end = begin + 1;
    while (end < order.size() && values[order[end]] == values[order[begin]]) ++end;
    for (size_t i = begin; i < end; ++i) ranks[order[i]] = 0.5 * static_cast<double>(begin + end - 1);
    begin = end;
  }
  return ranks;
}

/// Indices of the tenth of the lights with most wrong pixels by method `m`; earlier lights first among
/// equals.
std::vector<size_t> WorstTenth(std::span<const LightRecord> records, size_t m) {
  std::vector<size_t> order(records.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::ranges::stable_sort(order, [&](size_t a, size_t b) {
    return records[a].methods[m].wrong_pixels > records[b].methods[m].wrong_pixels;
  });
  order.resize(std::min(order.size(), std::max<size_t>(1, (records.size() + 5) / 10)));
  return order;
}

}  // namespace

bool IsBaseline(const MethodVariant& method) {
  return method.options.method != Method::kDefault && method.options.method != Method::kPaper;
}

double RankCorrelation(std::span<const double> a, std::span<const double> b) {
  const std::vector<double> ranks_a = MeanRanks(a);
  const std::vector<double> ranks_b = MeanRanks(b);
  const double mean = 0.5 * (static_cast<double>(a.size()) - 1.0);
  double ab = 0.0;
  double aa = 0.0;
  double bb = 0.0;
  for (size_t i = 0; i < a.size(); ++i) {
    ab += (ranks_a[i] - mean) * (ranks_b[i] - mean);
    aa += (ranks_a[i] - mean) * (ranks_a[i] - mean);
    bb += (ranks_b[i] - mean) * (ranks_b[i] - mean);
  }
  return aa > 0.0 && bb > 0.0 ? ab / std::sqrt(aa * bb) : 0.0;
}

int BestBaseline(const LightRecord& record, std::span<const MethodVariant> methods, std::string* name) {
  int best = -1;
  for (size_t m = 0; m < methods.size(); ++m) {
    if (!IsBaseline(methods[m])) continue;
    const int wrong = record.methods[m].wrong_pixels;
    if (best >= 0 && wrong >= best) continue;
    best = wrong;
    if (name != nullptr) *name = methods[m].name;
  }
  return best;
}

ComparisonSummary Summarize(std::span<const LightRecord> records, std::span<const MethodVariant> methods) {
  ComparisonSummary summary;
  summary.lights = records.size();
  summary.methods.resize(methods.size());
  if (records.empty()) return summary;
  const auto count = static_cast<double>(records.size());
  for (const LightRecord& record : records) {
    summary.mean_concerned_pixels += record.concerned_pixels / count;
    summary.mean_shadowed_pixels += record.shadowed_pixels / count;
  }

  std::vector<std::vector<size_t>> worst;
  worst.reserve(methods.size());
  for (size_t m = 0; m < methods.size(); ++m) worst.push_back(WorstTenth(records, m));

  for (size_t m = 0; m < methods.size(); ++m) {
    MethodStatistics& statistics = summary.methods[m];
    std::vector<double> wrong;
    std::vector<double> predicted;
    std::vector<double> ratios;
    std::vector<double> milliseconds;
    std::vector<double> certify_seconds;
    std::vector<double> least_gaps;
    std::vector<double> most_gaps;
    for (size_t i = 0; i < records.size(); ++i) {
      const MethodRecord& record = records[i].methods[m];
      wrong.push_back(record.wrong_pixels);
      predicted.push_back(record.predicted_pixels);
      milliseconds.push_back(record.milliseconds);
      if (record.wrong_pixels > 0) ratios.push_back(record.predicted_pixels / record.wrong_pixels);
      if (!record.note.empty()) ++statistics.failures_and_fallbacks;
      if (record.artefacts) {
        ++statistics.artefact_lights;
        statistics.mean_acne += record.artefacts->counts.acne;
        statistics.mean_detached += record.artefacts->counts.peter_panning;
        statistics.mean_jagged += record.artefacts->counts.jagged;
        statistics.mean_flicker += record.artefacts->flicker;
      }
      if (record.certificate) {
        ++statistics.certified_lights;
        statistics.complete_certificates += record.certificate->complete ? 1 : 0;
        certify_seconds.push_back(record.certificate->seconds);
        least_gaps.push_back(record.certificate->least_gap);
        most_gaps.push_back(record.certificate->most_gap);
      }
      const int best_baseline = IsBaseline(methods[m]) ? -1 : BestBaseline(records[i], methods, nullptr);
      if (best_baseline >= 0 && record.wrong_pixels > best_baseline) {
        statistics.beaten_by_baseline.push_back(i);
      }
    }
    for (double* mean : {&statistics.mean_acne, &statistics.mean_detached, &statistics.mean_jagged,
                         &statistics.mean_flicker}) {
      *mean /= std::max(1, statistics.artefact_lights);
    }
    statistics.mean_wrong_pixels = std::reduce(wrong.begin(), wrong.end()) / count;
    for (const std::vector<size_t>& lights : worst) {
      double sum = 0.0;
      for (const size_t i : lights) sum += wrong[i];
      statistics.worst_tenth_mean.push_back(sum / static_cast<double>(lights.size()));
    }
    statistics.median_milliseconds = Quantile(milliseconds, 0.5);
    statistics.rank_correlation = RankCorrelation(predicted, wrong);
    statistics.ratio_lower_quartile = Quantile(ratios, 0.25);
    statistics.ratio_median = Quantile(ratios, 0.5);
    statistics.ratio_upper_quartile = Quantile(ratios, 0.75);
    statistics.median_certify_seconds = Quantile(certify_seconds, 0.5);
    statistics.worst_certify_seconds = Quantile(certify_seconds, 1.0);
    statistics.median_least_gap = Quantile(least_gaps, 0.5);
    statistics.worst_least_gap = Quantile(least_gaps, 1.0);
    statistics.median_most_gap = Quantile(most_gaps, 0.5);
    statistics.worst_most_gap = Quantile(most_gaps, 1.0);
  }
  return summary;
}

}  // namespace shadowfit
