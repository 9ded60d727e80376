#include "core/resolution/resolution.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/gtc/matrix_transform.hpp>
#include <string>
#include <vector>

#include "google/rpc/error_details.pb.h"
#include "shadowfit/v1/resolution.grpc.pb.h"
#include "tests/loopback/loopback.h"
#include "tests/support/wire_frame.h"

namespace shadowfit {
namespace {

using testing::OwnedFrame;
using testing::RandomFrame;
using testing::WireFrame;

ResolutionSummary CoreEstimate(const FrameRequest& frame, const ResolutionOptions& options) {
  ResolutionRequest request;
  request.camera = frame.camera;
  request.depth = frame.depth;
  for (const LightRequest& light : frame.lights) {
    request.lights.push_back(
        {.id = light.id, .light = light.light, .clip_from_world = light.previous_clip_from_world});
  }
  ResolutionSummary summary;
  const absl::Status status = ResolutionEstimator().Estimate(request, options, Cancellation(), &summary);
  EXPECT_TRUE(status.ok()) << status;
  return summary;
}

void ExpectCores(const v1::ResolutionResult& result, const ResolutionSummary& expected) {
  ASSERT_EQ(result.lights_size(), static_cast<int>(expected.lights.size()));
  for (int l = 0; l < result.lights_size(); ++l) {
    const LightEstimate& light = expected.lights[static_cast<size_t>(l)];
    EXPECT_EQ(result.lights(l).id(), light.id);
    EXPECT_EQ(static_cast<int>(result.lights(l).recommended().width()), light.recommended.width);
    EXPECT_EQ(static_cast<int>(result.lights(l).recommended().height()), light.recommended.height);
    ASSERT_EQ(result.lights(l).maps_size(), static_cast<int>(light.maps.size()));
    for (int m = 0; m < result.lights(l).maps_size(); ++m) {
      const v1::MapResolution& found = result.lights(l).maps(m);
      const MapEstimate& map = light.maps[static_cast<size_t>(m)];
      EXPECT_EQ(found.visible_pixels(), static_cast<uint64_t>(map.pixels));
      EXPECT_EQ(static_cast<int>(found.recommended().width()), map.recommended.width);
      EXPECT_EQ(found.needed_width(), map.needed.x);
      EXPECT_EQ(found.needed_height(), map.needed.y);
      EXPECT_EQ(found.limited(), map.limited);
      EXPECT_EQ(found.crop_min_x(), map.crop_min.x);
      EXPECT_EQ(found.crop_max_y(), map.crop_max.y);
      EXPECT_EQ(found.smallest_patch_height(), map.smallest_patch.y);
      ASSERT_EQ(found.world_to_shadow_clip().m_size(), 16);
      for (int k = 0; k < 16; ++k) {
        EXPECT_EQ(found.world_to_shadow_clip().m(k), map.clip_from_world[k / 4][k % 4]);
      }
      ASSERT_EQ(found.histogram_x_size(), static_cast<int>(map.histogram_x.size()));
      for (int b = 0; b < found.histogram_x_size(); ++b) {
        EXPECT_EQ(found.histogram_x(b).texels(), map.histogram_x[static_cast<size_t>(b)].texels);
        EXPECT_EQ(found.histogram_x(b).pixels(),
                  static_cast<uint64_t>(map.histogram_x[static_cast<size_t>(b)].pixels));
      }
    }
  }
}

TEST(Resolution, IsCoresToTheLastBit) {
  const testing::Loopback loopback;
  const auto client = loopback.Connect();
  for (uint32_t seed = 0; seed < 6; ++seed) {
    const OwnedFrame owned = RandomFrame(seed, 200, 150, 4);
    v1::Frame frame = WireFrame(seed, owned.request, v1::DEPTH_ENCODING_FLOAT32,
                                seed % 2 == 0 ? v1::ROW_ORDER_BOTTOM_FIRST : v1::ROW_ORDER_TOP_FIRST);
    frame.mutable_lights(0)->clear_shadow_map();  // No input of this question.
    v1::ResolutionOptions options;
    ResolutionOptions core_options;
    if (seed % 3 == 1) {
      options.set_max_size(1000);
      options.set_rounding(v1::SIZE_ROUNDING_MULTIPLE_OF_8);
      options.set_percentile(99.0);
      core_options = {.max_size = 1000, .rounding = SizeRounding::kMultipleOf8, .percentile = 99.0};
    } else if (seed % 3 == 2) {
      options.set_rounding(v1::SIZE_ROUNDING_POWER_OF_TWO);
      options.set_histogram(true);
      core_options = {.rounding = SizeRounding::kPowerOfTwo, .histogram = true};
    }
    const auto result = client->EstimateResolution(frame, options);
    ASSERT_TRUE(result.ok()) << result.status();
    EXPECT_EQ(result->frame_id(), seed);
    ExpectCores(*result, CoreEstimate(owned.request, core_options));
  }
}

TEST(Resolution, JudgesAnOptimizedMatrix) {
  const testing::Loopback loopback;
  const auto client = loopback.Connect();
  const OwnedFrame owned = RandomFrame(5, 160, 120, 3);
  v1::Frame frame = WireFrame(1, owned.request);
  const auto fitted = client->Optimize(frame);
  ASSERT_TRUE(fitted.ok()) << fitted.status();
  FrameRequest request = owned.request;
  for (int i = 0; i < fitted->lights_size(); ++i) {
    const v1::Matrix4& matrix = fitted->lights(i).world_to_shadow_clip();
    *frame.mutable_lights(i)->mutable_previous_world_to_shadow_clip() = matrix;
    glm::dmat4& clip_from_world = request.lights[static_cast<size_t>(i)].previous_clip_from_world.emplace();
    for (int k = 0; k < 16; ++k) clip_from_world[k / 4][k % 4] = matrix.m(k);
  }
  const auto judged = client->EstimateResolution(frame, {});
  ASSERT_TRUE(judged.ok()) << judged.status();
  for (const v1::LightResolution& light : judged->lights()) EXPECT_EQ(light.maps_size(), 1);
  ExpectCores(*judged, CoreEstimate(request, {}));
}

TEST(Resolution, StreamAnswersEachFrameAndSurvivesABadOne) {
  const testing::Loopback loopback;
  const auto stub = v1::ResolutionService::NewStub(loopback.Connect()->channel());
  grpc::ClientContext context;
  const auto stream = stub->EstimateResolutionStream(&context);
  for (uint64_t id = 1; id <= 9; ++id) {
    const OwnedFrame owned = RandomFrame(static_cast<uint32_t>(id), 80, 60, 2);
    v1::EstimateResolutionStreamRequest request;
    *request.mutable_frame() = WireFrame(id, owned.request);
    const bool bad = id % 3 == 0;
    if (bad) request.mutable_frame()->mutable_depth()->mutable_data()->pop_back();
    ASSERT_TRUE(stream->Write(request));
    v1::EstimateResolutionStreamResponse response;
    ASSERT_TRUE(stream->Read(&response));
    EXPECT_EQ(response.frame_id(), id);
    ASSERT_EQ(response.has_error(), bad);
    if (!bad) ExpectCores(response.result(), CoreEstimate(owned.request, {}));
  }
  EXPECT_TRUE(stream->WritesDone());
  v1::EstimateResolutionStreamResponse none;
  EXPECT_FALSE(stream->Read(&none));
  EXPECT_TRUE(stream->Finish().ok());
}

TEST(Resolution, ErrorsNameTheField) {
  const testing::Loopback loopback;
  const auto client = loopback.Connect();
  const OwnedFrame owned = RandomFrame(1, 20, 16, 2);
  const v1::Frame good = WireFrame(1, owned.request);
  const auto violation = [&](const v1::Frame& frame, const v1::ResolutionOptions& options) {
    const absl::Status status = client->EstimateResolution(frame, options).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << status;
    google::rpc::BadRequest detail;
    const auto payload = status.GetPayload("type.googleapis.com/google.rpc.BadRequest");
    if (!payload || !detail.ParseFromString(std::string(*payload)) || detail.field_violations_size() != 1) {
      return std::string("no violation");
    }
    return detail.field_violations(0).field();
  };
  v1::ResolutionOptions options;
  options.set_max_size(65537);
  EXPECT_EQ(violation(good, options), "options.max_size");
  options.set_max_size(7);
  options.set_rounding(v1::SIZE_ROUNDING_MULTIPLE_OF_8);
  EXPECT_EQ(violation(good, options), "options.max_size");
  options.Clear();
  options.set_percentile(-1.0);
  EXPECT_EQ(violation(good, options), "options.percentile");
  options.set_percentile(std::nan(""));
  EXPECT_EQ(violation(good, options), "options.percentile");
  options.Clear();
  options.set_rounding(static_cast<v1::SizeRounding>(17));
  EXPECT_EQ(violation(good, options), "options.rounding");

  v1::Frame bad = good;
  bad.clear_camera();
  EXPECT_EQ(violation(bad, {}), "frame.camera");
  bad = good;
  bad.mutable_depth()->mutable_data()->pop_back();
  EXPECT_EQ(violation(bad, {}), "frame.depth.data");
  bad = good;
  bad.mutable_lights(1)->set_id(bad.lights(0).id());
  EXPECT_EQ(violation(bad, {}), "frame.lights[1].id");
  bad = good;
  bad.clear_lights();
  EXPECT_EQ(violation(bad, {}), "frame.lights");
  bad = good;
  testing::SetMatrix(glm::dmat4(0.0), bad.mutable_lights(0)->mutable_previous_world_to_shadow_clip());
  EXPECT_EQ(violation(bad, {}), "frame.lights[0].previous_world_to_shadow_clip");
}

}  // namespace
}  // namespace shadowfit
