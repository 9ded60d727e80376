#include <cstdio>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
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
  uint64_t budget = 0;
  std::string atlas;
  double tolerance = 0.0;
  v1::SizeRounding rounding = v1::SIZE_ROUNDING_UNSPECIFIED;
  uint32_t min_side = 0;
  uint32_t max_side = 0;
  std::optional<double> keep_within;
  bool hold_all_shadow = false;
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

/// Why each map is as bad as it is, and where it lies.
void PrintQuality(const v1::FrameResult& result) {
  bool atlas = false;
  for (const v1::LightResult& light : result.lights()) atlas = atlas || light.has_atlas_position();
  absl::PrintF("\nWrong pixels are those of a map with one texel a pixel, times five factors\n");
  absl::PrintF("%10s  %12s  %8s  %8s  %11s  %10s  %10s  %-11s%s\n", "light", "one a pixel", "budget", "fit",
               "perspective", "projection", "saturation", "worst", atlas ? "  in the atlas at" : "");
  for (const v1::LightResult& light : result.lights()) {
    if (!light.has_quality()) continue;
    const v1::MapQuality& quality = light.quality();
    const std::string position =
        light.has_atlas_position()
            ? absl::StrFormat("  %d,%d", light.atlas_position().x(), light.atlas_position().y())
            : "";
    absl::PrintF("%10d  %12.1f  %8.3f  %8.3f  %11.3f  %10.3f  %10.3f  %-11s%s\n", light.id(),
                 quality.unit_pixels(), quality.budget(), quality.fit(), quality.perspective(),
                 quality.projection(), quality.saturation(),
                 Words(v1::MapFlaw_Name(quality.worst()), "MAP_FLAW_"), position);
  }
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
  absl::PrintF("%10s  %12s  %9s  %14s  %14s  %10s  %10s  %11s\n", "light", "constant", "slope", "clamp",
               "receiver plane", "mean", "worst", "mean pixels");
  for (const v1::LightResult& light : result.lights()) {
    if (!light.has_safe_bias()) continue;
    const v1::SafeBias& bias = light.safe_bias();
    absl::PrintF("%10d  %12.4e  %9.5f  %14.4e  %14.4e  %10.4g  %10.4g  %11.3f\n", light.id(), bias.constant(),
                 bias.slope(), bias.clamp(), bias.receiver_plane_constant(), bias.mean_detachment(),
                 bias.worst_detachment(), bias.mean_detachment_pixels());
  }
  PrintQuality(result);
  const v1::FrameTimings& timings = result.timings();
  absl::PrintF(
      "\n%d light%s in %.3f ms, of which %.3f ms for sampling and %.3f ms for biases; %.3f ms in the queue\n",
      result.lights_size(), result.lights_size() == 1 ? "" : "s", timings.total_seconds() * 1e3,
      timings.sampling_seconds() * 1e3, timings.bias_seconds() * 1e3, timings.queue_seconds() * 1e3);
}

/// Where the arguments size the maps they replace what the frame says of that.
void SetSizing(const OptimizeArguments& arguments, v1::OptimizeOptions* options) {
  if (arguments.tolerance > 0.0) {
    options->mutable_tolerance()->set_max_misclassified_pixels(arguments.tolerance);
  }
  if (arguments.budget > 0) options->mutable_texel_budget()->set_total_texels(arguments.budget);
  if (!arguments.atlas.empty()) {
    const std::vector<std::string> parts = absl::StrSplit(arguments.atlas, 'x');
    uint32_t width = 0;
    uint32_t height = 0;
    if (parts.size() != 2 || !absl::SimpleAtoi(parts[0], &width) || !absl::SimpleAtoi(parts[1], &height)) {
      ThrowIfError(absl::InvalidArgumentError(
          absl::StrCat("--atlas: \"", arguments.atlas, "\" is no size, as 4096x2048 is")));
    }
    options->mutable_texel_budget()->mutable_atlas()->set_width(width);
    options->mutable_texel_budget()->mutable_atlas()->set_height(height);
  }
  v1::SideLimits* sides = options->has_tolerance()      ? options->mutable_tolerance()->mutable_sides()
                          : options->has_texel_budget() ? options->mutable_texel_budget()->mutable_sides()
                                                        : nullptr;
  if (sides == nullptr) return;
  if (arguments.min_side != 0) sides->set_min_side(arguments.min_side);
  if (arguments.max_side != 0) sides->set_max_side(arguments.max_side);
  if (arguments.rounding != v1::SIZE_ROUNDING_UNSPECIFIED) sides->set_rounding(arguments.rounding);
}

