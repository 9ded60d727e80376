#include <cstdio>
#include <memory>
#include <string>

#include "client/cli/commands.h"
#include "client/cli/progress_bar.h"
#include "client/demo/demo.h"
#include "client/embedded/service_connection.h"
#include "client/scene_io/load_scene.h"

namespace shadowfit {
namespace {

struct DemoArguments {
  std::string scene = "sterngarten";
  std::string server;
  std::string out = "shadowfit-demo";
  DemoOptions options;
};

void RunDemoCommand(const DemoArguments& arguments, bool json) {
  const Scene scene = ValueOrThrow(LoadScene(arguments.scene));
  const auto service = ValueOrThrow(ServiceConnection::Open(arguments.server));
  DemoResult result;
  {
    ProgressBar progress(scene.name);
    result = ValueOrThrow(RunDemo(scene, service->client(), arguments.options, arguments.out,
                                  [&](int done, int total) { progress.Show(done, total); }));
  }
  if (json) {
    nlohmann::json document = DemoJson(result.scene, result.light_names, result.records);
    document["resolution"] = ResolutionJson(result.resolution);
    document["masks"] = MaskJson(result.masks);
    PrintJson(document);
    return;
  }
  std::fputs(DemoTable(result.light_names, result.records).c_str(), stdout);
  std::fputs(ResolutionTable(result.resolution).c_str(), stdout);
  std::fputs(MaskTable(result.masks).c_str(), stdout);
  std::printf("\nSee %s/report.html; pictures are in %s/frames.\n", arguments.out.c_str(),
              arguments.out.c_str());
}

}  // namespace

void AddDemoCommand(CLI::App& app) {
  auto arguments = std::make_shared<DemoArguments>();
  CLI::App* command = app.add_subcommand(
      "demo", "Walk through a scene, compare shadow maps with true shadows, and write a report");
  command->add_option("--scene", arguments->scene, "A scene's name (sterngarten, plaza, ...) or a model file")
      ->capture_default_str()
      ->type_name("NAME|FILE");
  command->add_option("--frames", arguments->options.frames, "Length of the walk")
      ->check(CLI::Range(1, 100000))
      ->capture_default_str();
  command->add_option("--lights", arguments->options.lights, "The sun and so many lamps less one")
      ->check(CLI::Range(1, 32))
      ->capture_default_str();
  command->add_option("--out", arguments->out, "Folder for frames, matrices.json and report.html")
      ->capture_default_str()
      ->type_name("DIR");
  AddServerOption(*command, arguments->server);
  command->callback([command, arguments] { RunDemoCommand(*arguments, JsonRequested(*command)); });
}

}  // namespace shadowfit
