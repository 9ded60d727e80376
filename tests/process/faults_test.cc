#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <sys/socket.h>

#include <atomic>
#include <chrono>
#include <cstdlib>
#include <fstream>
#include <random>
#include <thread>
#include <vector>

#include "client/client.h"
#include "tests/process/server_process.h"
#include "tests/support/wire_frame.h"

namespace shadowfit {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;
using testing::ServerProcess;

std::unique_ptr<Client> Connect(const ServerProcess& server) {
  auto client = Client::Connect(server.address(), {.connect_timeout = 20s});
  if (!client.ok()) throw std::runtime_error(std::string(client.status().message()));
  return *std::move(client);
}

v1::Frame SmallFrame() { return testing::WireFrame(1, testing::RandomFrame(1, 40, 40, 2).request); }
/// Keeps the service busy for a while.
v1::Frame BigFrame() { return testing::WireFrame(1, testing::RandomFrame(1, 400, 400, 16).request); }

/// Fills the stream, so that frames are under way whatever happens next.
uint64_t Fill(FrameStream& stream, const v1::Frame& frame, uint64_t id) {
  while (v1::Frame* slot = stream.Acquire()) {
    *slot = frame;
    slot->set_frame_id(++id);
    if (!stream.Submit(slot).ok()) break;
  }
  return id;
}

TEST(Faults, AServerKilledUnderAStreamIsAClearErrorWithinTheDeadline) {
  ServerProcess server;
  const auto client = Connect(server);
  FrameStreamOptions options;
  options.frame_timeout = 20s;
  const auto stream = client->OpenStream(options);
  const v1::Frame frame = BigFrame();
  uint64_t id = Fill(*stream, frame, 0);
  const auto first = stream->Wait(20s);
  ASSERT_TRUE(first.has_value() && first->result.ok());
  // So that what follows is not answered, however long this process may stand still before the kill.
  server.process().Signal(SIGSTOP);
  id = Fill(*stream, frame, id);
  const int under_way = stream->in_flight();
  EXPECT_EQ(under_way, 3);
  server.process().Signal(SIGKILL);
  const auto start = Clock::now();
  int lost = 0;
  for (int i = 0; i < under_way; ++i) {
    const auto outcome = stream->Wait(20s);
    ASSERT_TRUE(outcome.has_value());
    if (outcome->result.ok()) continue;  // It was answered before the kill.
    EXPECT_TRUE(absl::IsUnavailable(outcome->result.status())) << outcome->result.status();
    EXPECT_EQ(std::string(outcome->result.status().message()).find(server.address()), 0U)
        << outcome->result.status();
    ++lost;
  }
  EXPECT_GT(lost, 0);
  EXPECT_LT(Clock::now() - start, 10s);
  v1::Frame* slot = stream->Acquire();
  ASSERT_NE(slot, nullptr);
  slot->set_frame_id(id + 1);
  EXPECT_TRUE(absl::IsUnavailable(stream->Submit(slot)));
  EXPECT_FALSE(stream->Wait(1ms).has_value());
  EXPECT_LT(Clock::now() - start, 10s);
}

TEST(Faults, AServerKilledUnderACallIsAClearErrorWithinTheDeadline) {
  ServerProcess server;
  const auto client = Connect(server);
  std::jthread killer([&] {
    std::this_thread::sleep_for(30ms);
    server.process().Signal(SIGKILL);
  });
  const v1::Frame frame = BigFrame();
  const auto start = Clock::now();
  absl::Status status;
  while (status.ok()) status = client->Optimize(frame, {.timeout = 20s, .stop = {}}).status();
  EXPECT_TRUE(absl::IsUnavailable(status)) << status;
  EXPECT_LT(Clock::now() - start, 15s);
}

// A machine that hangs closes no connection: only deadlines help.
TEST(Faults, AServerThatStandsStillCostsTheFramesTheirDeadlineAndNoMore) {
  ServerProcess server;
  const auto client = Connect(server);
  FrameStreamOptions options;
  options.frame_timeout = 300ms;
  const auto stream = client->OpenStream(options);
  server.process().Signal(SIGSTOP);
  const auto start = Clock::now();
  Fill(*stream, SmallFrame(), 0);
  for (int i = 0; i < 3; ++i) {
    const auto outcome = stream->Wait(10s);
    ASSERT_TRUE(outcome.has_value());
    EXPECT_TRUE(absl::IsDeadlineExceeded(outcome->result.status())) << outcome->result.status();
  }
  EXPECT_TRUE(
      absl::IsDeadlineExceeded(client->Optimize(SmallFrame(), {.timeout = 300ms, .stop = {}}).status()));
  EXPECT_TRUE(absl::IsDeadlineExceeded(stream->Finish(300ms)));
  EXPECT_LT(Clock::now() - start, 8s);
  server.process().Signal(SIGCONT);
  EXPECT_TRUE(client->Optimize(SmallFrame()).ok());
}

TEST(Faults, SigtermLosesNoFrameAndNoCall) {
  ServerProcess server({"--lame-duck-seconds", "0.5"});
  const v1::Frame frame = SmallFrame();
  std::atomic<int> submitted{0};
  std::atomic<int> answered{0};
  std::atomic<int> calls{0};
  std::vector<std::thread> threads;
  for (int t = 0; t < 3; ++t) {
    threads.emplace_back([&] {
      const auto client = Connect(server);
      const auto stream = client->OpenStream({.max_in_flight = 3, .frame_timeout = 60s});
      uint64_t id = 0;
      bool open = true;
      while (open || stream->in_flight() > 0) {
        v1::Frame* slot = open ? stream->Acquire() : nullptr;
        if (slot != nullptr) {
          *slot = frame;
          slot->set_frame_id(++id);
          open = stream->Submit(slot).ok();
          if (open) ++submitted;
          continue;
        }
        const auto outcome = stream->Wait(60s);
        ASSERT_TRUE(outcome.has_value());
        EXPECT_TRUE(outcome->result.ok()) << outcome->result.status();
        ++answered;
      }
      EXPECT_TRUE(stream->Finish(10s).ok());
    });
  }
  // Calls go on until the client's health check tells it that the service will go; none that was begun is
  // lost. The last one finds nobody to call.
  threads.emplace_back([&] {
    const auto client = Connect(server);
    absl::Status status;
    while (true) {
      status = client->Optimize(frame).status();
      if (!status.ok()) break;
      ++calls;
    }
    EXPECT_TRUE(absl::IsUnavailable(status)) << status;
  });
  const auto limit = Clock::now() + 60s;
  while ((answered < 30 || calls < 5) && Clock::now() < limit) std::this_thread::sleep_for(1ms);
  server.process().Signal(SIGTERM);
  EXPECT_EQ(server.process().Wait(), 0);
  for (std::thread& thread : threads) thread.join();
  EXPECT_GE(submitted, 30);
  EXPECT_EQ(answered, submitted);
}

TEST(Faults, SigtermEndsAServerThatNobodyUses) {
  ServerProcess server({"--lame-duck-seconds", "0"});
  const auto start = Clock::now();
  server.process().Signal(SIGTERM);
  EXPECT_EQ(server.process().Wait(), 0);
  EXPECT_LT(Clock::now() - start, 5s);
}

int ConnectSocket(const std::string& address) {
  const int socket_fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_port = htons(static_cast<uint16_t>(std::atoi(address.substr(address.rfind(':') + 1).c_str())));
  to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  if (connect(socket_fd, reinterpret_cast<sockaddr*>(&to), sizeof(to)) != 0)
    throw std::runtime_error("connect");
  return socket_fd;
}

TEST(Faults, ConnectionsThatSpeakNonsenseHarmNobody) {
  ServerProcess server;
  const auto client = Connect(server);
  std::mt19937 random(9);
  for (int i = 0; i < 60; ++i) {
    const int socket_fd = ConnectSocket(server.address());
    std::string bytes = i % 2 == 0 ? "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" : "";
    for (uint32_t k = random() % 3000; k > 0; --k) bytes.push_back(static_cast<char>(random()));
    EXPECT_GE(send(socket_fd, bytes.data(), bytes.size(), MSG_NOSIGNAL), 0);
    if (i % 3 == 0) {  // Reset instead of an orderly end.
      const linger hard{1, 0};
      setsockopt(socket_fd, SOL_SOCKET, SO_LINGER, &hard, sizeof(hard));
    }
    close(socket_fd);
  }
  EXPECT_TRUE(client->Optimize(SmallFrame()).ok());
}

size_t ResidentBytes(pid_t pid) {
  std::ifstream file("/proc/" + std::to_string(pid) + "/statm");
  size_t total = 0;
  size_t resident = 0;
  file >> total >> resident;
  return resident * static_cast<size_t>(sysconf(_SC_PAGESIZE));
}

TEST(Faults, MemoryDoesNotGrowWithTheFrames) {
#ifdef __SANITIZE_ADDRESS__
  GTEST_SKIP() << "the sanitizer keeps freed memory";
#endif
  ServerProcess server;
  const auto client = Connect(server);
  const v1::Frame frame = testing::WireFrame(1, testing::RandomFrame(1, 180, 180, 1).request);
  const auto stream = client->OpenStream({.max_in_flight = 3, .frame_timeout = 60s});
  uint64_t id = 0;
  const auto run = [&](int frames) {
    for (int done = 0; done < frames;) {
      id = Fill(*stream, frame, id);
      const auto outcome = stream->Wait(60s);
      ASSERT_TRUE(outcome.has_value() && outcome->result.ok());
      ++done;
    }
  };
  run(150);
  const size_t warm = ResidentBytes(server.process().pid());
  run(450);
  const size_t later = ResidentBytes(server.process().pid());
  EXPECT_LT(later, warm + (size_t{4} << 20)) << "warm " << warm << ", later " << later;
}

}  // namespace
}  // namespace shadowfit
