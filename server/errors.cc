#include "server/errors.h"

#include <utility>

#include "absl/strings/cord.h"
#include "absl/strings/str_cat.h"
#include "google/rpc/error_details.pb.h"

namespace shadowfit {
namespace {

std::string TypeUrl(const google::protobuf::Message& message) {
  return absl::StrCat("type.googleapis.com/", message.GetDescriptor()->full_name());
}

// About the time of a few frames: soon enough for a renderer, rare enough to let the queue drain.
constexpr int kRetryMilliseconds = 50;

}  // namespace

void AttachDetail(const google::protobuf::Message& detail, absl::Status& status) {
  status.SetPayload(TypeUrl(detail), absl::Cord(detail.SerializeAsString()));
}

absl::Status BusyError(std::string_view message) {
  google::rpc::RetryInfo retry;
  retry.mutable_retry_delay()->set_nanos(kRetryMilliseconds * 1'000'000);
  absl::Status status = absl::UnavailableError(absl::string_view(message.data(), message.size()));
  AttachDetail(retry, status);
  return status;
}

absl::Status WithFieldViolation(absl::Status status, std::string_view parent) {
  google::rpc::BadRequest bad_request;
  if (!absl::IsInvalidArgument(status) || status.GetPayload(TypeUrl(bad_request))) return status;
  const std::string message(status.message());
  const size_t colon = message.find(": ");
  if (colon == std::string::npos) return status;
  google::rpc::BadRequest::FieldViolation& violation = *bad_request.add_field_violations();
  const std::string path = message.substr(0, colon);
  violation.set_field(parent.empty() || path == parent ? path : std::string(parent) + "." + path);
  violation.set_description(message.substr(colon + 2));
  AttachDetail(bad_request, status);
  return status;
}

google::rpc::Status ProtoFromStatus(const absl::Status& status) {
  google::rpc::Status result;
  result.set_code(static_cast<int>(status.code()));
  result.set_message(std::string(status.message()));
  status.ForEachPayload([&result](absl::string_view type_url, const absl::Cord& payload) {
    google::protobuf::Any& detail = *result.add_details();
    detail.set_type_url(std::string(type_url));
    detail.set_value(std::string(payload));
  });
  return result;
}

grpc::Status GrpcFromStatus(const absl::Status& status) {
  if (status.ok()) return grpc::Status::OK;
  // Both code lists are the canonical one.
  return {static_cast<grpc::StatusCode>(status.code()), std::string(status.message()),
          ProtoFromStatus(status).SerializeAsString()};
}

}  // namespace shadowfit
