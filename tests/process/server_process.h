#pragma once

#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "tests/support/process.h"

namespace shadowfit::testing {

/// A shadowfit-server on a free port of this machine.
class ServerProcess {
 public:
  explicit ServerProcess(std::vector<std::string> flags = {}) : process_(Arguments(std::move(flags))) {
    const auto address = process_.ReadErrorAfter("event=listening address=");
    if (!address) throw std::runtime_error("shadowfit-server did not start");
    address_ = *address;
  }

  const std::string& address() const { return address_; }
  Process& process() { return process_; }

 private:
  static std::vector<std::string> Arguments(std::vector<std::string> flags) {
    flags.insert(flags.begin(), {SHADOWFIT_SERVER_PROGRAM, "--listen", "127.0.0.1:0"});
    return flags;
  }

  Process process_;
  std::string address_;
};

}  // namespace shadowfit::testing
