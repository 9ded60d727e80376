#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <thread>
#include <vector>

#include "tests/loopback/loopback.h"
#include "tests/support/wire_frame.h"

namespace shadowfit {
namespace {

using namespace std::chrono_literals;

TEST(Load, AnOverloadedServiceAnswersOrRefusesEveryCall) {
  ServerOptions options;
  options.workers = 1;
  options.max_admitted_jobs = 2;
  testing::Loopback loopback(options);
  const v1::Frame frame = testing::WireFrame(1, testing::RandomFrame(1, 150, 150, 4).request);
  std::atomic<int> answered{0};
  std::atomic<int> refused{0};
  std::vector<std::thread> threads;
  for (int t = 0; t < 12; ++t) {
    threads.emplace_back([&] {
      const auto client = loopback.ConnectInProcess();  // Without the client's retries.
      for (int i = 0; i < 5; ++i) {
        const auto result = client->Optimize(frame);
        if (result.ok()) {
          ++answered;
        } else {
          EXPECT_TRUE(absl::IsUnavailable(result.status())) << result.status();
          EXPECT_TRUE(result.status().GetPayload("type.googleapis.com/google.rpc.RetryInfo").has_value());
          ++refused;
        }
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(answered + refused, 60);
  EXPECT_GT(answered, 0);
  EXPECT_GT(refused, 0);
  EXPECT_TRUE(loopback.Connect()->Optimize(frame).ok());
}

TEST(Load, RequestsThatCanNeverFitAreToldSo) {
  ServerOptions options;
  options.max_message_bytes = 200000;
  options.max_admitted_bytes = 50000;
  testing::Loopback loopback(options);
  const auto client = loopback.Connect();
  const v1::Frame above_admission = testing::WireFrame(1, testing::RandomFrame(1, 150, 60, 1).request);
  const v1::Frame above_message = testing::WireFrame(1, testing::RandomFrame(1, 200, 200, 1).request);
  EXPECT_TRUE(absl::IsResourceExhausted(client->Optimize(above_admission).status()));
  EXPECT_TRUE(absl::IsResourceExhausted(client->Optimize(above_message).status()));
  EXPECT_TRUE(client->Optimize(testing::WireFrame(1, testing::RandomFrame(1, 20, 20, 1).request)).ok());
}

// gRPC refuses such a message before anyone can tell which frame it was.
TEST(Load, AFrameAboveTheMessageLimitEndsItsStreamWithTheReason) {
  ServerOptions options;
  options.max_message_bytes = 100000;
  testing::Loopback loopback(options);
  const auto client = loopback.Connect();
  const auto stream = client->OpenStream();
  v1::Frame* frame = stream->Acquire();
  *frame = testing::WireFrame(1, testing::RandomFrame(1, 200, 200, 1).request);
  ASSERT_TRUE(stream->Submit(frame).ok());
  const auto outcome = stream->Wait(10s);
  ASSERT_TRUE(outcome.has_value());
  EXPECT_TRUE(absl::IsResourceExhausted(outcome->result.status())) << outcome->result.status();
  EXPECT_FALSE(stream->status().ok());
  EXPECT_TRUE(client->Optimize(testing::WireFrame(1, testing::RandomFrame(1, 20, 20, 1).request)).ok());
}

// With computations on gRPC's own threads this took seconds.
TEST(Load, HealthIsToldWhileEverythingIsBusy) {
  ServerOptions options;
  options.workers = 2;
  testing::Loopback loopback(options);
  const v1::Frame frame = testing::WireFrame(1, testing::RandomFrame(1, 150, 150, 8).request);
  std::atomic<bool> stop{false};
  std::atomic<int> answered{0};
  std::vector<std::thread> threads;
  for (int t = 0; t < 16; ++t) {
    threads.emplace_back([&] {
      const auto client = loopback.Connect();
      while (!stop) answered += client->Optimize(frame).ok();
    });
  }
  while (answered == 0) std::this_thread::sleep_for(1ms);
  const auto channel = loopback.Connect()->channel();
  std::vector<double> milliseconds;
  for (int i = 0; i < 15; ++i) {
    const auto start = std::chrono::steady_clock::now();
    EXPECT_EQ(testing::CheckHealth(channel, ""), 1);
    milliseconds.push_back(
        std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count());
  }
  stop = true;
  for (std::thread& thread : threads) thread.join();
  std::sort(milliseconds.begin(), milliseconds.end());
  EXPECT_LT(milliseconds[milliseconds.size() / 2], 500.0);
  RecordProperty("median_health_check_ms", std::to_string(milliseconds[milliseconds.size() / 2]));
}

}  // namespace
}  // namespace shadowfit
