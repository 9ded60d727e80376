#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>
#include <vector>

#include "core/fit/frame_optimizer.h"
#include "tests/loopback/loopback.h"
#include "tests/support/wire_frame.h"

namespace shadowfit {
namespace {

using testing::WireFrame;

/// deploy/docs/sizing.md, over the wire.
class Sizing : public ::testing::Test {
 protected:
  v1::FrameResult Optimize(const v1::Frame& frame) const {
    const auto result = client_->Optimize(frame);
    EXPECT_TRUE(result.ok()) << result.status();
    return result.ok() ? *result : v1::FrameResult();
  }

  static double Texels(const v1::FrameResult& result) {
    double texels = 0.0;
    for (const v1::LightResult& light : result.lights()) {
      texels += double(light.shadow_map().width()) * light.shadow_map().height();
      for (const v1::ShadowMap& map : light.further_maps()) {
        texels += double(map.size().width()) * map.size().height();
      }
    }
    return texels;
  }
  static double Predicted(const v1::FrameResult& result) {
    double pixels = 0.0;
    for (const v1::LightResult& light : result.lights()) pixels += light.predicted_misclassified_pixels();
    return pixels;
  }

  const testing::Loopback loopback_;
  const std::unique_ptr<Client> client_ = loopback_.Connect();
  v1::Frame frame_ = WireFrame(1, testing::RandomFrame(4, 90, 70, 12).request);
};

TEST_F(Sizing, ABudgetSharesItsTexelsForFewerWrongPixels) {
  const v1::FrameResult equal = Optimize(frame_);
  frame_.mutable_options()->mutable_texel_budget()->set_total_texels(static_cast<uint64_t>(Texels(equal)));
  const v1::FrameResult shared = Optimize(frame_);
  EXPECT_LE(Texels(shared), Texels(equal));
  EXPECT_LT(Predicted(shared), Predicted(equal));
  for (const v1::LightResult& light : shared.lights()) EXPECT_FALSE(light.has_atlas_position());

  // Lights need no size of their own: maps are square then.
  for (v1::Light& light : *frame_.mutable_lights()) light.clear_shadow_map();
  frame_.mutable_options()->set_most_maps(1);
  const v1::FrameResult square = Optimize(frame_);
  for (const v1::LightResult& light : square.lights()) {
    EXPECT_NEAR(light.shadow_map().width(), light.shadow_map().height(), 1.0);
  }

  // A light whose wrong pixels count more gets more texels.
  int heavy = 0;
  while (shared.lights(heavy).predicted_misclassified_pixels() == 0.0) ++heavy;
  frame_.mutable_lights(heavy)->set_weight(10.0);
  const v1::FrameResult weighted = Optimize(frame_);
  EXPECT_GT(weighted.lights(heavy).shadow_map().width(), shared.lights(heavy).shadow_map().width());
}

TEST_F(Sizing, AnAtlasHoldsAllMapsSideBySide) {
  for (const v1::SizeRounding rounding :
       {v1::SIZE_ROUNDING_EXACT, v1::SIZE_ROUNDING_MULTIPLE_OF_8, v1::SIZE_ROUNDING_POWER_OF_TWO}) {
    v1::TexelBudget& budget = *frame_.mutable_options()->mutable_texel_budget();
    budget.mutable_atlas()->set_width(1024);
    budget.mutable_atlas()->set_height(512);
    budget.mutable_sides()->set_rounding(rounding);
    budget.mutable_sides()->set_min_side(32);
    const v1::FrameResult result = Optimize(frame_);
    std::vector<std::pair<v1::AtlasPosition, v1::Size>> places;
    for (const v1::LightResult& light : result.lights()) {
      ASSERT_TRUE(light.has_atlas_position());
      places.emplace_back(light.atlas_position(), light.shadow_map());
      for (const v1::ShadowMap& map : light.further_maps()) {
        ASSERT_TRUE(map.has_atlas_position());
        places.emplace_back(map.atlas_position(), map.size());
      }
    }
    for (size_t i = 0; i < places.size(); ++i) {
      const auto& [at, size] = places[i];
      EXPECT_LE(at.x() + size.width(), 1024U);
      EXPECT_LE(at.y() + size.height(), 512U);
      EXPECT_GE(std::min(size.width(), size.height()), 32U);
      if (rounding == v1::SIZE_ROUNDING_MULTIPLE_OF_8) {
        EXPECT_EQ(size.width() % 8 + size.height() % 8, 0U);
      }
      if (rounding == v1::SIZE_ROUNDING_POWER_OF_TWO) {
        EXPECT_EQ((size.width() & (size.width() - 1)) + (size.height() & (size.height() - 1)), 0U);
      }
      for (size_t k = 0; k < i; ++k) {
        const auto& [other_at, other_size] = places[k];
        EXPECT_TRUE(at.x() + size.width() <= other_at.x() || other_at.x() + other_size.width() <= at.x() ||
                    at.y() + size.height() <= other_at.y() || other_at.y() + other_size.height() <= at.y())
            << i << " and " << k << " overlap";
      }
    }
    EXPECT_GE(Texels(result), 0.7 * 1024 * 512);
  }
}

TEST_F(Sizing, AToleranceGivesEachLightTheSmallestMapThatKeepsIt) {
  v1::Tolerance& tolerance = *frame_.mutable_options()->mutable_tolerance();
  tolerance.mutable_sides()->set_max_side(2048);
  double texels = 1e300;
  for (const double pixels : {5.0, 20.0, 80.0}) {
    tolerance.set_max_misclassified_pixels(pixels);
    const v1::FrameResult result = Optimize(frame_);
    for (const v1::LightResult& light : result.lights()) {
      if (!light.note().empty()) continue;
      // The upper end of what is expected stays below it, and so does the prediction.
      EXPECT_LE(light.predicted_misclassified_pixels(), pixels);
    }
    EXPECT_LT(Texels(result), texels);
    texels = Texels(result);
  }
  tolerance.set_max_misclassified_pixels(1e-3);
  tolerance.mutable_sides()->set_max_side(64);
  int said = 0;
  const v1::FrameResult impossible = Optimize(frame_);
  for (const v1::LightResult& light : impossible.lights()) {
    said += light.note() == "the largest map allowed is too small for the tolerance";
    EXPECT_LE(light.shadow_map().width(), 64U);
  }
  EXPECT_GT(said, 0);
}

TEST_F(Sizing, TheReportsFactorsMakeThePrediction) {
  frame_.mutable_options()->set_assess_quality(true);
  int judged = 0;
  const v1::FrameResult result = Optimize(frame_);
  for (const v1::LightResult& light : result.lights()) {
    ASSERT_TRUE(light.has_quality());
    if (light.sample_source() != v1::SAMPLE_SOURCE_SHADOW_BOUNDARY) continue;
    const v1::MapQuality& q = light.quality();
    const double product =
        q.unit_pixels() * q.perspective() * q.projection() * q.fit() * q.budget() * q.saturation();
    EXPECT_NEAR(product, light.predicted_misclassified_pixels() - light.shadow_outside_pixels(),
                1e-6 * product);
    EXPECT_GE(q.perspective(), 1.0 - 1e-9);
    EXPECT_GE(q.fit(), 1.0 - 1e-9);
    EXPECT_LE(q.saturation(), 1.0);
    ++judged;
  }
  EXPECT_GT(judged, 5);
}

}  // namespace
}  // namespace shadowfit
