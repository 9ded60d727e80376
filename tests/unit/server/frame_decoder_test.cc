#include "server/frame_decoder.h"

#include <gtest/gtest.h>

#include "tests/support/wire_frame.h"

namespace shadowfit {
namespace {

using testing::OwnedFrame;
using testing::RandomFrame;
using testing::WireFrame;

class FrameDecoderTest : public ::testing::TestWithParam<std::tuple<v1::DepthEncoding, v1::RowOrder>> {};

TEST_P(FrameDecoderTest, PicturesArriveAsTheyWere) {
  const auto [encoding, row_order] = GetParam();
  const OwnedFrame owned = RandomFrame(1, 23, 17, 4);
  const v1::Frame frame = WireFrame(5, owned.request, encoding, row_order);
  FrameDecoder decoder;
  FrameRequest request;
  Options options;
  ASSERT_TRUE(decoder.Decode(frame, &request, &options).ok());
  ASSERT_EQ(request.depth.width, 23);
  ASSERT_EQ(request.depth.height, 17);
  ASSERT_TRUE(request.bits.has_value());
  // Half a step of the encoding; halves have 11 significant bits.
  const double tolerance = encoding == v1::DEPTH_ENCODING_FLOAT16   ? 1.0 / 4096
                           : encoding == v1::DEPTH_ENCODING_UNORM16 ? 0.51 / 65535
                           : encoding == v1::DEPTH_ENCODING_UNORM24 ? 0.51 / 16777215 + 1e-7
                                                                    : 0.0;
  int background = 0;
  for (int y = 0; y < 17; ++y) {
    for (int x = 0; x < 23; ++x) {
      EXPECT_NEAR(request.depth.At(x, y), owned.request.depth.At(x, y), tolerance) << x << " " << y;
      if (owned.request.depth.At(x, y) == 1.0F) {
        EXPECT_EQ(request.depth.At(x, y), 1.0F);  // Background stays background.
        ++background;
      }
      EXPECT_EQ(request.bits->At(x, y), owned.request.bits->At(x, y)) << x << " " << y;
    }
  }
  EXPECT_GT(background, 0);
}

INSTANTIATE_TEST_SUITE_P(
    AllEncodings, FrameDecoderTest,
    ::testing::Combine(::testing::Values(v1::DEPTH_ENCODING_UNSPECIFIED, v1::DEPTH_ENCODING_FLOAT32,
                                         v1::DEPTH_ENCODING_FLOAT16, v1::DEPTH_ENCODING_UNORM16,
                                         v1::DEPTH_ENCODING_UNORM24),
                       ::testing::Values(v1::ROW_ORDER_BOTTOM_FIRST, v1::ROW_ORDER_TOP_FIRST)));

TEST(FrameDecoder, FloatsAndBitsAreNotCopied) {
  const OwnedFrame owned = RandomFrame(2, 16, 16, 1);
  for (const v1::RowOrder order : {v1::ROW_ORDER_BOTTOM_FIRST, v1::ROW_ORDER_TOP_FIRST}) {
    const v1::Frame frame = WireFrame(5, owned.request, v1::DEPTH_ENCODING_FLOAT32, order);
    FrameDecoder decoder;
    FrameRequest request;
    Options options;
    ASSERT_TRUE(decoder.Decode(frame, &request, &options).ok());
    const int first_row = order == v1::ROW_ORDER_BOTTOM_FIRST ? 0 : 15;
    EXPECT_EQ(static_cast<const void*>(request.depth.Row(first_row)), frame.depth().data().data());
    EXPECT_EQ(static_cast<const void*>(request.bits->Row(first_row)), frame.shadow_bits().data().data());
  }
}

TEST(FrameDecoder, EverythingElseArrivesAsItWas) {
  OwnedFrame owned = RandomFrame(3, 8, 8, 6);
  owned.request.camera.clip_depth = ClipDepth::kReversedZeroToOne;
  owned.request.output_clip_depth = ClipDepth::kZeroToOne;
  owned.request.lights[2].previous_clip_from_world = glm::dmat4(3.0);
  v1::Frame frame = WireFrame(5, owned.request);
  frame.mutable_options()->set_method(v1::METHOD_PAPER);
  frame.mutable_screen()->set_width(640);
  frame.mutable_screen()->set_height(480);
  testing::SetVector({-1, -2, -3}, frame.mutable_scene_bounds()->mutable_min());
  testing::SetVector({4, 5, 6}, frame.mutable_scene_bounds()->mutable_max());
  FrameDecoder decoder;
  FrameRequest request;
  Options options;
  ASSERT_TRUE(decoder.Decode(frame, &request, &options).ok());
  EXPECT_EQ(request.camera.view_from_world, owned.request.camera.view_from_world);
  EXPECT_EQ(request.camera.clip_from_view, owned.request.camera.clip_from_view);
  EXPECT_EQ(request.camera.clip_depth, ClipDepth::kReversedZeroToOne);
  EXPECT_EQ(request.output_clip_depth, ClipDepth::kZeroToOne);
  EXPECT_EQ(options.method, Method::kPaper);
  EXPECT_EQ(request.screen.width, 640);
  EXPECT_EQ(request.screen.height, 480);
  EXPECT_EQ(request.ws_scene_bounds->min, glm::dvec3(-1, -2, -3));
  EXPECT_EQ(request.ws_scene_bounds->max, glm::dvec3(4, 5, 6));
  ASSERT_EQ(request.lights.size(), 6U);
  for (size_t i = 0; i < 6; ++i) {
    EXPECT_EQ(request.lights[i].id, owned.request.lights[i].id);
    EXPECT_EQ(request.lights[i].light.index(), owned.request.lights[i].light.index());
    EXPECT_EQ(request.lights[i].map_size.width, owned.request.lights[i].map_size.width);
    EXPECT_EQ(request.lights[i].map_size.height, owned.request.lights[i].map_size.height);
    EXPECT_EQ(request.lights[i].previous_clip_from_world.has_value(), i == 2);
  }
  // A decoder forgets: what the next frame leaves out is not the last one's.
  ASSERT_TRUE(decoder.Decode(WireFrame(6, RandomFrame(4, 4, 4, 2).request), &request, &options).ok());
  EXPECT_EQ(options.method, Method::kDefault);
  EXPECT_EQ(request.screen, MapSize{});
  EXPECT_FALSE(request.ws_scene_bounds.has_value());
  EXPECT_EQ(request.lights.size(), 2U);
}

// Every method of the wire is one of core's and carries its name.
TEST(FrameDecoder, MethodNamesAgreeWithCore) {
  v1::Frame frame = WireFrame(5, RandomFrame(5, 4, 4, 1).request);
  FrameDecoder decoder;
  FrameRequest request;
  Options options;
  for (int value = v1::Method_MIN + 1; value <= v1::Method_MAX; ++value) {
    frame.mutable_options()->set_method(static_cast<v1::Method>(value));
    ASSERT_TRUE(decoder.Decode(frame, &request, &options).ok());
    std::string name = "METHOD_" + std::string(MethodName(options.method));
    for (char& c : name) c = static_cast<char>(std::toupper(c));
    EXPECT_EQ(name, v1::Method_Name(value));
  }
}

}  // namespace
}  // namespace shadowfit
