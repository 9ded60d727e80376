#pragma once

#include <grpcpp/support/status.h>

#include <string>

#include "absl/status/status.h"
#include "google/rpc/status.pb.h"

namespace shadowfit {

/// The same error as absl has it: the code, the message behind "`service`: ", and each detail as a payload
/// under its type URL.
absl::Status StatusFromGrpc(const grpc::Status& status, const std::string& service);
absl::Status StatusFromProto(const google::rpc::Status& status, const std::string& service);

}  // namespace shadowfit
