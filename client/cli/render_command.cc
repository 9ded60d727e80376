#include <cstdio>
#include <fstream>
#include <iterator>
#include <memory>
#include <string>

#include "absl/strings/str_cat.h"
#include "client/cli/commands.h"
#include "client/cli/frame_files.h"
#include "client/cli/progress_bar.h"
#include "client/demo/render_path.h"
#include "client/embedded/service_connection.h"
#include "client/scene_io/load_scene.h"

namespace shadowfit {
namespace {

struct RenderArguments {
  std::string scene;
  std::string path;
  std::string method = "default";
  std::string out;
  std::string server;
  int latency = 2;
};

CameraPath ReadPath(const std::string& name) {
  std::ifstream file(name, std::ios::binary);
  if (!file) ThrowIfError(absl::NotFoundError(absl::StrCat(name, ": cannot be read")));
  const std::string text((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
  absl::StatusOr<CameraPath> path = ParseCameraPath(text);
  if (!path.ok()) ThrowIfError(absl::InvalidArgumentError(absl::StrCat(name, ": ", path.status().message())));
  return *std::move(path);
}

void RunRenderCommand(const RenderArguments& arguments, bool json) {
  const CameraPath path = ReadPath(arguments.path);
  const v1::Method method = ValueOrThrow(WireMethodFromName(arguments.method));
  const Scene scene = ValueOrThrow(LoadScene(arguments.scene));
  const auto service = ValueOrThrow(ServiceConnection::Open(arguments.server));
  RenderedPath rendered;
  {
    ProgressBar progress(scene.name);
    rendered =
        ValueOrThrow(RenderPath(scene, service->client(), path, method, arguments.latency, arguments.out,
                                [&](int done, int total) { progress.Show(done, total); }));
  }
  if (json) {
    PrintJson({{"scene", scene.name},
               {"method", arguments.method},
               {"frames", rendered.frames},
               {"lights", rendered.lights},
               {"framesPerSecond", rendered.frames_per_second},
               {"out", arguments.out}});
  } else {
    std::printf("%zu frames of %s under %zu lights with %s, %.2f a second, in %s\n", rendered.frames,
                scene.name.c_str(), rendered.lights, arguments.method.c_str(), rendered.frames_per_second,
                arguments.out.c_str());
  }
}

}  // namespace

void AddRenderCommand(CLI::App& app) {
  auto arguments = std::make_shared<RenderArguments>();
  CLI::App* command = app.add_subcommand("render", "Draw a camera path with the shadow maps of one method");
  command->add_option("--scene", arguments->scene, "A scene's name (sterngarten, plaza, ...) or a model file")
      ->required()
      ->type_name("NAME|FILE");
  command->add_option("--path", arguments->path, "Cameras and lights; see client/demo/camera_path.h")
      ->required()
      ->type_name("PATH.json");
  command->add_option("--method", arguments->method, "How to make the matrices")
      ->check(CLI::IsMember(MethodNames()))
      ->capture_default_str()
      ->type_name("M");
  command->add_option("--out", arguments->out, "Folder for the pictures and matrices.json")
      ->required()
      ->type_name("DIR");
  command
      ->add_option("--latency", arguments->latency,
                   "Draw each frame with the answer for the frame so many before it")
      ->check(CLI::Range(0, 16))
      ->capture_default_str();
  AddServerOption(*command, arguments->server);
  command->callback([command, arguments] { RunRenderCommand(*arguments, JsonRequested(*command)); });
}

}  // namespace shadowfit
