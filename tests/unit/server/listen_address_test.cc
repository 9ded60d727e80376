#include "server/listen_address.h"

#include <gtest/gtest.h>

#include "server/server.h"

namespace shadowfit {
namespace {

TEST(ListenAddress, KnowsWhatStaysOnThisMachine) {
  for (const char* address : {"127.0.0.1:80", "127.9.8.7:0", "[::1]:5", "localhost:1", "unix:/run/x"}) {
    EXPECT_TRUE(IsLocalAddress(address)) << address;
  }
  for (const char* address : {"0.0.0.0:80", "[::]:5", "10.0.0.1:1", "example.com:1", "128.0.0.1:1",
                              "127.0.0.1", "localhost.example.com:1", "[::ffff:10.0.0.1]:1"}) {
    EXPECT_FALSE(IsLocalAddress(address)) << address;
  }
}

TEST(ListenAddress, PlaintextLeavesTheMachineOnlyWhenTold) {
  EXPECT_TRUE(CheckListenAddress("listen", "127.0.0.1:0", false).ok());
  EXPECT_TRUE(CheckListenAddress("listen", "unix:/tmp/x", false).ok());
  EXPECT_TRUE(absl::IsInvalidArgument(CheckListenAddress("listen", "0.0.0.0:1", false)));
  EXPECT_TRUE(CheckListenAddress("listen", "0.0.0.0:1", true).ok());
}

TEST(ListenAddress, MalformedOnesAreRefused) {
  for (const std::string address :
       {"", ":", "host", ":80", "host:", "host:x", "host:-1", "127.0.0.1:65536", "::1:80", "unix:"}) {
    EXPECT_TRUE(absl::IsInvalidArgument(CheckListenAddress("listen", address, true))) << address;
  }
  EXPECT_TRUE(absl::IsInvalidArgument(CheckListenAddress("listen", "unix:" + std::string(108, 'a'), true)));
  EXPECT_TRUE(CheckListenAddress("listen", "unix:" + std::string(107, 'a'), true).ok());
}

TEST(ServerOptions, EachBadOptionIsNamed) {
  const auto message = [](auto change) {
    ServerOptions options;
    change(options);
    return std::string(CheckServerOptions(options).message());
  };
  EXPECT_EQ(message([](ServerOptions&) {}), "");
  EXPECT_EQ(message([](ServerOptions& o) { o.workers = -1; }).find("workers: "), 0U);
  EXPECT_EQ(message([](ServerOptions& o) { o.max_message_bytes = 0; }).find("max_message_bytes: "), 0U);
  EXPECT_EQ(
      message([](ServerOptions& o) { o.max_message_bytes = size_t{1} << 31; }).find("max_message_bytes: "),
      0U);
  EXPECT_EQ(message([](ServerOptions& o) { o.max_admitted_bytes = 0; }).find("max_admitted_bytes: "), 0U);
  EXPECT_EQ(message([](ServerOptions& o) { o.max_admitted_jobs = 0; }).find("max_admitted_jobs: "), 0U);
  EXPECT_EQ(message([](ServerOptions& o) { o.max_streams = 0; }).find("max_streams: "), 0U);
  EXPECT_EQ(message([](ServerOptions& o) { o.max_frames_in_stream = 0; }).find("max_frames_in_stream: "), 0U);
  EXPECT_EQ(message([](ServerOptions& o) { o.lame_duck_seconds = -1; }).find("lame_duck_seconds: "), 0U);
  EXPECT_EQ(message([](ServerOptions& o) { o.drain_seconds = 1e9; }).find("drain_seconds: "), 0U);
  EXPECT_EQ(message([](ServerOptions& o) { o.listen = {"8.8.8.8:1"}; }).find("listen: "), 0U);
  EXPECT_EQ(message([](ServerOptions& o) { o.metrics_listen = "8.8.8.8:1"; }).find("metrics_listen: "), 0U);
  EXPECT_EQ(message([](ServerOptions& o) { o.metrics_listen = "unix:/x"; }).find("metrics_listen: "), 0U);
}

}  // namespace
}  // namespace shadowfit
