#include "server/listen_address.h"

#include <arpa/inet.h>
#include <netinet/in.h>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"

namespace shadowfit {
namespace {

constexpr char kUnixPrefix[] = "unix:";

// "HOST:PORT" or "[V6]:PORT".
bool SplitHostPort(const std::string& address, std::string* host, std::string* port) {
  const size_t colon = address.rfind(':');
  if (colon == std::string::npos || colon == 0) return false;
  *host = address.substr(0, colon);
  *port = address.substr(colon + 1);
  if (host->front() == '[' && host->back() == ']') {
    *host = host->substr(1, host->size() - 2);
  } else if (absl::StrContains(*host, ':')) {
    return false;
  }
  return !host->empty() && !port->empty();
}

}  // namespace

bool IsLocalAddress(const std::string& address) {
  if (absl::StartsWith(address, kUnixPrefix)) return true;
  std::string host;
  std::string port;
  if (!SplitHostPort(address, &host, &port)) return false;
  if (host == "localhost") return true;
  in_addr v4{};
  if (inet_pton(AF_INET, host.c_str(), &v4) == 1) return (ntohl(v4.s_addr) >> 24) == 127;
  in6_addr v6{};
  return inet_pton(AF_INET6, host.c_str(), &v6) == 1 && IN6_IS_ADDR_LOOPBACK(&v6);
}

absl::Status CheckListenAddress(const std::string& option, const std::string& address, bool allow_plaintext) {
  if (absl::StartsWith(address, kUnixPrefix)) {
    // The limit is sockaddr_un's.
    const size_t length = address.size() - (sizeof(kUnixPrefix) - 1);
    if (length >= 1 && length <= 107) return absl::OkStatus();
    return absl::InvalidArgumentError(
        absl::StrCat(option, ": the path of ", address, " must have 1 to 107 bytes"));
  }
  std::string host;
  std::string port;
  uint32_t number = 0;
  if (!SplitHostPort(address, &host, &port) || !absl::SimpleAtoi(port, &number) || number > 65535) {
    return absl::InvalidArgumentError(absl::StrCat(
        option, ": '", address, "' is neither HOST:PORT with a port of 0 to 65535 nor unix:PATH"));
  }
  if (allow_plaintext || IsLocalAddress(address)) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(option, ": ", address,
                   " would send plaintext beyond this machine; if the network is "
                   "trusted, say so with --allow-plaintext"));
}

}  // namespace shadowfit
