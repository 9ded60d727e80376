#include <gtest/gtest.h>

#include <atomic>
#include <thread>
#include <vector>

#include "core/fit/frame_optimizer.h"
#include "tests/loopback/loopback.h"
#include "tests/support/wire_frame.h"

namespace shadowfit {
namespace {

using namespace std::chrono_literals;
using testing::MatrixBytes;
using testing::OwnedFrame;
using testing::RandomFrame;
using testing::WireFrame;

std::string CoreMatrices(const FrameRequest& request) {
  FrameOptimizer optimizer;
  FrameSummary summary;
  const absl::Status status = optimizer.Optimize(request, {}, Cancellation(), &summary);
  EXPECT_TRUE(status.ok()) << status;
  return MatrixBytes(summary);
}

TEST(Results, AreCoresToTheLastBitOverEveryTransport) {
  const testing::Loopback loopback;
  const auto tcp = loopback.Connect();
  const auto in_process = loopback.ConnectInProcess();
  const auto unix_socket = Client::Connect(loopback.unix_socket());
  ASSERT_TRUE(unix_socket.ok()) << unix_socket.status();
  for (uint32_t seed = 0; seed < 12; ++seed) {
    const OwnedFrame owned = RandomFrame(seed, 90, 70, 1 + static_cast<int>(seed % 5));
    const std::string expected = CoreMatrices(owned.request);
    ASSERT_EQ(expected.size(), owned.request.lights.size() * 16 * sizeof(double));
    const v1::RowOrder order = seed % 2 == 0 ? v1::ROW_ORDER_BOTTOM_FIRST : v1::ROW_ORDER_TOP_FIRST;
    const v1::Frame frame = WireFrame(seed + 1, owned.request, v1::DEPTH_ENCODING_FLOAT32, order);
    for (Client* client : {tcp.get(), in_process.get(), unix_socket->get()}) {
      const auto result = client->Optimize(frame);
      ASSERT_TRUE(result.ok()) << result.status();
      EXPECT_EQ(result->frame_id(), seed + 1);
      EXPECT_EQ(MatrixBytes(*result), expected) << client->name();
      for (int i = 0; i < result->lights_size(); ++i) {
        EXPECT_EQ(result->lights(i).id(), owned.request.lights[static_cast<size_t>(i)].id);
        EXPECT_NE(result->lights(i).outcome(), v1::FIT_OUTCOME_UNSPECIFIED);
        EXPECT_NE(result->lights(i).sample_source(), v1::SAMPLE_SOURCE_UNSPECIFIED);
      }
    }
  }
}

TEST(Results, SafeBiasesComeOnRequestAlone) {
  const testing::Loopback loopback;
  const auto client = loopback.Connect();
  OwnedFrame owned = RandomFrame(3, 90, 70, 3);
  v1::Frame frame = WireFrame(1, owned.request);
  const auto plain = client->Optimize(frame);
  ASSERT_TRUE(plain.ok()) << plain.status();
  for (const v1::LightResult& light : plain->lights()) EXPECT_FALSE(light.has_safe_bias());
  EXPECT_EQ(plain->timings().bias_seconds(), 0.0);

  v1::SafeBiasOptions& wanted = *frame.mutable_options()->mutable_safe_bias();
  wanted.set_format(v1::SHADOW_MAP_FORMAT_UNORM16);
  wanted.set_pcf_radius(2);
  const auto result = client->Optimize(frame);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(MatrixBytes(*result), MatrixBytes(*plain));
  EXPECT_GT(result->timings().bias_seconds(), 0.0);
  owned.request.safe_bias = BiasOptions{.format = DepthFormat::kUnorm16, .pcf_radius = 2};
  FrameSummary summary;
  ASSERT_TRUE(FrameOptimizer().Optimize(owned.request, {}, Cancellation(), &summary).ok());
  for (int i = 0; i < 3; ++i) {
    const v1::SafeBias& got = result->lights(i).safe_bias();
    const SafeBias& expected = summary.lights[static_cast<size_t>(i)].safe_bias.value();
    EXPECT_EQ(got.constant(), expected.constant);
    EXPECT_EQ(got.slope(), expected.slope);
    EXPECT_EQ(got.clamp(), expected.clamp);
    EXPECT_EQ(got.polygon_offset_constant(), expected.polygon_offset_constant);
    EXPECT_EQ(got.polygon_offset_slope(), expected.polygon_offset_slope);
    EXPECT_EQ(got.receiver_plane_constant(), expected.receiver_plane_constant);
    EXPECT_EQ(got.mean_detachment(), expected.ws_mean_detachment);
    EXPECT_EQ(got.worst_detachment(), expected.ws_worst_detachment);
    EXPECT_EQ(got.mean_detachment_of_constant(), expected.ws_mean_detachment_of_constant);
    EXPECT_EQ(got.mean_detachment_pixels(), expected.mean_detachment_pixels);
    EXPECT_EQ(got.worst_detachment_pixels(), expected.worst_detachment_pixels);
    EXPECT_EQ(got.samples(), static_cast<uint32_t>(expected.samples));
    EXPECT_GE(got.constant(), 0.5 / 65535);
  }
  EXPECT_GT(result->lights(0).safe_bias().samples(), 100U);

  wanted.set_pcf_radius(17);
  EXPECT_EQ(std::string(client->Optimize(frame).status().message()),
            client->name() + ": options.safe_bias.pcf_radius: 17 is outside 0 to 16");
}

// A stream's memory must do what a caller without a stream does by sending the matrices along.
TEST(Results, AStreamRemembersWhatAUnaryCallIsTold) {
  const testing::Loopback loopback;
  const auto client = loopback.Connect();
  const auto stream = client->OpenStream();
  v1::FrameResult last;
  int kept = 0;
  for (uint64_t id = 1; id <= 12; ++id) {
    // The same scene and lights, the camera moving a little.
    OwnedFrame owned = testing::WalkFrame(11, static_cast<int>(id), 90, 70, 3);
    v1::Frame frame = WireFrame(id, owned.request);
    frame.mutable_options()->set_method(v1::METHOD_PAPER);
    v1::Frame* slot = stream->Acquire();
    ASSERT_NE(slot, nullptr);
    *slot = frame;
    ASSERT_TRUE(stream->Submit(slot).ok());
    const auto outcome = stream->Wait(5s);
    ASSERT_TRUE(outcome.has_value() && outcome->result.ok());
    for (int i = 0; i < last.lights_size(); ++i) {
      *frame.mutable_lights(i)->mutable_previous_world_to_shadow_clip() =
          last.lights(i).world_to_shadow_clip();
    }
    const auto unary = client->Optimize(frame);
    ASSERT_TRUE(unary.ok());
    EXPECT_EQ(MatrixBytes(*outcome->result), MatrixBytes(*unary)) << "frame " << id;
    for (const v1::LightResult& light : unary->lights())
      kept += light.outcome() == v1::FIT_OUTCOME_KEPT_PREVIOUS;
    last = *unary;
  }
  EXPECT_GT(kept, 0) << "the walk never made use of a previous matrix: this test shows nothing";
}

TEST(Results, SayHowFarTexelsMovedWherePreviousOnesAreKnown) {
  const testing::Loopback loopback;
  const auto client = loopback.Connect();
  OwnedFrame owned = testing::WalkFrame(11, 1, 90, 70, 3);
  const auto first = client->Optimize(WireFrame(1, owned.request));
  ASSERT_TRUE(first.ok()) << first.status();
  for (const v1::LightResult& light : first->lights()) EXPECT_FALSE(light.has_swim_pixels());

  owned = testing::WalkFrame(11, 2, 90, 70, 3);
  v1::Frame frame = WireFrame(2, owned.request);
  for (int i = 0; i < 3; ++i) {
    *frame.mutable_lights(i)->mutable_previous_world_to_shadow_clip() =
        first->lights(i).world_to_shadow_clip();
    glm::dmat4& matrix = owned.request.lights[static_cast<size_t>(i)].previous_clip_from_world.emplace();
    for (int k = 0; k < 16; ++k) matrix[k / 4][k % 4] = first->lights(i).world_to_shadow_clip().m(k);
  }
  // The knob: never, by default, and whatever it costs.
  double least_swim = 1e300;
  for (const double keep : {0.0, 1.1, 1e6}) {
    if (keep != 1.1) frame.mutable_options()->set_keep_within(keep);
    if (keep == 1.1) frame.mutable_options()->clear_keep_within();
    Options options;
    options.standard.keep_within = keep;
    FrameSummary summary;
    ASSERT_TRUE(FrameOptimizer().Optimize(owned.request, options, Cancellation(), &summary).ok());
    const auto result = client->Optimize(frame);
    ASSERT_TRUE(result.ok()) << result.status();
    EXPECT_EQ(MatrixBytes(*result), MatrixBytes(summary)) << keep;
    double swim = 0.0;
    for (int i = 0; i < 3; ++i) {
      const v1::LightResult& light = result->lights(i);
      const std::optional<double> expected = summary.lights[static_cast<size_t>(i)].swim_pixels;
      EXPECT_EQ(light.has_swim_pixels(), expected.has_value());
      EXPECT_EQ(light.swim_pixels(), expected.value_or(0.0));
      swim += light.swim_pixels();
      if (keep == 0.0) {
        EXPECT_NE(light.outcome(), v1::FIT_OUTCOME_KEPT_PREVIOUS);
      }
      if (keep == 1e6 && light.further_maps_size() == 0) {
        EXPECT_EQ(light.outcome(), v1::FIT_OUTCOME_KEPT_PREVIOUS) << i;
      }
    }
    EXPECT_GT(swim, 0.0);
    EXPECT_LE(swim, least_swim) << keep;
    least_swim = swim;
  }
}

TEST(Results, SayHowMuchShadowNoMapHolds) {
  const testing::Loopback loopback;
  const auto client = loopback.Connect();
  double outside = 0.0;
  for (int step = 1; step <= 4; ++step) {
    OwnedFrame owned = testing::WalkFrame(11, step, 90, 70, 3);
    // Where texels are large it pays to let go of some.
    for (LightRequest& light : owned.request.lights) light.map_size = {16, 16};
    v1::Frame frame = WireFrame(1, owned.request);
    for (const bool hold_all : {false, true}) {
      frame.mutable_options()->set_hold_all_shadow(hold_all);
      Options options;
      options.standard.hold_all_shadow = hold_all;
      FrameSummary summary;
      ASSERT_TRUE(FrameOptimizer().Optimize(owned.request, options, Cancellation(), &summary).ok());
      const auto result = client->Optimize(frame);
      ASSERT_TRUE(result.ok()) << result.status();
      EXPECT_EQ(MatrixBytes(*result), MatrixBytes(summary)) << hold_all;
      for (int i = 0; i < 3; ++i) {
        const double pixels = result->lights(i).shadow_outside_pixels();
        EXPECT_EQ(pixels, summary.lights[static_cast<size_t>(i)].shadow_outside_pixels);
        EXPECT_LE(pixels, result->lights(i).predicted_misclassified_pixels());
        // A light that no single map serves may lose some in any case.
        if (hold_all && result->lights(i).outcome() == v1::FIT_OUTCOME_FITTED) {
          EXPECT_EQ(pixels, 0.0);
        }
        if (!hold_all) outside += pixels;
      }
    }
  }
  EXPECT_GT(outside, 0.0);
}

TEST(Results, TexelsOfAStreamStayWhereNothingMoves) {
  const testing::Loopback loopback;
  const auto client = loopback.Connect();
  // Maps of a width and height of their own: the stream must remember these, too.
  v1::Frame frame = WireFrame(1, testing::WalkFrame(11, 1, 90, 70, 3).request);
  frame.mutable_options()->set_free_aspect(true);
  frame.mutable_options()->set_most_maps(1);
  const auto stream = client->OpenStream();
  v1::FrameResult first;
  for (uint64_t id = 1; id <= 3; ++id) {
    v1::Frame* slot = stream->Acquire();
    ASSERT_NE(slot, nullptr);
    *slot = frame;
    slot->set_frame_id(id);
    ASSERT_TRUE(stream->Submit(slot).ok());
    const auto outcome = stream->Wait(5s);
    ASSERT_TRUE(outcome.has_value() && outcome->result.ok());
    if (id == 1) first = *outcome->result;
    for (int i = 0; i < 3 && id > 1; ++i) {
      const v1::LightResult& light = outcome->result->lights(i);
      EXPECT_EQ(light.outcome(), v1::FIT_OUTCOME_KEPT_PREVIOUS);
      EXPECT_EQ(light.shadow_map().width(), first.lights(i).shadow_map().width());
      EXPECT_EQ(light.shadow_map().height(), first.lights(i).shadow_map().height());
      EXPECT_LT(light.swim_pixels(), 1e-6);
    }
  }
}

TEST(Results, DoNotDependOnWhatElseRuns) {
  constexpr int kStreams = 24;
  constexpr uint64_t kFrames = 6;
  ServerOptions options;
  options.max_admitted_jobs = 4 * kStreams;
  const testing::Loopback loopback(options);
  std::vector<std::vector<v1::Frame>> frames(kStreams);
  std::vector<std::vector<std::string>> expected(kStreams);
  for (int s = 0; s < kStreams; ++s) {
    FrameOptimizer optimizer;
    FrameSummary summary;
    std::vector<LightSummary> last;
    for (uint64_t id = 1; id <= kFrames; ++id) {
      OwnedFrame owned = testing::WalkFrame(static_cast<uint32_t>(s), static_cast<int>(id), 40, 30, 2);
      frames[static_cast<size_t>(s)].push_back(WireFrame(id, owned.request));
      for (size_t i = 0; i < last.size(); ++i) {
        owned.request.lights[i].previous_clip_from_world = last[i].clip_from_world;
      }
      ASSERT_TRUE(optimizer.Optimize(owned.request, {}, Cancellation(), &summary).ok());
      expected[static_cast<size_t>(s)].push_back(MatrixBytes(summary));
      last = summary.lights;
    }
  }
  std::vector<std::thread> threads;
  std::atomic<int> equal{0};
  const auto client = loopback.Connect();
  for (size_t s = 0; s < kStreams; ++s) {
    threads.emplace_back([&, s] {
      FrameStreamOptions stream_options;
      stream_options.frame_timeout = 60s;
      const auto stream = client->OpenStream(stream_options);
      size_t sent = 0;
      size_t received = 0;
      while (received < kFrames) {
        if (sent < kFrames) {
          if (v1::Frame* slot = stream->Acquire()) {
            *slot = frames[s][sent++];
            EXPECT_TRUE(stream->Submit(slot).ok());
            continue;
          }
        }
        const auto outcome = stream->Wait(60s);
        if (!outcome || !outcome->result.ok()) break;
        equal += MatrixBytes(*outcome->result) == expected[s][outcome->frame_id - 1];
        ++received;
      }
      EXPECT_TRUE(stream->Finish(60s).ok());
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(equal, kStreams * static_cast<int>(kFrames));
}

}  // namespace
}  // namespace shadowfit
