#include "client/cli/commands.h"

#include <spdlog/spdlog.h>

#include <chrono>
#include <cstdint>
#include <cstdio>

namespace shadowfit {

bool JsonRequested(const CLI::App& command) {
  const CLI::App* root = &command;
  while (root->get_parent() != nullptr) root = root->get_parent();
  return root->count("--json") > 0;
}

CLI::Option* AddServerOption(CLI::App& command, std::string& address) {
  return command
      .add_option("--server", address,
                  "Service to use, HOST:PORT or unix:PATH; without it, one in this process")
      ->type_name("ADDR");
}

CLI::Option* AddTimeoutOption(CLI::App& command, double& seconds) {
  return command.add_option("--timeout", seconds, "Give up after so many seconds")
      ->check(CLI::Range(0.001, 86400.0))
      ->capture_default_str();
}

CallOptions CallWithin(double seconds) {
  CallOptions call;
  call.timeout = std::chrono::milliseconds(static_cast<int64_t>(seconds * 1e3));
  return call;
}

void PrintJson(const nlohmann::json& document) {
  const std::string text = document.dump(2) + "\n";
  std::fwrite(text.data(), 1, text.size(), stdout);
}

void ThrowIfError(const absl::Status& status) {
  if (status.ok()) return;
  spdlog::error("{}: {}", absl::StatusCodeToString(status.code()), std::string(status.message()));
  throw CLI::RuntimeError(1);
}

}  // namespace shadowfit
