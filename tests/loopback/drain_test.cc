#include <grpcpp/create_channel.h>
#include <grpcpp/security/credentials.h>
#include <gtest/gtest.h>

#include <atomic>
#include <thread>
#include <vector>

#include "shadowfit/v1/optimizer.grpc.pb.h"
#include "tests/loopback/loopback.h"
#include "tests/support/wire_frame.h"

namespace shadowfit {
namespace {

using namespace std::chrono_literals;

// Renderers that stream all the while, a server that goes: every frame that Submit() took is answered.
TEST(Drain, LosesNoFrame) {
  constexpr int kClients = 4;
  testing::Loopback loopback;
  const v1::Frame frame = testing::WireFrame(1, testing::RandomFrame(1, 60, 60, 2).request);
  std::atomic<int> streaming{0};
  std::atomic<int> submitted{0};
  std::atomic<int> answered{0};
  std::vector<std::thread> threads;
  for (int c = 0; c < kClients; ++c) {
    threads.emplace_back([&] {
      const auto client = loopback.Connect();
      FrameStreamOptions options;
      options.max_in_flight = 4;
      options.frame_timeout = 60s;
      const auto stream = client->OpenStream(options);
      const auto take = [&](const FrameOutcome& outcome) {
        EXPECT_TRUE(outcome.result.ok()) << outcome.result.status();
        if (++answered % 5 == 0) ++streaming;
      };
      for (uint64_t id = 1;; ++id) {
        v1::Frame* slot = stream->Acquire();
        while (slot == nullptr) {
          if (const auto outcome = stream->Wait(60s)) take(*outcome);
          slot = stream->Acquire();
        }
        *slot = frame;
        slot->set_frame_id(id);
        const absl::Status status = stream->Submit(slot);
        if (!status.ok()) {
          EXPECT_TRUE(absl::IsUnavailable(status)) << status;
          break;
        }
        ++submitted;
      }
      while (stream->in_flight() > 0) {
        const auto outcome = stream->Wait(60s);
        ASSERT_TRUE(outcome.has_value());
        take(*outcome);
      }
      EXPECT_TRUE(stream->Finish(10s).ok());
    });
  }
  while (streaming < kClients) std::this_thread::sleep_for(1ms);
  loopback.server().Drain();
  for (std::thread& thread : threads) thread.join();
  EXPECT_GT(submitted, 5 * kClients);
  EXPECT_EQ(answered, submitted);
}

TEST(Drain, TellsHealthChecksFirst) {
  testing::Loopback loopback;
  const auto client = loopback.Connect();
  // An open stream that holds the drain up while health is asked.
  const auto stub = v1::OptimizerService::NewStub(client->channel());
  grpc::ClientContext context;
  const auto stream = stub->OptimizeStream(&context);
  // Its first answer, the error of an empty frame, shows that the service has it.
  stream->Write({});
  v1::OptimizeStreamResponse response;
  ASSERT_TRUE(stream->Read(&response));
  std::thread drain([&] { loopback.server().Drain(); });
  bool notified = false;
  while (!notified && stream->Read(&response)) notified = response.draining();
  EXPECT_TRUE(notified);
  // By a channel that does not heed health itself: the client's own lets no new call through any more.
  const auto plain = grpc::CreateChannel(loopback.tcp(), grpc::InsecureChannelCredentials());
  EXPECT_EQ(testing::CheckHealth(plain, "shadowfit.v1.OptimizerService"), 2);
  EXPECT_EQ(testing::CheckHealth(plain, ""), 2);
  stream->WritesDone();
  while (stream->Read(&response)) {
  }
  EXPECT_TRUE(stream->Finish().ok());
  drain.join();
  EXPECT_FALSE(Client::Connect(loopback.tcp(), {.connect_timeout = 100ms}).ok());
}

}  // namespace
}  // namespace shadowfit
