#pragma once

#include <span>
#include <string>
#include <vector>

#include "client/compare/comparison.h"

namespace shadowfit {

/// A method's figures over a set of lights. Vectors run over the methods that rank, in the comparison's
/// order.
struct MethodStatistics {
  double mean_wrong_pixels = 0.0;
  /// Over the tenth of the lights (rounded, at least one) that the ranking method serves worst.
  std::vector<double> worst_tenth_mean;
  double median_milliseconds = 0.0;

  /// Prediction against truth. Spearman's rank correlation over all lights (mean ranks for ties), 0 where
  /// either side is constant; quartiles of predicted over true pixels over the lights with wrong pixels, 0
  /// where there are none.
  double rank_correlation = 0.0;
  double ratio_lower_quartile = 0.0;
  double ratio_median = 0.0;
  double ratio_upper_quartile = 0.0;

  /// Lights, as indices into the summarised records, on which some baseline has fewer wrong pixels. Empty
  /// for baselines.
  std::vector<size_t> beaten_by_baseline;
  int failures_and_fallbacks = 0;

  /// Means over the lights for which artefacts were counted; their number first.
  int artefact_lights = 0;
  double mean_acne = 0.0;
  double mean_detached = 0.0;
  double mean_jagged = 0.0;
  double mean_flicker = 0.0;

  /// Over the lights that have a certificate; their number first. Gaps are shares of the best map's metric.
  int certified_lights = 0;
  int complete_certificates = 0;
  double median_certify_seconds = 0.0;
  double worst_certify_seconds = 0.0;
  double median_least_gap = 0.0;
  double worst_least_gap = 0.0;
  double median_most_gap = 0.0;
  double worst_most_gap = 0.0;
};

struct ComparisonSummary {
  size_t lights = 0;
  double mean_concerned_pixels = 0.0;
  double mean_shadowed_pixels = 0.0;
  std::vector<MethodStatistics> methods;  ///< In the comparison's order.
};

/// True for the methods that existed before optimization: normal, focused, lispsm, plane_optimal,
/// sphere_stable.
bool IsBaseline(const MethodVariant& method);

/// `records` may be any part of a comparison's lights.
ComparisonSummary Summarize(std::span<const LightRecord> records, std::span<const MethodVariant> methods);

/// Fewest wrong pixels of any baseline for this light, and whose; -1 where no baseline takes part.
int BestBaseline(const LightRecord& record, std::span<const MethodVariant> methods, std::string* name);

/// Spearman's rank correlation; see MethodStatistics.
double RankCorrelation(std::span<const double> a, std::span<const double> b);

}  // namespace shadowfit
