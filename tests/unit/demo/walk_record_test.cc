#include "client/demo/walk_record.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

namespace shadowfit {
namespace {

WalkRecord Record(const std::string& name, std::vector<std::vector<int>> wrong_pixels) {
  WalkRecord record;
  record.name = name;
  record.wrong_pixels = std::move(wrong_pixels);
  return record;
}

TEST(WalkRecordTest, Means) {
  const WalkRecord record = Record("a", {{10, 2}, {20, 4}});
  EXPECT_EQ(record.FrameTotal(1), 24);
  EXPECT_DOUBLE_EQ(record.MeanOfLight(0), 15.0);
  EXPECT_DOUBLE_EQ(record.MeanPerFrame(), 18.0);
  EXPECT_DOUBLE_EQ(record.MeanPerLight(), 9.0);
}

TEST(WalkRecordTest, PercentileIsTheNearestRank) {
  EXPECT_EQ(Percentile({}, 0.5), 0.0);
  EXPECT_EQ(Percentile({7}, 0.95), 7);
  EXPECT_EQ(Percentile({3, 1, 2, 4}, 0.5), 2);
  EXPECT_EQ(Percentile({3, 1, 2, 4}, 0.95), 4);
  EXPECT_EQ(Percentile({3, 1, 2, 4}, 0.0), 1);
}

TEST(WalkRecordTest, WorstTenPercentIsRankedByTheOtherMethod) {
  // Twelve pairs of frame and light: two of them are the worst tenth.
  WalkRecord a = Record("a", {{1, 2, 3, 4, 5, 6}, {7, 8, 9, 10, 11, 12}});
  WalkRecord b = Record("b", {{90, 1, 80, 1, 1, 1}, {1, 1, 1, 1, 1, 1}});
  EXPECT_DOUBLE_EQ(WorstTenPercent(a, a), 11.5);
  EXPECT_DOUBLE_EQ(WorstTenPercent(a, b), 2.0);
  EXPECT_DOUBLE_EQ(WorstTenPercent(b, a), 1.0);
}

TEST(WalkRecordTest, MatricesSurviveTheDocumentToTheLastBit) {
  WalkRecord record = Record("a", {{1}});
  LightView view;
  view.clip_from_world[2][1] = 1.0 / 3.0;
  view.clip_from_world[3][0] = -4.9406564584124654e-324;
  view.clip_from_world[0][3] = std::numeric_limits<double>::max();
  record.AddMatrices(std::vector<LightView>{view});
  const nlohmann::json back = nlohmann::json::parse(MatricesJson("s", {record}).dump());
  EXPECT_EQ(back["methods"]["a"][0][0].get<std::vector<double>>(),
            std::vector<double>(record.matrices[0][0].begin(), record.matrices[0][0].end()));
  EXPECT_EQ(record.matrices[0][0][9], 1.0 / 3.0) << "column-major";
}

}  // namespace
}  // namespace shadowfit
