#include <chrono>
#include <memory>
#include <string>

#include "absl/strings/str_format.h"
#include "client/cli/commands.h"
#include "client/embedded/service_connection.h"
#include "client/scene_io/load_scene.h"
#include "client/scene_io/scene_to_wire.h"

namespace shadowfit {
namespace {

struct SceneArguments {
  std::string scene;
  std::string digest;
  std::string server;
};

nlohmann::json SceneJson(const v1::SceneInfo& scene) {
  return {{"digest", scene.digest()},
          {"triangles", scene.triangles()},
          {"instances", scene.instances()},
          {"bytes", scene.bytes()},
          {"uses", scene.uses()}};
}

void PrintScene(const v1::SceneInfo& scene) {
  absl::PrintF("%s  %9d triangles  %6d instances  %8.1f MB  %d uses\n", scene.digest(), scene.triangles(),
               scene.instances(), 1e-6 * static_cast<double>(scene.bytes()), scene.uses());
}

void Put(const SceneArguments& arguments, bool json) {
  const PackedScene scene = PackScene(SceneToWire(ValueOrThrow(LoadScene(arguments.scene))));
  const auto service = ValueOrThrow(ServiceConnection::Open(arguments.server));
  CallOptions call;
  call.timeout = std::chrono::minutes(5);
  const v1::UploadSceneResponse uploaded = ValueOrThrow(service->client().UploadScene(scene, call));
  if (json) {
    nlohmann::json document = SceneJson(uploaded.scene());
    document["existed"] = uploaded.existed();
    return PrintJson(document);
  }
  PrintScene(uploaded.scene());
  if (uploaded.existed()) absl::PrintF("The service had it already.\n");
}

void List(const SceneArguments& arguments, bool json) {
  const auto service = ValueOrThrow(ServiceConnection::Open(arguments.server));
  const v1::ListScenesResponse list = ValueOrThrow(service->client().ListScenes());
  if (json) {
    nlohmann::json scenes = nlohmann::json::array();
    for (const v1::SceneInfo& scene : list.scenes()) scenes.push_back(SceneJson(scene));
    return PrintJson({{"scenes", scenes}, {"bytes", list.bytes()}, {"quotaBytes", list.quota_bytes()}});
  }
  for (const v1::SceneInfo& scene : list.scenes()) PrintScene(scene);
  absl::PrintF("%d scene%s, %.1f of %.1f MB\n", list.scenes_size(), list.scenes_size() == 1 ? "" : "s",
               1e-6 * static_cast<double>(list.bytes()), 1e-6 * static_cast<double>(list.quota_bytes()));
}

void Remove(const SceneArguments& arguments, bool json) {
  const auto service = ValueOrThrow(ServiceConnection::Open(arguments.server));
  ThrowIfError(service->client().DeleteScene(arguments.digest));
  if (json) PrintJson({{"deleted", arguments.digest}});
}

}  // namespace

void AddSceneCommand(CLI::App& app) {
  auto arguments = std::make_shared<SceneArguments>();
  CLI::App* scene = app.add_subcommand("scene", "Keep scenes in a running service");
  scene->require_subcommand(1);
  const auto add = [&](const char* name, const char* what, void (*run)(const SceneArguments&, bool)) {
    CLI::App* command = scene->add_subcommand(name, what);
    AddServerOption(*command, arguments->server)->required();
    command->callback([command, arguments, run] { run(*arguments, JsonRequested(*command)); });
    return command;
  };
  add("put", "Upload a scene; prints its digest", Put)
      ->add_option("scene", arguments->scene, "plaza, sterngarten, ..., or a file")
      ->required()
      ->type_name("NAME|FILE");
  add("list", "Scenes that the service has, most recently used first", List);
  add("rm", "Forget a scene", Remove)
      ->add_option("digest", arguments->digest, "As put printed it")
      ->required();
}

}  // namespace shadowfit
