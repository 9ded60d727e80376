#include <gtest/gtest.h>
#include <tbb/task_arena.h>

#include <string>
#include <thread>
#include <vector>

#include "core/fit/frame_optimizer.h"
#include "tests/loopback/loopback.h"
#include "tests/support/wire_frame.h"

namespace shadowfit {
namespace {

using testing::OwnedFrame;
using testing::WireFrame;

/// All of an answer but its times, as bytes.
std::string Answer(v1::FrameResult result) {
  result.clear_timings();
  for (v1::LightResult& light : *result.mutable_lights()) light.clear_optimize_seconds();
  std::string bytes;
  EXPECT_TRUE(result.SerializeToString(&bytes));
  return bytes;
}

/// Frames that make the service do all that it can.
std::vector<v1::Frame> Frames() {
  std::vector<v1::Frame> frames;
  for (uint32_t seed = 0; seed < 4; ++seed) {
    v1::Frame& frame = frames.emplace_back(
        WireFrame(seed + 1, testing::RandomFrame(seed, 80, 60, seed == 3 ? 32 : 8).request));
    v1::OptimizeOptions& options = *frame.mutable_options();
    options.set_assess_quality(true);
    if (seed == 1) {
      options.set_most_maps(4);
      options.set_free_aspect(true);
      options.mutable_texel_budget()->mutable_atlas()->set_width(2048);
      options.mutable_texel_budget()->mutable_atlas()->set_height(1024);
    }
    if (seed == 2) {
      options.mutable_safe_bias();
      options.mutable_tolerance()->set_max_misclassified_pixels(20.0);
      options.mutable_tolerance()->mutable_sides()->set_max_side(1024);
    }
    if (seed == 3) options.set_method(v1::METHOD_PAPER);
  }
  return frames;
}

TEST(Determinism, AnswersAreTheSameBytesOnAnyNumberOfThreads) {
  const std::vector<v1::Frame> frames = Frames();
  std::vector<std::string> expected;
  for (const int workers : {1, 2, 8}) {
    ServerOptions options;
    options.workers = workers;
    const testing::Loopback loopback(options);
    // As many callers at once as there are workers, so that these do run side by side.
    std::vector<std::vector<std::string>> answers(static_cast<size_t>(workers));
    std::vector<std::thread> callers;
    for (std::vector<std::string>& mine : answers) {
      callers.emplace_back([&] {
        const auto client = loopback.Connect();
        for (const v1::Frame& frame : frames) {
          const auto result = client->Optimize(frame);
          ASSERT_TRUE(result.ok()) << result.status();
          mine.push_back(Answer(*result));
        }
      });
    }
    for (std::thread& caller : callers) caller.join();
    if (expected.empty()) expected = answers[0];
    for (const std::vector<std::string>& mine : answers) EXPECT_TRUE(mine == expected) << workers;
  }
  ASSERT_EQ(expected.size(), frames.size());
}

TEST(Determinism, CoreGivesTheSameBytesInAnyArena) {
  const OwnedFrame owned = testing::RandomFrame(5, 80, 60, 32);
  std::string expected;
  for (const int threads : {1, 2, 8}) {
    FrameOptimizer optimizer;
    FrameSummary summary;
    tbb::task_arena(threads).execute(
        [&] { ASSERT_TRUE(optimizer.Optimize(owned.request, {}, Cancellation(), &summary).ok()); });
    if (expected.empty()) expected = testing::MatrixBytes(summary);
    EXPECT_TRUE(testing::MatrixBytes(summary) == expected) << threads;
  }
}

// What a client logs is what it sends: the frame's bytes and, of a stream, nothing else, where the last
// matrices are in it.
TEST(Determinism, ALoggedFrameReproducesItsAnswer) {
  std::vector<std::string> log;
  std::vector<std::string> answers;
  {
    const testing::Loopback loopback;
    const auto client = loopback.Connect();
    v1::FrameResult last;
    for (int step = 1; step <= 5; ++step) {
      v1::Frame frame =
          WireFrame(static_cast<uint64_t>(step), testing::WalkFrame(11, step, 90, 70, 3).request);
      for (int i = 0; i < last.lights_size(); ++i) {
        *frame.mutable_lights(i)->mutable_previous_world_to_shadow_clip() =
            last.lights(i).world_to_shadow_clip();
      }
      const auto result = client->Optimize(frame);
      ASSERT_TRUE(result.ok()) << result.status();
      ASSERT_TRUE(frame.SerializeToString(&log.emplace_back()));
      answers.push_back(Answer(*result));
      last = *result;
    }
  }
  // Another service, and the other way round.
  ServerOptions options;
  options.workers = 1;
  const testing::Loopback loopback(options);
  const auto client = loopback.ConnectInProcess();
  for (size_t i = log.size(); i-- > 0;) {
    v1::Frame frame;
    ASSERT_TRUE(frame.ParseFromString(log[i]));
    const auto result = client->Optimize(frame);
    ASSERT_TRUE(result.ok()) << result.status();
    EXPECT_TRUE(Answer(*result) == answers[i]) << i;
  }
}

}  // namespace
}  // namespace shadowfit
