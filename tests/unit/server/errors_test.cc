#include "server/errors.h"

#include <gtest/gtest.h>

#include "google/rpc/error_details.pb.h"

namespace shadowfit {
namespace {

google::rpc::BadRequest BadRequestOf(const google::rpc::Status& status) {
  google::rpc::BadRequest bad_request;
  for (const auto& detail : status.details()) detail.UnpackTo(&bad_request);
  return bad_request;
}

TEST(Errors, InvalidArgumentNamesItsFieldTwice) {
  const absl::Status status =
      WithFieldViolation(absl::InvalidArgumentError("lights[2].spot.direction: zero-length vector"), "frame");
  const google::rpc::Status wire = ProtoFromStatus(status);
  EXPECT_EQ(wire.code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(wire.message(), "lights[2].spot.direction: zero-length vector");
  const google::rpc::BadRequest bad_request = BadRequestOf(wire);
  ASSERT_EQ(bad_request.field_violations_size(), 1);
  EXPECT_EQ(bad_request.field_violations(0).field(), "frame.lights[2].spot.direction");
  EXPECT_EQ(bad_request.field_violations(0).description(), "zero-length vector");
}

TEST(Errors, OtherErrorsGetNoFieldViolation) {
  const absl::Status status = WithFieldViolation(absl::UnavailableError("busy: later"), "frame");
  EXPECT_EQ(ProtoFromStatus(status).details_size(), 0);
}

TEST(Errors, AFieldViolationIsNotAddedTwice) {
  absl::Status status = WithFieldViolation(absl::InvalidArgumentError("timeout_seconds: -1"), "");
  status = WithFieldViolation(status, "frame");
  const google::rpc::BadRequest bad_request = BadRequestOf(ProtoFromStatus(status));
  ASSERT_EQ(bad_request.field_violations_size(), 1);
  EXPECT_EQ(bad_request.field_violations(0).field(), "timeout_seconds");
}

TEST(Errors, AllCodesMapOneToOne) {
  for (int code = 0; code <= 16; ++code) {
    const absl::Status status(static_cast<absl::StatusCode>(code), "m");
    EXPECT_EQ(GrpcFromStatus(status).error_code(), code);
    EXPECT_EQ(ProtoFromStatus(status).code(), code);
  }
}

TEST(Errors, DetailsTravelInGrpcStatus) {
  const grpc::Status status = GrpcFromStatus(WithFieldViolation(absl::InvalidArgumentError("a.b: c"), ""));
  google::rpc::Status wire;
  ASSERT_TRUE(wire.ParseFromString(status.error_details()));
  EXPECT_EQ(BadRequestOf(wire).field_violations(0).field(), "a.b");
}

}  // namespace
}  // namespace shadowfit
