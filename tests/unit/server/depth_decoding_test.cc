#include "server/depth_decoding.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/gtc/packing.hpp>
#include <numeric>
#include <vector>

namespace shadowfit {
namespace {

std::vector<uint16_t> AllValues16() {
  std::vector<uint16_t> values(65536);
  std::iota(values.begin(), values.end(), uint16_t{0});
  return values;
}

TEST(DepthDecoding, EveryHalfIsWhatAnotherImplementationSays) {
  const std::vector<uint16_t> in = AllValues16();
  std::vector<float> out(in.size());
  DepthFromFloat16(in, out.data());
  for (const uint16_t half : in) {
    const float expected = glm::unpackHalf1x16(half);
    if (std::isnan(expected)) {
      EXPECT_TRUE(std::isnan(out[half])) << half;
    } else {
      ASSERT_EQ(out[half], expected) << half;
      ASSERT_EQ(std::signbit(out[half]), std::signbit(expected)) << half;
    }
  }
}

TEST(DepthDecoding, EveryUnorm16IsTheNearestFloat) {
  const std::vector<uint16_t> in = AllValues16();
  std::vector<float> out(in.size());
  DepthFromUnorm16(in, out.data());
  for (const uint16_t value : in) ASSERT_EQ(out[value], static_cast<float>(value / 65535.0)) << value;
  EXPECT_EQ(out[65535], 1.0F);
}

TEST(DepthDecoding, Unorm24IsTheNearestFloatWhateverTheHighByte) {
  std::vector<uint32_t> in;
  for (uint32_t value = 0; value <= 0xFFFFFF; value += 251) in.push_back(value | (value << 24));
  in.push_back(0xFFFFFF);
  in.push_back(0xFFFFFFFF);
  std::vector<float> out(in.size());
  DepthFromUnorm24(in, out.data());
  for (size_t i = 0; i < in.size(); ++i) {
    ASSERT_EQ(out[i], static_cast<float>((in[i] & 0xFFFFFF) / 16777215.0)) << in[i];
  }
  EXPECT_EQ(out.back(), 1.0F);
}

}  // namespace
}  // namespace shadowfit
