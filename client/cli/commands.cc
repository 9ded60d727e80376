#include "client/cli/commands.h"

#include <spdlog/spdlog.h>

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
