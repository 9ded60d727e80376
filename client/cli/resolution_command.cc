#include <cstdio>
#include <map>
#include <memory>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/commands.h"
#include "client/cli/frame_files.h"
#include "client/embedded/service_connection.h"

namespace shadowfit {
namespace {

struct ResolutionArguments {
  std::string frame;
  std::string depth;
  uint32_t max_size = 4096;
  v1::SizeRounding rounding = v1::SIZE_ROUNDING_EXACT;
  double percentile = 100.0;
  bool histogram = false;
  std::string server;
  double timeout_seconds = 30.0;
};

std::string SizeText(const v1::Size& size) { return absl::StrCat(size.width(), "x", size.height()); }

/// How many pixels would go without a whole texel if the map had half the texels along each axis, and so on.
void PrintShares(const char* axis, const google::protobuf::RepeatedPtrField<v1::ResolutionBin>& bins,
                 double needed) {
  uint64_t total = 0;
  for (const v1::ResolutionBin& bin : bins) total += bin.pixels();
  if (total == 0) return;
  for (const double share : {1.0, 0.5, 0.25, 0.125, 0.0625}) {
    uint64_t unsatisfied = 0;
    for (const v1::ResolutionBin& bin : bins) {
      if (bin.texels() > needed * share * 1.04) unsatisfied += bin.pixels();  // A bin is 3.2 % wide.
    }
    absl::PrintF("%24s %s of %9.0f texels: %8.4f %% of the pixels need more\n", "", axis, needed * share,
                 100.0 * static_cast<double>(unsatisfied) / static_cast<double>(total));
  }
}

void PrintTable(const v1::ResolutionResult& result) {
  absl::PrintF("%10s %4s  %12s  %17s  %10s  %s\n", "light", "map", "recommended", "needed", "pixels", "crop");
  for (const v1::LightResolution& light : result.lights()) {
    for (int i = 0; i < light.maps_size(); ++i) {
      const v1::MapResolution& map = light.maps(i);
      absl::PrintF("%10d %4d  %12s  %17s  %10d  [%.4f, %.4f] x [%.4f, %.4f]%s\n", light.id(), i,
                   SizeText(map.recommended()),
                   absl::StrFormat("%.1f x %.1f", map.needed_width(), map.needed_height()),
                   map.visible_pixels(), map.crop_min_x(), map.crop_max_x(), map.crop_min_y(),
                   map.crop_max_y(), map.limited() ? "  limited" : "");
      PrintShares("width", map.histogram_x(), map.needed_width());
      PrintShares("height", map.histogram_y(), map.needed_height());
    }
    if (light.maps_size() > 1) absl::PrintF("%10d  all  %12s\n", light.id(), SizeText(light.recommended()));
  }
  absl::PrintF("\n%d light%s in %.3f ms; %.3f ms in the queue\n", result.lights_size(),
               result.lights_size() == 1 ? "" : "s", result.total_seconds() * 1e3,
               result.queue_seconds() * 1e3);
}

void RunResolution(const ResolutionArguments& arguments, bool json) {
  const v1::Frame frame = ValueOrThrow(ReadFrameFiles(arguments.frame, arguments.depth, ""));
  v1::ResolutionOptions options;
  options.set_max_size(arguments.max_size);
  options.set_rounding(arguments.rounding);
  options.set_percentile(arguments.percentile);
  options.set_histogram(arguments.histogram);
  const auto service = ValueOrThrow(ServiceConnection::Open(arguments.server));
  const v1::ResolutionResult result = ValueOrThrow(
      service->client().EstimateResolution(frame, options, CallWithin(arguments.timeout_seconds)));
  if (json) {
    std::fputs(JsonFromMessage(result).c_str(), stdout);
  } else {
    PrintTable(result);
  }
}

}  // namespace

void AddResolutionCommand(CLI::App& app) {
  auto arguments = std::make_shared<ResolutionArguments>();
  CLI::App* command =
      app.add_subcommand("resolution", "Estimate how large the shadow maps of one frame must be");
  command->add_option("--frame", arguments->frame, "shadowfit.v1.Frame as Protobuf JSON, without its buffers")
      ->required()
      ->type_name("FRAME.json");
  command->add_option("--depth", arguments->depth, "Window depth, one float channel, at full resolution")
      ->required()
      ->type_name("DEPTH.exr");
  command->add_option("--max-size", arguments->max_size, "Recommend no side larger than N texels")
      ->check(CLI::Range(1U, 65536U))
      ->type_name("N")
      ->capture_default_str();
  const std::map<std::string, v1::SizeRounding> roundings = {
      {"exact", v1::SIZE_ROUNDING_EXACT},
      {"8", v1::SIZE_ROUNDING_MULTIPLE_OF_8},
      {"power_of_two", v1::SIZE_ROUNDING_POWER_OF_TWO}};
  command
      ->add_option("--rounding", arguments->rounding, "Round sizes up: exact, 8 (a multiple), power_of_two")
      ->transform(CLI::CheckedTransformer(roundings))
      ->type_name("HOW");
  command
      ->add_option("--percentile", arguments->percentile,
                   "Per cent of the visible pixels whose patch gets a whole texel along each axis")
      ->check(CLI::Range(1e-6, 100.0))
      ->capture_default_str();
  command->add_flag("--histogram", arguments->histogram, "Show how many pixels need how many texels");
  AddTimeoutOption(*command, arguments->timeout_seconds);
  AddServerOption(*command, arguments->server);
  command->callback([command, arguments] { RunResolution(*arguments, JsonRequested(*command)); });
}

}  // namespace shadowfit
