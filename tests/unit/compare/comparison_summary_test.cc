#include "client/compare/comparison_summary.h"

#include <gmock/gmock.h>

#include <numeric>

namespace shadowfit {
namespace {

MethodVariant Variant(Method method) {
  MethodVariant variant{std::string(MethodName(method)), {}, {400, 400}};
  variant.options.method = method;
  return variant;
}

/// Twenty lights with counts that can be summed by hand.
struct Lights {
  std::vector<MethodVariant> methods = {Variant(Method::kDefault), Variant(Method::kNormal),
                                        Variant(Method::kFocused)};
  std::vector<LightRecord> records;

  Lights() {
    for (int i = 0; i < 20; ++i) {
      LightRecord& record = records.emplace_back();
      record.index = i;
      record.concerned_pixels = 1000;
      record.shadowed_pixels = 10 * i;
      MethodRecord ours;
      ours.wrong_pixels = i;  // Worst: 19, 18.
      ours.predicted_pixels = 2.0 * i;
      ours.milliseconds = 0.1 * (i + 1);
      MethodRecord normal;
      normal.wrong_pixels = 100 - i;  // Worst: lights 0, 1.
      normal.predicted_pixels = double(i);
      MethodRecord focused;
      focused.wrong_pixels = i == 7 ? 3 : 50;
      focused.note = i < 4 ? "stated" : "";
      record.methods = {ours, normal, focused};
    }
  }
};

TEST(ComparisonSummaryTest, MeansAndWorstTenths) {
  const Lights lights;
  const ComparisonSummary summary = Summarize(lights.records, lights.methods);
  EXPECT_EQ(summary.lights, 20u);
  EXPECT_DOUBLE_EQ(summary.mean_concerned_pixels, 1000.0);
  EXPECT_DOUBLE_EQ(summary.mean_shadowed_pixels, 95.0);
  EXPECT_DOUBLE_EQ(summary.methods[0].mean_wrong_pixels, 9.5);
  EXPECT_DOUBLE_EQ(summary.methods[1].mean_wrong_pixels, 90.5);
  // Ours over our own worst two, over Normal's, over Focused's (ties: the first two lights).
  EXPECT_THAT(summary.methods[0].worst_tenth_mean, testing::ElementsAre(18.5, 0.5, 0.5));
  EXPECT_THAT(summary.methods[1].worst_tenth_mean, testing::ElementsAre(81.5, 99.5, 99.5));
  EXPECT_DOUBLE_EQ(summary.methods[0].median_milliseconds, 1.05);
  EXPECT_EQ(summary.methods[2].failures_and_fallbacks, 4);
}

TEST(ComparisonSummaryTest, PredictionAgainstTruth) {
  const Lights lights;
  const ComparisonSummary summary = Summarize(lights.records, lights.methods);
  EXPECT_DOUBLE_EQ(summary.methods[0].rank_correlation, 1.0);
  EXPECT_DOUBLE_EQ(summary.methods[1].rank_correlation, -1.0);
  EXPECT_DOUBLE_EQ(summary.methods[2].rank_correlation, 0.0);  // Nothing predicted.
  EXPECT_DOUBLE_EQ(summary.methods[0].ratio_lower_quartile, 2.0);
  EXPECT_DOUBLE_EQ(summary.methods[0].ratio_median, 2.0);
  EXPECT_DOUBLE_EQ(summary.methods[2].ratio_upper_quartile, 0.0);
}

TEST(ComparisonSummaryTest, LightsWorseThanTheBestBaseline) {
  const Lights lights;
  const ComparisonSummary summary = Summarize(lights.records, lights.methods);
  EXPECT_THAT(summary.methods[0].beaten_by_baseline, testing::ElementsAre(7));
  EXPECT_THAT(summary.methods[1].beaten_by_baseline, testing::IsEmpty());
  std::string name;
  EXPECT_EQ(BestBaseline(lights.records[7], lights.methods, &name), 3);
  EXPECT_EQ(name, "focused");
  const std::vector<MethodVariant> ours = {lights.methods[0]};
  EXPECT_EQ(BestBaseline(lights.records[7], ours, &name), -1);
}

TEST(ComparisonSummaryTest, CertificatesOfTheLightsThatHaveOne) {
  Lights lights;
  for (int i = 0; i < 5; ++i) {
    lights.records[size_t(i)].methods[0].certificate =
        CertificateRecord{0.01, 60.0, i != 3, 0.001 * i, 0.01 + 0.001 * i, 10.0 - i};
  }
  const ComparisonSummary summary = Summarize(lights.records, lights.methods);
  const MethodStatistics& ours = summary.methods[0];
  EXPECT_EQ(ours.certified_lights, 5);
  EXPECT_EQ(ours.complete_certificates, 4);
  EXPECT_DOUBLE_EQ(ours.median_certify_seconds, 8.0);
  EXPECT_DOUBLE_EQ(ours.worst_certify_seconds, 10.0);
  EXPECT_DOUBLE_EQ(ours.median_least_gap, 0.002);
  EXPECT_DOUBLE_EQ(ours.worst_least_gap, 0.004);
  EXPECT_DOUBLE_EQ(ours.median_most_gap, 0.012);
  EXPECT_DOUBLE_EQ(ours.worst_most_gap, 0.014);
  EXPECT_EQ(summary.methods[1].certified_lights, 0);
}

TEST(ComparisonSummaryTest, NoLightsAndOneLight) {
  const Lights lights;
  EXPECT_EQ(Summarize({}, lights.methods).lights, 0u);
  const ComparisonSummary one = Summarize({lights.records.data() + 5, 1}, lights.methods);
  EXPECT_THAT(one.methods[0].worst_tenth_mean, testing::ElementsAre(5.0, 5.0, 5.0));
}

TEST(RankCorrelationTest, TiesTakeTheirMeanRank) {
  // Ranks 0, 1.5, 1.5, 3 against 0, 1, 2, 3: by hand, 4.5 / sqrt(4.5 * 5).
  const std::vector<double> a = {1, 2, 2, 3};
  const std::vector<double> b = {10, 20, 30, 40};
  EXPECT_NEAR(RankCorrelation(a, b), 4.5 / std::sqrt(4.5 * 5.0), 1e-15);
}

}  // namespace
}  // namespace shadowfit
