#include "server/admission.h"

#include <gtest/gtest.h>

#include <utility>
#include <vector>

#include "google/rpc/error_details.pb.h"

namespace shadowfit {
namespace {

TEST(Admission, CountsJobsAndGivesRoomBack) {
  Admission admission(1000, 2);
  auto first = admission.Admit(10);
  auto second = admission.Admit(20);
  ASSERT_TRUE(first.ok() && second.ok());
  EXPECT_EQ(admission.bytes(), 30U);
  EXPECT_EQ(admission.jobs(), 2);
  EXPECT_EQ(admission.Admit(1).status().code(), absl::StatusCode::kUnavailable);
  *first = Admission::Ticket();
  EXPECT_EQ(admission.bytes(), 20U);
  EXPECT_TRUE(admission.Admit(1).ok());
  EXPECT_EQ(admission.jobs(), 1);  // That ticket went at once.
}

TEST(Admission, CountsBytesToTheLastOne) {
  Admission admission(100, 10);
  const auto first = admission.Admit(60);
  ASSERT_TRUE(first.ok());
  EXPECT_EQ(admission.Admit(41).status().code(), absl::StatusCode::kUnavailable);
  EXPECT_TRUE(admission.Admit(40).ok());
}

TEST(Admission, TellsBusyFromNever) {
  Admission admission(100, 1);
  const auto first = admission.Admit(100);
  ASSERT_TRUE(first.ok());
  EXPECT_EQ(admission.Admit(101).status().code(), absl::StatusCode::kResourceExhausted);
  const absl::Status busy = admission.Admit(100).status();
  EXPECT_EQ(busy.code(), absl::StatusCode::kUnavailable);
  const auto payload = busy.GetPayload("type.googleapis.com/google.rpc.RetryInfo");
  ASSERT_TRUE(payload.has_value());
  google::rpc::RetryInfo retry;
  ASSERT_TRUE(retry.ParseFromString(std::string(*payload)));
  EXPECT_GT(retry.retry_delay().nanos(), 0);
}

TEST(Admission, TicketsMoveWithoutCountingTwice) {
  Admission admission(100, 10);
  {
    std::vector<Admission::Ticket> tickets;
    for (int i = 0; i < 5; ++i) tickets.push_back(*admission.Admit(10));
    Admission::Ticket moved = std::move(tickets[2]);
    tickets.erase(tickets.begin());
    EXPECT_EQ(admission.jobs(), 4);
    EXPECT_EQ(admission.bytes(), 40U);
  }
  EXPECT_EQ(admission.jobs(), 0);
  EXPECT_EQ(admission.bytes(), 0U);
}

}  // namespace
}  // namespace shadowfit
