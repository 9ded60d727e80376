#include <chrono>
#include <cstdio>
#include <map>
#include <memory>
#include <string>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/commands.h"
#include "client/cli/frame_files.h"
#include "client/embedded/service_connection.h"

namespace shadowfit {
namespace {

struct OptimizeArguments {
  std::string frame;
  std::string depth;
  std::string bits;
  std::string method;
  std::string out;
  v1::ShadowMapFormat bias_format = v1::SHADOW_MAP_FORMAT_UNSPECIFIED;
  uint32_t pcf_radius = 0;
  std::string server;
  double timeout_seconds = 30.0;
};

/// "kept previous" of FIT_OUTCOME_KEPT_PREVIOUS.
std::string Words(std::string enum_name, const std::string& prefix) {
  enum_name = absl::AsciiStrToLower(enum_name.substr(prefix.size()));
  for (char& c : enum_name) {
    if (c == '_') c = ' ';
  }
  return enum_name;
}

/// "512x512", or "300x300 +2" of a light with two further maps.
std::string MapColumn(const v1::LightResult& light) {
  std::string column = absl::StrCat(light.shadow_map().width(), "x", light.shadow_map().height());
  if (light.further_maps_size() > 0) absl::StrAppend(&column, " +", light.further_maps_size());
  return column;
}

void PrintTable(const v1::FrameResult& result) {
  absl::PrintF("%10s  %-13s  %11s  %-15s  %9s  %6s  %12s  %8s  %s\n", "light", "outcome", "map", "samples",
               "boundary", "hull", "wrong pixels", "ms", "note");
  for (const v1::LightResult& light : result.lights()) {
    absl::PrintF("%10d  %-13s  %11s  %-15s  %9d  %6d  %12.1f  %8.3f  %s\n", light.id(),
                 Words(v1::FitOutcome_Name(light.outcome()), "FIT_OUTCOME_"), MapColumn(light),
                 Words(v1::SampleSource_Name(light.sample_source()), "SAMPLE_SOURCE_"),
                 light.boundary_samples(), light.hull_samples(), light.predicted_misclassified_pixels(),
                 light.optimize_seconds() * 1e3, light.note());
  }
  absl::PrintF("\nSafe bias, in window depth; detachment in world units and pixels\n");
  absl::PrintF("%10s  %12s  %9s  %14s  %14s  %10s  %10s  %11s\n", "light", "constant", "slope",
               "clamp", "receiver plane", "mean", "worst", "mean pixels");
  for (const v1::LightResult& light : result.lights()) {
    if (!light.has_safe_bias()) continue;
    const v1::SafeBias& bias = light.safe_bias();
    absl::PrintF("%10d  %12.4e  %9.5f  %14.4e  %14.4e  %10.4g  %10.4g  %11.3f\n", light.id(), bias.constant(),
                 bias.slope(), bias.clamp(), bias.receiver_plane_constant(), bias.mean_detachment(),
                 bias.worst_detachment(), bias.mean_detachment_pixels());
  }
  const v1::FrameTimings& timings = result.timings();
  absl::PrintF(
      "\n%d light%s in %.3f ms, of which %.3f ms for sampling and %.3f ms for biases; %.3f ms in the queue\n",
      result.lights_size(), result.lights_size() == 1 ? "" : "s", timings.total_seconds() * 1e3,
      timings.sampling_seconds() * 1e3, timings.bias_seconds() * 1e3, timings.queue_seconds() * 1e3);
}

void RunOptimize(const OptimizeArguments& arguments, bool json) {
  v1::Frame frame = ValueOrThrow(ReadFrameFiles(arguments.frame, arguments.depth, arguments.bits));
  if (!arguments.method.empty()) {
    frame.mutable_options()->set_method(ValueOrThrow(WireMethodFromName(arguments.method)));
  }
  v1::SafeBiasOptions& bias = *frame.mutable_options()->mutable_safe_bias();
  if (arguments.bias_format != v1::SHADOW_MAP_FORMAT_UNSPECIFIED) bias.set_format(arguments.bias_format);
  if (arguments.pcf_radius != 0) bias.set_pcf_radius(arguments.pcf_radius);
  const auto service = ValueOrThrow(ServiceConnection::Open(arguments.server));
  CallOptions call;
  call.timeout = std::chrono::milliseconds(static_cast<int64_t>(arguments.timeout_seconds * 1e3));
  const v1::FrameResult result = ValueOrThrow(service->client().Optimize(frame, call));
  if (!arguments.out.empty()) ThrowIfError(WriteTextFile(arguments.out, JsonFromMessage(result)));
  if (json) {
    std::fputs(JsonFromMessage(result).c_str(), stdout);
  } else {
    PrintTable(result);
  }
}

}  // namespace

void AddOptimizeCommand(CLI::App& app) {
  auto arguments = std::make_shared<OptimizeArguments>();
  CLI::App* command =
      app.add_subcommand("optimize", "Fit the shadow maps of one frame that is given by files");
  command->add_option("--frame", arguments->frame, "shadowfit.v1.Frame as Protobuf JSON, without its buffers")
      ->required()
      ->type_name("FRAME.json");
  command->add_option("--depth", arguments->depth, "Window depth, one float channel")
      ->required()
      ->type_name("DEPTH.exr");
  command->add_option("--bits", arguments->bits, "Shadow bits, one uint32 channel; bit i belongs to light i")
      ->type_name("BITS.exr");
  command
      ->add_option("--method", arguments->method, "How to make the matrices; overrides the frame's options")
      ->check(CLI::IsMember(MethodNames()))
      ->type_name("M");
  const std::map<std::string, v1::ShadowMapFormat> formats = {{"unorm16", v1::SHADOW_MAP_FORMAT_UNORM16},
                                                              {"unorm24", v1::SHADOW_MAP_FORMAT_UNORM24},
                                                              {"float32", v1::SHADOW_MAP_FORMAT_FLOAT32}};
  command
      ->add_option("--depth-format", arguments->bias_format,
                   "Of the shadow maps, for the safe bias: unorm16, unorm24 (default), float32")
      ->transform(CLI::CheckedTransformer(formats))
      ->type_name("FORMAT");
  command
      ->add_option("--pcf-radius", arguments->pcf_radius,
                   "Filter radius in texels, for the safe bias: (2 r + 1)^2 texels are read")
      ->check(CLI::Range(0U, 16U))
      ->type_name("R");
  command->add_option("--out", arguments->out, "Write shadowfit.v1.FrameResult as Protobuf JSON")
      ->type_name("RESULT.json");
  command->add_option("--timeout", arguments->timeout_seconds, "Give up after so many seconds")
      ->check(CLI::Range(0.001, 86400.0))
      ->capture_default_str();
  AddServerOption(*command, arguments->server);
  command->callback([command, arguments] { RunOptimize(*arguments, JsonRequested(*command)); });
}

}  // namespace shadowfit