void RunOptimize(const OptimizeArguments& arguments, bool json) {
  v1::Frame frame = ValueOrThrow(ReadFrameFiles(arguments.frame, arguments.depth, arguments.bits));
  if (!arguments.method.empty()) {
    frame.mutable_options()->set_method(ValueOrThrow(WireMethodFromName(arguments.method)));
  }
  v1::SafeBiasOptions& bias = *frame.mutable_options()->mutable_safe_bias();
  if (arguments.bias_format != v1::SHADOW_MAP_FORMAT_UNSPECIFIED) bias.set_format(arguments.bias_format);
  if (arguments.pcf_radius != 0) bias.set_pcf_radius(arguments.pcf_radius);
  frame.mutable_options()->set_assess_quality(true);
  if (arguments.hold_all_shadow) frame.mutable_options()->set_hold_all_shadow(true);
  if (arguments.keep_within) frame.mutable_options()->set_keep_within(*arguments.keep_within);
  SetSizing(arguments, frame.mutable_options());
  const auto service = ValueOrThrow(ServiceConnection::Open(arguments.server));
  const v1::FrameResult result =
      ValueOrThrow(service->client().Optimize(frame, CallWithin(arguments.timeout_seconds)));
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
  CLI::Option* budget =
      command
          ->add_option(
              "--budget", arguments->budget,
              "Share so many texels among the lights by what they gain (weights: the frame's lights)")
          ->check(CLI::Range(uint64_t{1}, uint64_t{1} << 40))
          ->type_name("TEXELS");
  CLI::Option* atlas =
      command
          ->add_option("--atlas", arguments->atlas,
                       "Lay the maps out in one texture, which --budget may leave half empty")
          ->type_name("WxH");
  command
      ->add_option("--tolerance", arguments->tolerance,
                   "The smallest maps that are expected to get at most so many pixels wrong, each")
      ->check(CLI::PositiveNumber)
      ->excludes(budget)
      ->excludes(atlas)
      ->type_name("PIXELS");
  command->add_option("--min-side", arguments->min_side, "Of maps that are sized; default 16")
      ->check(CLI::Range(1U, 65536U));
  command->add_option("--max-side", arguments->max_side, "Of maps that are sized; default 8192")
      ->check(CLI::Range(1U, 65536U));
  const std::map<std::string, v1::SizeRounding> roundings = {
      {"exact", v1::SIZE_ROUNDING_EXACT},
      {"8", v1::SIZE_ROUNDING_MULTIPLE_OF_8},
      {"power_of_two", v1::SIZE_ROUNDING_POWER_OF_TWO}};
  command
      ->add_option("--rounding", arguments->rounding,
                   "Sides of maps that are sized: exact, 8 (a multiple), power_of_two")
      ->transform(CLI::CheckedTransformer(roundings))
      ->type_name("ROUNDING");
  command
      ->add_option(
          "--keep-within", arguments->keep_within,
          "The frame's previous matrices stay while they get at most so many times the pixels of new "
          "ones wrong (default 1.1, at least 1); 0: never")
      ->type_name("K");
  command->add_flag("--hold-all-shadow", arguments->hold_all_shadow,
                    "Never let go of far shadow for the sake of the rest");
  command->add_option("--out", arguments->out, "Write shadowfit.v1.FrameResult as Protobuf JSON")
      ->type_name("RESULT.json");
  AddTimeoutOption(*command, arguments->timeout_seconds);
  AddServerOption(*command, arguments->server);
  command->callback([command, arguments] { RunOptimize(*arguments, JsonRequested(*command)); });
}

}  // namespace shadowfit
