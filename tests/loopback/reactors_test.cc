// The reactors that all services stand on, with computations that the test holds back.
#include <grpcpp/channel.h>
#include <gtest/gtest.h>

#include <memory>
#include <random>
#include <stop_token>
#include <thread>
#include <vector>

#include "google/rpc/error_details.pb.h"
#include "tests/loopback/gated_service.h"

namespace shadowfit {
namespace {

using namespace std::chrono_literals;
using testing::Eventually;
using testing::GatedService;

ServerOptions TwoWorkers() {
  ServerOptions options;
  options.workers = 2;
  return options;
}

FrameStreamOptions InFlight(int frames, std::chrono::milliseconds timeout = 60s) {
  FrameStreamOptions options;
  options.max_in_flight = frames;
  options.frame_timeout = timeout;
  return options;
}

void Send(FrameStream& stream, uint64_t id) {
  v1::Frame* frame = stream.Acquire();
  ASSERT_NE(frame, nullptr);
  frame->set_frame_id(id);
  ASSERT_TRUE(stream.Submit(frame).ok());
}

bool HasRetryInfo(const absl::Status& status) {
  return status.GetPayload("type.googleapis.com/google.rpc.RetryInfo").has_value();
}

TEST(StreamReactor, ComputesOneFrameAtATimeInTheirOrder) {
  GatedService service(TwoWorkers());
  const auto client = service.Connect();
  const auto stream = client->OpenStream(InFlight(20));
  for (uint64_t id = 1; id <= 20; ++id) Send(*stream, id);
  for (uint64_t id = 1; id <= 20; ++id) {
    service.LetThrough(1);
    const auto outcome = stream->Wait(10s);
    ASSERT_TRUE(outcome && outcome->result.ok());
    EXPECT_EQ(outcome->frame_id, id);
    EXPECT_EQ(outcome->result->frame_id(), id);
  }
  EXPECT_EQ(service.most_at_a_time(), 1);
  EXPECT_TRUE(stream->Finish(10s).ok());
  const std::vector<uint64_t> started = service.started();
  ASSERT_EQ(started.size(), 20U);
  for (uint64_t id = 1; id <= 20; ++id) EXPECT_EQ(started[id - 1], id);
}

/// A channel waits for gRPC's threads when it goes: it must not go on one of them.
TEST(StreamReactor, TheChannelGoesWithTheLastOfItsOwners) {
  GatedService service(TwoWorkers());
  for (int i = 0; i < 300; ++i) {
    auto client = service.ConnectInProcess();
    const std::weak_ptr<grpc::Channel> channel = client->channel();
    auto stream = client->OpenStream();
    Send(*stream, 1);
    if (i % 2 == 0) {
      service.LetThrough(1);
      ASSERT_TRUE(stream->Wait(10s).has_value());
      ASSERT_TRUE(stream->Finish(10s).ok());
    }
    client.reset();
    stream.reset();
    ASSERT_TRUE(channel.expired()) << i;
  }
}

TEST(StreamReactor, DifferentStreamsAreComputedAtOnce) {
  GatedService service(TwoWorkers());
  const auto client = service.Connect();
  const auto first = client->OpenStream();
  const auto second = client->OpenStream();
  Send(*first, 1);
  Send(*second, 1);
  EXPECT_TRUE(Eventually([&] { return service.most_at_a_time() == 2; }));
}

TEST(StreamReactor, HoldsNoMoreFramesThanItsSlots) {
  ServerOptions options = TwoWorkers();
  options.max_frames_in_stream = 2;
  GatedService service(options);
  const auto client = service.Connect();
  const auto stream = client->OpenStream(InFlight(30));
  for (uint64_t id = 1; id <= 30; ++id) Send(*stream, id);
  ASSERT_TRUE(Eventually([&] { return service.context().admission.jobs() == 2; }));
  for (int i = 0; i < 50; ++i) {
    EXPECT_LE(service.context().admission.jobs(), 2);
    std::this_thread::sleep_for(1ms);
  }
  service.LetThrough(30);
  for (int i = 0; i < 30; ++i) {
    const auto outcome = stream->Wait(10s);
    ASSERT_TRUE(outcome && outcome->result.ok());
  }
}

TEST(StreamReactor, ACancelledStreamStopsItsComputation) {
  GatedService service(TwoWorkers());
  const auto client = service.Connect();
  const auto stream = client->OpenStream();
  for (uint64_t id = 1; id <= 3; ++id) Send(*stream, id);
  ASSERT_TRUE(Eventually([&] { return service.started().size() == 1; }));
  stream->Cancel();
  EXPECT_TRUE(Eventually([&] { return service.cancelled() == 1; }));
  EXPECT_TRUE(Eventually([&] { return service.context().streams.count() == 0; }));
  EXPECT_EQ(service.context().admission.jobs(), 0);
  EXPECT_EQ(service.context().admission.bytes(), 0U);
  EXPECT_EQ(service.started().size(), 1U);  // The frames behind it were never begun.
  for (int i = 0; i < 3; ++i) {
    const auto outcome = stream->Poll();
    ASSERT_TRUE(outcome.has_value());
    EXPECT_TRUE(absl::IsCancelled(outcome->result.status()));
  }
}

TEST(StreamReactor, AFrameWhoseDeadlinePassedInTheQueueIsNotBegun) {
  GatedService service(TwoWorkers());
  const auto client = service.Connect();
  const auto stub = v1::OptimizerService::NewStub(client->channel());
  grpc::ClientContext context;
  const auto stream = stub->OptimizeStream(&context);
  v1::OptimizeStreamRequest request;
  for (uint64_t id = 1; id <= 3; ++id) {  // The first has all the time in the world.
    request.mutable_frame()->set_frame_id(id);
    request.set_timeout_seconds(id == 1 ? 0.0 : 0.02);
    ASSERT_TRUE(stream->Write(request));
  }
  ASSERT_TRUE(Eventually([&] { return service.context().admission.jobs() == 3; }));
  std::this_thread::sleep_for(30ms);
  service.LetThrough(1);
  v1::OptimizeStreamResponse response;
  ASSERT_TRUE(stream->Read(&response));
  EXPECT_TRUE(response.has_result());
  for (uint64_t id = 2; id <= 3; ++id) {
    ASSERT_TRUE(stream->Read(&response));
    EXPECT_EQ(response.frame_id(), id);
    EXPECT_EQ(response.error().code(), grpc::StatusCode::DEADLINE_EXCEEDED);
  }
  EXPECT_EQ(service.started().size(), 1U);
  service.LetThrough(1);
  request.mutable_frame()->set_frame_id(4);
  request.set_timeout_seconds(0.0);
  ASSERT_TRUE(stream->Write(request));
  ASSERT_TRUE(stream->Read(&response));
  EXPECT_TRUE(response.has_result());
  stream->WritesDone();
  EXPECT_TRUE(stream->Finish().ok());
}

TEST(StreamReactor, AFramesDeadlineReachesItsComputation) {
  GatedService service(TwoWorkers());
  const auto client = service.Connect();
  // A machine that is busy enough lets a short deadline pass before the work begins.
  for (auto timeout = 50ms; service.started().empty(); timeout *= 2) {
    const auto stream = client->OpenStream(InFlight(1, timeout));
    Send(*stream, 1);
    const auto outcome = stream->Wait(60s);
    ASSERT_TRUE(outcome.has_value());
    EXPECT_TRUE(absl::IsDeadlineExceeded(outcome->result.status())) << outcome->result.status();
    EXPECT_TRUE(Eventually([&] { return service.context().admission.jobs() == 0; }));
  }
  EXPECT_EQ(service.cancelled(), 1);
}

TEST(StreamReactor, AnExceptionFailsItsFrameAlone) {
  GatedService service(TwoWorkers());
  const auto client = service.Connect();
  const auto stream = client->OpenStream();
  service.LetThrough(2);
  service.ThrowNext();
  Send(*stream, 1);
  const auto bad = stream->Wait(10s);
  ASSERT_TRUE(bad.has_value());
  EXPECT_EQ(bad->result.status().code(), absl::StatusCode::kInternal);
  Send(*stream, 2);
  const auto good = stream->Wait(10s);
  ASSERT_TRUE(good.has_value());
  EXPECT_TRUE(good->result.ok());
}

TEST(StreamReactor, ABusyServiceRefusesTheFrameAndKeepsTheStream) {
  ServerOptions options = TwoWorkers();
  options.max_admitted_jobs = 1;
  GatedService service(options);
  const auto client = service.Connect();
  const auto first = client->OpenStream();
  const auto second = client->OpenStream();
  Send(*first, 1);
  ASSERT_TRUE(Eventually([&] { return service.context().admission.jobs() == 1; }));
  Send(*second, 1);
  const auto refused = second->Wait(10s);
  ASSERT_TRUE(refused.has_value());
  EXPECT_TRUE(absl::IsUnavailable(refused->result.status())) << refused->result.status();
  EXPECT_TRUE(HasRetryInfo(refused->result.status()));
  service.LetThrough(2);
  ASSERT_TRUE(first->Wait(10s)->result.ok());
  Send(*second, 2);
  EXPECT_TRUE(second->Wait(10s)->result.ok());
}

TEST(StreamReactor, NoMoreStreamsAreOpenThanAllowed) {
  ServerOptions options = TwoWorkers();
  options.max_streams = 2;
  GatedService service(options);
  service.LetThrough(10);
  const auto client = service.Connect();
  auto first = client->OpenStream();
  const auto second = client->OpenStream();
  ASSERT_TRUE(Eventually([&] { return service.context().streams.count() == 2; }));
  const auto third = client->OpenStream();
  ASSERT_TRUE(Eventually([&] { return !third->status().ok(); }));
  const absl::Status status = third->Finish(10s);
  EXPECT_TRUE(absl::IsUnavailable(status)) << status;
  EXPECT_TRUE(HasRetryInfo(status));
  first.reset();
  ASSERT_TRUE(Eventually([&] { return service.context().streams.count() == 1; }));
  const auto fourth = client->OpenStream();
  Send(*fourth, 1);
  EXPECT_TRUE(fourth->Wait(10s)->result.ok());
  Send(*second, 1);
  EXPECT_TRUE(second->Wait(10s)->result.ok());
}

TEST(StreamReactor, AFrameThatCanNeverFitIsToldSo) {
  ServerOptions options = TwoWorkers();
  options.max_admitted_bytes = 1000;
  GatedService service(options);
  const auto client = service.Connect();
  const auto stream = client->OpenStream();
  v1::Frame* frame = stream->Acquire();
  frame->set_frame_id(1);
  frame->mutable_depth()->mutable_data()->assign(2000, 'x');
  ASSERT_TRUE(stream->Submit(frame).ok());
  const auto outcome = stream->Wait(10s);
  ASSERT_TRUE(outcome.has_value());
  EXPECT_TRUE(absl::IsResourceExhausted(outcome->result.status())) << outcome->result.status();
}

TEST(StreamReactor, AHalfClosedStreamAnswersWhatItHas) {
  GatedService service(TwoWorkers());
  const auto client = service.Connect();
  const auto stream = client->OpenStream();
  for (uint64_t id = 1; id <= 3; ++id) Send(*stream, id);
  std::jthread opener([&service] {
    std::this_thread::sleep_for(50ms);
    service.LetThrough(3);
  });
  EXPECT_TRUE(stream->Finish(20s).ok());
  for (uint64_t id = 1; id <= 3; ++id) {
    const auto outcome = stream->Poll();
    ASSERT_TRUE(outcome && outcome->result.ok());
    EXPECT_EQ(outcome->frame_id, id);
  }
}

TEST(StreamReactor, DrainingAnswersAllThatWasSent) {
  GatedService service(TwoWorkers());
  const auto client = service.Connect();
  const auto stream = client->OpenStream(InFlight(10));
  for (uint64_t id = 1; id <= 10; ++id) Send(*stream, id);  // More than the service has slots.
  ASSERT_TRUE(Eventually([&] { return service.started().size() == 1; }));
  service.context().streams.Drain();
  ASSERT_TRUE(Eventually([&] { return !stream->status().ok(); }));
  EXPECT_TRUE(absl::IsUnavailable(stream->status())) << stream->status();
  v1::Frame* frame = stream->Acquire();
  EXPECT_EQ(frame, nullptr);
  service.LetThrough(10);
  for (uint64_t id = 1; id <= 10; ++id) {
    const auto outcome = stream->Wait(10s);
    ASSERT_TRUE(outcome.has_value());
    EXPECT_TRUE(outcome->result.ok()) << outcome->result.status();
    EXPECT_EQ(outcome->frame_id, id);
  }
  EXPECT_TRUE(service.context().streams.WaitUntilNone(10s));
  frame = stream->Acquire();
  ASSERT_NE(frame, nullptr);
  frame->set_frame_id(11);
  EXPECT_TRUE(absl::IsUnavailable(stream->Submit(frame)));
}

TEST(StreamReactor, AClientThatIgnoresTheDrainNoticeIsEndedAfterItsAnswers) {
  GatedService service(TwoWorkers());
  const auto client = service.Connect();
  const auto stub = v1::OptimizerService::NewStub(client->channel());
  grpc::ClientContext context;
  const auto stream = stub->OptimizeStream(&context);
  v1::OptimizeStreamRequest request;
  request.mutable_frame()->set_frame_id(1);
  ASSERT_TRUE(stream->Write(request));
  ASSERT_TRUE(Eventually([&] { return service.started().size() == 1; }));
  service.context().streams.Drain();
  v1::OptimizeStreamResponse response;
  ASSERT_TRUE(stream->Read(&response));
  EXPECT_TRUE(response.draining());
  service.context().streams.End();
  service.LetThrough(1);
  ASSERT_TRUE(stream->Read(&response));
  EXPECT_EQ(response.frame_id(), 1U);
  EXPECT_TRUE(response.has_result());
  EXPECT_FALSE(stream->Read(&response));
  EXPECT_EQ(stream->Finish().error_code(), grpc::StatusCode::UNAVAILABLE);
  EXPECT_TRUE(service.context().streams.WaitUntilNone(10s));
}

TEST(StreamReactor, AStreamOpenedWhileDrainingIsAskedToEnd) {
  GatedService service(TwoWorkers());
  const auto client = service.Connect();
  service.context().streams.Drain();
  const auto stream = client->OpenStream();
  EXPECT_TRUE(Eventually([&] { return absl::IsUnavailable(stream->status()); }));
  EXPECT_TRUE(service.context().streams.WaitUntilNone(10s));
}

// Streams that end at any moment in any way leave nothing behind.
TEST(StreamReactor, NoStreamIsLeftWhateverItsClientDoes) {
  ServerOptions options;
  options.workers = 4;
  GatedService service(options);
  service.LetThrough(100000);
  std::vector<std::thread> threads;
  for (uint32_t t = 0; t < 4; ++t) {
    threads.emplace_back([&service, t] {
      std::mt19937 random(t);
      const auto client = t % 2 == 0 ? service.Connect() : service.ConnectInProcess();
      for (int round = 0; round < 60; ++round) {
        const auto stream = client->OpenStream();
        uint64_t id = 0;
        for (uint32_t frames = random() % 6; frames > 0; --frames) {
          if (v1::Frame* frame = stream->Acquire()) {
            frame->set_frame_id(++id);
            frame->mutable_depth()->mutable_data()->assign(random() % 20000, 'x');
            ASSERT_TRUE(stream->Submit(frame).ok());
          }
          if (random() % 2 == 0) stream->Wait(std::chrono::milliseconds(random() % 3));
        }
        switch (random() % 3) {
          case 0:
            stream->Cancel();
            break;
          case 1:
            EXPECT_TRUE(stream->Finish(20s).ok());
            break;
          default:
            break;  // The destructor cancels.
        }
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_TRUE(service.context().streams.WaitUntilNone(20s));
  EXPECT_EQ(service.context().admission.jobs(), 0);
  EXPECT_EQ(service.context().admission.bytes(), 0U);
}

TEST(UnaryReactor, ADeadlineReachesTheComputation) {
  GatedService service(TwoWorkers());
  const auto client = service.Connect();
  // A machine that is busy enough lets a short deadline pass before the work begins.
  for (auto timeout = 50ms; service.started().empty(); timeout *= 2) {
    EXPECT_TRUE(absl::IsDeadlineExceeded(client->Optimize({}, {.timeout = timeout, .stop = {}}).status()));
    EXPECT_TRUE(Eventually([&] { return service.context().admission.jobs() == 0; }));
  }
  EXPECT_EQ(service.cancelled(), 1);
}

TEST(UnaryReactor, ACancelReachesTheComputation) {
  GatedService service(TwoWorkers());
  const auto client = service.Connect();
  std::stop_source stop;
  CallOptions options;
  options.stop = stop.get_token();
  std::jthread canceller([&] {
    Eventually([&] { return service.started().size() == 1; });
    stop.request_stop();
  });
  const auto start = std::chrono::steady_clock::now();
  EXPECT_TRUE(absl::IsCancelled(client->Optimize({}, options).status()));
  EXPECT_LT(std::chrono::steady_clock::now() - start, 10s);
  EXPECT_TRUE(Eventually([&] { return service.cancelled() == 1; }));
}

TEST(UnaryReactor, ABusyServiceSaysWhenToTryAgain) {
  ServerOptions options = TwoWorkers();
  options.max_admitted_jobs = 1;
  GatedService service(options);
  const auto client = service.ConnectInProcess();
  std::jthread first([&] { EXPECT_TRUE(client->Optimize({}).ok()); });
  ASSERT_TRUE(Eventually([&] { return service.context().admission.jobs() == 1; }));
  const absl::Status status = client->Optimize({}).status();
  EXPECT_TRUE(absl::IsUnavailable(status)) << status;
  EXPECT_TRUE(HasRetryInfo(status));
  service.LetThrough(2);
  first.join();
  EXPECT_TRUE(client->Optimize({}).ok());
}

/// Answers that the service gave with this code.
double CountAnswers(ServiceContext& context, const std::string& code) {
  double count = 0.0;
  for (const prometheus::MetricFamily& family : context.metrics.registry()->Collect()) {
    if (family.name != "shadowfit_answers_total") continue;
    for (const prometheus::ClientMetric& metric : family.metric) {
      for (const auto& label : metric.label) {
        if (label.name == "code" && label.value == code) count += metric.counter.value;
      }
    }
  }
  return count;
}

TEST(UnaryReactor, TheClientTriesABusyServiceFourTimes) {
  ServerOptions options = TwoWorkers();
  options.max_admitted_jobs = 1;
  GatedService service(options);
  const auto client = service.Connect();
  const auto stream = client->OpenStream();
  Send(*stream, 1);
  ASSERT_TRUE(Eventually([&] { return service.context().admission.jobs() == 1; }));
  EXPECT_TRUE(absl::IsUnavailable(client->Optimize({}).status()));
  EXPECT_EQ(CountAnswers(service.context(), "UNAVAILABLE"), 4.0);
  service.LetThrough(2);
  EXPECT_TRUE(stream->Wait(60s)->result.ok());
  EXPECT_TRUE(client->Optimize({}).ok());
}

TEST(UnaryReactor, AnExceptionIsAnInternalError) {
  GatedService service(TwoWorkers());
  const auto client = service.Connect();
  service.LetThrough(2);
  service.ThrowNext();
  EXPECT_EQ(client->Optimize({}).status().code(), absl::StatusCode::kInternal);
  EXPECT_TRUE(client->Optimize({}).ok());
}

}  // namespace
}  // namespace shadowfit
