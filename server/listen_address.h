#pragma once

#include <string>

#include "absl/status/status.h"

namespace shadowfit {

/// Whether nobody outside this machine can reach the address: a Unix socket, 127.0.0.0/8, [::1] or localhost.
bool IsLocalAddress(const std::string& address);

/// InvalidArgument, naming `option`, where `address` is neither "HOST:PORT" nor "unix:PATH", or where
/// plaintext would leave this machine and `allow_plaintext` does not say so.
absl::Status CheckListenAddress(const std::string& option, const std::string& address, bool allow_plaintext);

}  // namespace shadowfit
