#include "client/grpc_status.h"

#include "absl/strings/cord.h"
#include "absl/strings/str_cat.h"

namespace shadowfit {
namespace {

// The two code lists are one and the same by design; a number outside it must not become OK.
absl::StatusCode CodeFromNumber(int number) {
  const auto code = static_cast<absl::StatusCode>(number);
  return absl::StatusCodeToString(code).empty() ? absl::StatusCode::kUnknown : code;
}

void AttachDetails(const google::rpc::Status& source, absl::Status& status) {
  for (const google::protobuf::Any& detail : source.details()) {
    status.SetPayload(detail.type_url(), absl::Cord(detail.value()));
  }
}

}  // namespace

absl::Status StatusFromGrpc(const grpc::Status& status, const std::string& service) {
  if (status.ok()) return absl::OkStatus();
  absl::Status result(CodeFromNumber(status.error_code()),
                      absl::StrCat(service, ": ", status.error_message()));
  google::rpc::Status details;
  if (!status.error_details().empty() && details.ParseFromString(status.error_details())) {
    AttachDetails(details, result);
  }
  return result;
}

absl::Status StatusFromProto(const google::rpc::Status& status, const std::string& service) {
  const absl::StatusCode code =
      status.code() == 0 ? absl::StatusCode::kUnknown : CodeFromNumber(status.code());
  absl::Status result(code, absl::StrCat(service, ": ", status.message()));
  AttachDetails(status, result);
  return result;
}

}  // namespace shadowfit
