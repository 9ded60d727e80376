// What the way to the service and back costs beside the computation itself: p50 and p95 of a round trip, for
// frames of two sizes and over each transport, against the library called directly and a copy of the frame's
// bytes. All ways take turns within one run, so that a noisy machine disturbs them alike.
//
//     bench_round_trip [ROUNDS]      (200)

#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "client/client.h"
#include "core/fit/frame_optimizer.h"
#include "server/server.h"
#include "tests/support/wire_frame.h"

namespace shadowfit {
namespace {

using Clock = std::chrono::steady_clock;

struct Way {
  std::string name;
  std::function<bool()> run;
  std::vector<double> microseconds = {};

  double Percentile(double share) {
    const auto nth = microseconds.begin() +
                     static_cast<std::ptrdiff_t>(share * static_cast<double>(microseconds.size() - 1));
    std::nth_element(microseconds.begin(), nth, microseconds.end());
    return *nth;
  }
};

/// A frame stream with one frame under way: the latency that a renderer sees.
class StreamWay {
 public:
  StreamWay(Client& client, const v1::Frame& frame)
      : frame_(frame),
        stream_(client.OpenStream({.max_in_flight = 1, .frame_timeout = std::chrono::seconds(60)})) {}

  bool operator()() {
    v1::Frame* slot = stream_->Acquire();
    if (slot == nullptr) return false;
    *slot = frame_;
    slot->set_frame_id(++id_);
    if (!stream_->Submit(slot).ok()) return false;
    const auto outcome = stream_->Wait(std::chrono::seconds(60));
    return outcome && outcome->result.ok();
  }

 private:
  const v1::Frame& frame_;
  std::unique_ptr<FrameStream> stream_;
  uint64_t id_ = 0;
};

bool Measure(const Server& server, const std::shared_ptr<grpc::Channel>& in_process_channel, int width,
             int height, int rounds) {
  const testing::OwnedFrame owned = testing::RandomFrame(4, width, height, 1);
  const v1::Frame frame = testing::WireFrame(1, owned.request);
  const auto tcp = Client::Connect(server.addresses()[0]);
  const auto unix_socket = Client::Connect(server.addresses()[1]);
  if (!tcp.ok() || !unix_socket.ok()) return false;
  const auto in_process = Client::FromChannel(in_process_channel, "in-process");

  FrameOptimizer optimizer;
  FrameSummary summary;
  std::string copy(frame.depth().data().size() + frame.shadow_bits().data().size(), '\0');
  StreamWay tcp_stream(**tcp, frame);
  StreamWay unix_stream(**unix_socket, frame);
  StreamWay in_process_stream(*in_process, frame);
  std::vector<Way> ways;
  ways.push_back({"copy of the pictures", [&] {
                    std::memcpy(copy.data(), frame.depth().data().data(), frame.depth().data().size());
                    std::memcpy(copy.data() + frame.depth().data().size(), frame.shadow_bits().data().data(),
                                frame.shadow_bits().data().size());
                    return copy.back() == frame.shadow_bits().data().back();
                  }});
  ways.push_back({"library, no service",
                  [&] { return optimizer.Optimize(owned.request, {}, Cancellation(), &summary).ok(); }});
  ways.push_back({"stream, in process", std::ref(in_process_stream)});
  ways.push_back({"stream, Unix socket", std::ref(unix_stream)});
  ways.push_back({"stream, TCP", std::ref(tcp_stream)});
  ways.push_back({"unary, in process", [&] { return in_process->Optimize(frame).ok(); }});
  ways.push_back({"unary, TCP", [&] { return (*tcp)->Optimize(frame).ok(); }});
  for (int round = -10; round < rounds; ++round) {  // The first ten warm up.
    for (Way& way : ways) {
      const Clock::time_point start = Clock::now();
      if (!way.run()) {
        std::fprintf(stderr, "%s failed\n", way.name.c_str());
        return false;
      }
      const std::chrono::duration<double, std::micro> elapsed = Clock::now() - start;
      if (round >= 0) way.microseconds.push_back(elapsed.count());
    }
  }
  std::printf("%dx%d, 1 light, %.0f KiB of pictures, %d rounds\n", width, height,
              static_cast<double>(copy.size()) / 1024.0, rounds);
  std::printf("  %-22s %12s %12s %20s\n", "", "p50, us", "p95, us", "p50 beyond library");
  const double library = ways[1].Percentile(0.5);
  for (Way& way : ways) {
    const double p50 = way.Percentile(0.5);
    std::printf("  %-22s %12.1f %12.1f", way.name.c_str(), p50, way.Percentile(0.95));
    if (&way > &ways[1]) std::printf(" %20.1f", p50 - library);
    std::printf("\n");
  }
  return true;
}

int Run(int rounds) {
  KeepLargeBuffers();
  ServerOptions options;
  options.listen = {"127.0.0.1:0", "unix:/tmp/shadowfit_bench_" + std::to_string(getpid())};
  options.lame_duck_seconds = 0.0;
  const auto server = Server::Start(options);
  if (!server.ok()) {
    std::fprintf(stderr, "%s\n", std::string(server.status().message()).c_str());
    return 1;
  }
  const auto channel = (*server)->InProcessChannel();
  return Measure(**server, channel, 180, 180, rounds) && Measure(**server, channel, 1024, 768, rounds) ? 0
                                                                                                       : 1;
}

}  // namespace
}  // namespace shadowfit

int main(int argc, char** argv) { return shadowfit::Run(argc > 1 ? std::max(1, std::atoi(argv[1])) : 200); }
