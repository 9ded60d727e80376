#include <spdlog/cfg/env.h>
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>

#include <exception>

#include "client/cli/commands.h"

// What may be thrown before the `try` is a mistake in our flags, which every start would show.
// NOLINTNEXTLINE(bugprone-exception-escape)
int main(int argc, char** argv) {
  spdlog::set_default_logger(spdlog::stderr_color_mt("shadowfit"));
  spdlog::set_pattern("%^%l%$ %v");
  spdlog::cfg::load_env_levels();

  CLI::App app{"Fits shadow maps to what the camera sees.", "shadowfit"};
  app.set_version_flag("--version", SHADOWFIT_VERSION);
  bool json = false;  // Commands ask JsonRequested().
  app.add_flag("--json", json, "Print one JSON document on stdout instead of a table");
  app.fallthrough();  // Global flags may stand behind the command's name.
  app.require_subcommand(1);

  // One line a command, in alphabetical order.
  shadowfit::AddCompareCommand(app);
  shadowfit::AddDemoCommand(app);
  shadowfit::AddInfoCommand(app);
  shadowfit::AddMaskCommand(app);
  shadowfit::AddOptimizeCommand(app);
  shadowfit::AddRenderCommand(app);
  shadowfit::AddResolutionCommand(app);
  shadowfit::AddSceneCommand(app);

  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error);
  } catch (const std::exception& error) {
    spdlog::error("{}", error.what());
    return 1;
  }
  return 0;
}
