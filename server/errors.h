#pragma once

#include <google/protobuf/message.h>
#include <grpcpp/support/status.h>

#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "google/rpc/status.pb.h"

namespace shadowfit {

/// Adds an error detail as a payload of the status; the conversions below send it along.
void AttachDetail(const google::protobuf::Message& detail, absl::Status& status);

/// Unavailable with a google.rpc.RetryInfo: this replica has no room now.
absl::Status BusyError(std::string_view message);

/// InvalidArgument messages begin with the field's path, as "lights[2].id: 7 is not unique". This adds the
/// same as a google.rpc.BadRequest; `parent` is the path from the request to the message that the error
/// speaks of, as "frame". Other errors, and those with a BadRequest already, stay as they are.
absl::Status WithFieldViolation(absl::Status status, std::string_view parent);

grpc::Status GrpcFromStatus(const absl::Status& status);
google::rpc::Status ProtoFromStatus(const absl::Status& status);

}  // namespace shadowfit
