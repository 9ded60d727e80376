#include "client/service_stream.h"

#include <gtest/gtest.h>

#include "tests/loopback/gated_service.h"

namespace shadowfit {
namespace {

using namespace std::chrono_literals;
using testing::Eventually;
using testing::GatedService;

TEST(FrameStream, HandsOutNoMoreFramesThanMayBeUnderWay) {
  GatedService service({});
  const auto client = service.Connect();
  const auto stream = client->OpenStream();
  for (uint64_t id = 1; id <= 3; ++id) {
    v1::Frame* frame = stream->Acquire();
    ASSERT_NE(frame, nullptr);
    frame->set_frame_id(id);
    ASSERT_TRUE(stream->Submit(frame).ok());
  }
  EXPECT_EQ(stream->in_flight(), 3);
  EXPECT_EQ(stream->Acquire(), nullptr);
  EXPECT_FALSE(stream->Poll().has_value());
  service.LetThrough(1);
  ASSERT_TRUE(stream->Wait(10s).has_value());
  EXPECT_EQ(stream->in_flight(), 2);
  v1::Frame* frame = stream->Acquire();
  EXPECT_NE(frame, nullptr);
  stream->Discard(frame);
  EXPECT_NE(stream->Acquire(), nullptr);
}

// A slow service must cost a renderer nothing: these calls return at once while it stands still.
TEST(FrameStream, NeverWaitsForTheService) {
  GatedService service({});
  const auto client = service.Connect();
  const auto stream = client->OpenStream();
  const auto start = std::chrono::steady_clock::now();
  uint64_t id = 0;
  for (int i = 0; i < 100; ++i) {
    if (v1::Frame* frame = stream->Acquire()) {
      frame->set_frame_id(++id);
      frame->mutable_depth()->mutable_data()->assign(3 << 20, 'x');
      ASSERT_TRUE(stream->Submit(frame).ok());
    }
    EXPECT_FALSE(stream->Poll().has_value());
  }
  EXPECT_LT(std::chrono::steady_clock::now() - start, 2s);
  EXPECT_EQ(id, 3U);
}

TEST(FrameStream, FramesKeepTheirMemory) {
  GatedService service({});
  service.LetThrough(100);
  const auto client = service.Connect();
  FrameStreamOptions options;
  options.max_in_flight = 1;
  const auto stream = client->OpenStream(options);
  const char* data = nullptr;
  for (uint64_t id = 1; id <= 5; ++id) {
    v1::Frame* frame = nullptr;
    ASSERT_TRUE(Eventually([&] { return (frame = stream->Acquire()) != nullptr; }));
    EXPECT_EQ(frame->frame_id(), 0U);
    EXPECT_FALSE(frame->has_depth() && !frame->depth().data().empty());
    frame->set_frame_id(id);
    frame->mutable_depth()->mutable_data()->resize(1 << 20);
    if (id > 1) {
      EXPECT_EQ(static_cast<const void*>(frame->depth().data().data()), data);
    }
    data = frame->depth().data().data();
    ASSERT_TRUE(stream->Submit(frame).ok());
    ASSERT_TRUE(stream->Wait(10s).has_value());
  }
}

TEST(FrameStream, IdsMustGrow) {
  GatedService service({});
  service.LetThrough(100);
  const auto client = service.Connect();
  const auto stream = client->OpenStream();
  const auto submit = [&](uint64_t id) {
    v1::Frame* frame = stream->Acquire();
    frame->set_frame_id(id);
    return stream->Submit(frame);
  };
  EXPECT_TRUE(absl::IsInvalidArgument(submit(0)));
  EXPECT_TRUE(submit(5).ok());
  EXPECT_TRUE(absl::IsInvalidArgument(submit(5)));
  EXPECT_TRUE(absl::IsInvalidArgument(submit(4)));
  EXPECT_TRUE(submit(6).ok());
  EXPECT_EQ(stream->in_flight(), 2);
  v1::Frame stranger;
  EXPECT_TRUE(absl::IsInvalidArgument(stream->Submit(&stranger)));
}

TEST(FrameStream, AnAnswerAfterTheDeadlineIsIgnored) {
  GatedService service({});
  const auto client = service.Connect();
  FrameStreamOptions options;
  options.frame_timeout = 100ms;
  const auto stream = client->OpenStream(options);
  v1::Frame* frame = stream->Acquire();
  frame->set_frame_id(1);
  ASSERT_TRUE(stream->Submit(frame).ok());
  const auto late = stream->Wait(10s);
  ASSERT_TRUE(late.has_value());
  EXPECT_TRUE(absl::IsDeadlineExceeded(late->result.status()));
  EXPECT_GE(late->round_trip, 100ms);
  EXPECT_TRUE(Eventually([&] { return service.context().admission.jobs() == 0; }));
  EXPECT_FALSE(stream->Poll().has_value());
  EXPECT_EQ(stream->in_flight(), 0);
  EXPECT_TRUE(stream->status().ok());
}

TEST(FrameStream, AServiceThatIsNotThereIsAClearError) {
  const auto channel = GatedService({}).Connect()->channel();  // The service is gone again.
  FrameStream stream(channel, "gone:1", {});
  v1::Frame* frame = stream.Acquire();
  frame->set_frame_id(1);
  if (stream.Submit(frame).ok()) {
    const auto outcome = stream.Wait(5s);
    ASSERT_TRUE(outcome.has_value());
    EXPECT_TRUE(absl::IsUnavailable(outcome->result.status())) << outcome->result.status();
  }
  EXPECT_TRUE(Eventually([&] { return absl::IsUnavailable(stream.status()); }));
  EXPECT_EQ(std::string(stream.status().message()).find("gone:1: "), 0U) << stream.status();
}

TEST(Client, SaysWhatItCannotReach) {
  EXPECT_TRUE(absl::IsInvalidArgument(Client::Connect("").status()));
  EXPECT_TRUE(absl::IsInvalidArgument(Client::Connect("localhost").status()));
  const absl::Status status = Client::Connect("127.0.0.1:1", {.connect_timeout = 200ms}).status();
  EXPECT_TRUE(absl::IsUnavailable(status));
  EXPECT_NE(status.message().find("127.0.0.1:1"), absl::string_view::npos);
}

}  // namespace
}  // namespace shadowfit
