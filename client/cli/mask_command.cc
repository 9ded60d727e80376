#include <cstdio>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/commands.h"
#include "client/cli/frame_files.h"
#include "client/cli/mask_picture.h"
#include "client/embedded/service_connection.h"
#include "client/scene_io/load_scene.h"
#include "client/scene_io/scene_to_wire.h"

namespace shadowfit {
namespace {

struct MaskArguments {
  std::string frame;
  std::string depth;
  std::string scene;
  std::string out;
  v1::MaskOutput output = v1::MASK_OUTPUT_BITS;
  v1::MaskMethod method = v1::MASK_METHOD_DEFAULT;
  std::string server;
  double timeout_seconds = 60.0;
};

nlohmann::json MaskJson(const v1::MaskResult& result, const std::vector<std::string>& files) {
  nlohmann::json lights = nlohmann::json::array();
  for (int i = 0; i < result.lights_size(); ++i) {
    const v1::LightMask& mask = result.lights(i);
    nlohmann::json light = {{"id", mask.id()},
                            {"samples", mask.samples()},
                            {"shadowedSamples", mask.shadowed_samples()},
                            {"undecidedSamples", mask.undecided_samples()},
                            {"outsideConeSamples", mask.outside_cone_samples()},
                            {"milliseconds", 1e3 * mask.seconds()}};
    if (!files.empty()) light["file"] = files[static_cast<size_t>(i)];
    lights.push_back(light);
  }
  return {{"width", result.width()},
          {"height", result.height()},
          {"lights", lights},
          {"totalMilliseconds", 1e3 * result.timings().total_seconds()}};
}

void RunMask(const MaskArguments& arguments, bool json) {
  v1::Frame from_files = ValueOrThrow(ReadFrameFiles(arguments.frame, arguments.depth, ""));
  const PackedScene scene = PackScene(SceneToWire(ValueOrThrow(LoadScene(arguments.scene))));
  v1::MaskFrame frame;
  frame.set_frame_id(from_files.frame_id());
  frame.set_scene_digest(scene.digest);
  *frame.mutable_camera() = std::move(*from_files.mutable_camera());
  *frame.add_layers()->mutable_depth() = std::move(*from_files.mutable_depth());
  *frame.mutable_lights() = std::move(*from_files.mutable_lights());
  frame.set_output(arguments.output);
  frame.set_method(arguments.method);
  const auto service = ValueOrThrow(ServiceConnection::Open(arguments.server));
  const v1::MaskResult result =
      ValueOrThrow(service->client().RenderMasks(frame, &scene, CallWithin(arguments.timeout_seconds)));

  std::vector<std::string> files;
  if (!arguments.out.empty()) {
    std::error_code error;
    std::filesystem::create_directories(arguments.out, error);
    if (error) ThrowIfError(absl::UnavailableError(absl::StrCat(arguments.out, ": ", error.message())));
    for (const v1::LightMask& mask : result.lights()) {
      const auto file = std::filesystem::path(arguments.out) / absl::StrCat("light", mask.id(), ".png");
      ThrowIfError(WriteMaskPicture(file, result, mask));
      files.push_back(file.string());
    }
  }
  if (json) return PrintJson(MaskJson(result, files));
  absl::PrintF("%10s  %10s  %10s  %10s  %9s  %s\n", "light", "samples", "in shadow", "undecided", "ms",
               "file");
  for (int i = 0; i < result.lights_size(); ++i) {
    const v1::LightMask& mask = result.lights(i);
    absl::PrintF("%10d  %10d  %10d  %10d  %9.3f  %s\n", mask.id(), mask.samples(), mask.shadowed_samples(),
                 mask.undecided_samples(), 1e3 * mask.seconds(),
                 files.empty() ? "" : files[static_cast<size_t>(i)]);
  }
}

}  // namespace

void AddMaskCommand(CLI::App& app) {
  auto arguments = std::make_shared<MaskArguments>();
  CLI::App* command = app.add_subcommand("mask", "Render alias-free shadow masks of one frame of a scene");
  command->add_option("--frame", arguments->frame, "shadowfit.v1.Frame as Protobuf JSON, without its buffers")
      ->required()
      ->type_name("FRAME.json");
  command->add_option("--depth", arguments->depth, "Window depth, one float channel, at full resolution")
      ->required()
      ->type_name("DEPTH.exr");
  command->add_option("--scene", arguments->scene, "Casters: plaza, sterngarten, ..., or a file")
      ->required()
      ->type_name("NAME|FILE");
  command->add_option("--out", arguments->out, "Write one picture a light: 0 = lit, 255 = in shadow")
      ->type_name("DIR");
  const std::map<std::string, v1::MaskOutput> outputs = {{"bits", v1::MASK_OUTPUT_BITS},
                                                         {"rgb", v1::MASK_OUTPUT_TRANSMITTANCE}};
  command
      ->add_option("--output", arguments->output,
                   "bits, or rgb: the light that semi-transparent casters let through")
      ->transform(CLI::CheckedTransformer(outputs))
      ->type_name("WHAT");
  const std::map<std::string, v1::MaskMethod> methods = {{"default", v1::MASK_METHOD_DEFAULT},
                                                         {"bsp", v1::MASK_METHOD_BSP},
                                                         {"exhaustive", v1::MASK_METHOD_EXHAUSTIVE}};
  command->add_option("--method", arguments->method, "default, or for comparison: bsp, exhaustive")
      ->transform(CLI::CheckedTransformer(methods))
      ->type_name("M");
  AddTimeoutOption(*command, arguments->timeout_seconds);
  AddServerOption(*command, arguments->server);
  command->callback([command, arguments] { RunMask(*arguments, JsonRequested(*command)); });
}

}  // namespace shadowfit
