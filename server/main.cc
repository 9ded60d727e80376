#include <spdlog/cfg/env.h>
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>

#include <csignal>
#include <exception>

#include "server/flags.h"
#include "server/server.h"

namespace {

// One `key=value` line an event, so that people and log collectors can read it.
void SetUpLog() {
  spdlog::set_default_logger(spdlog::stderr_color_mt("shadowfit-server"));
  spdlog::set_pattern("ts=%Y-%m-%dT%H:%M:%S.%e%z level=%l %v");
  spdlog::cfg::load_env_levels();
}

int Run(const shadowfit::ServerOptions& options, const sigset_t& stop_signals) {
  absl::StatusOr<std::unique_ptr<shadowfit::Server>> server = shadowfit::Server::Start(options);
  if (!server.ok()) {
    spdlog::error("event=cannot_start reason=\"{}\"", std::string(server.status().message()));
    return 1;
  }
  for (const std::string& address : (*server)->addresses())
    spdlog::info("event=listening address={}", address);
  int signal = 0;
  sigwait(&stop_signals, &signal);
  spdlog::info("event=draining signal={}", signal);
  (*server)->Drain();
  spdlog::info("event=stopped");
  return 0;
}

}  // namespace

// What may be thrown before the `try` is a mistake in our flags, which every start would show.
// NOLINTNEXTLINE(bugprone-exception-escape)
int main(int argc, char** argv) {
  // Before any thread starts, so that all of them inherit the mask and the signals wait for sigwait.
  sigset_t stop_signals;
  sigemptyset(&stop_signals);
  sigaddset(&stop_signals, SIGTERM);
  sigaddset(&stop_signals, SIGINT);
  pthread_sigmask(SIG_BLOCK, &stop_signals, nullptr);
  SetUpLog();
  shadowfit::KeepLargeBuffers();

  CLI::App app{"Fits shadow maps to what the camera sees, as a service.", "shadowfit-server"};
  app.set_version_flag("--version", SHADOWFIT_VERSION);
  shadowfit::ServerOptions options;
  bool check_config = false;
  shadowfit::AddServerFlags(app, options);
  app.add_flag("--check-config", check_config,
               "Say whether the flags and the configuration file are valid, and end")
      ->configurable(false);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error);
  }
  if (check_config) {
    const absl::Status status = shadowfit::CheckServerOptions(options);
    if (status.ok()) return 0;
    spdlog::error("event=bad_config reason=\"{}\"", std::string(status.message()));
    return 1;
  }
  try {
    return Run(options, stop_signals);
  } catch (const std::exception& error) {
    spdlog::error("event=failed reason=\"{}\"", error.what());
    return 1;
  }
}
