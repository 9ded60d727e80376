#include <array>
#include <filesystem>
#include <fstream>
#include <memory>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "client/cli/commands.h"
#include "client/cli/progress_bar.h"
#include "client/compare/comparison.h"
#include "client/compare/comparison_report.h"
#include "client/scene_io/load_scene.h"
#include "core/fit/options.h"

namespace shadowfit {
namespace {

struct Arguments {
  std::string scene = "plaza";
  int lights = 500;
  uint64_t seed = 1;
  std::vector<std::string> kinds = {"near"};
  std::vector<std::string> methods;
  std::string screen = "750";
  std::string map = "400";
  std::string samples = "180";
  double fov_degrees = 60.0;
  double near = 0.2;
  double far = 0.0;
  double eye_height = 1.7;
  std::string up = "z";
  int views = 0;
  std::vector<double> eye;
  std::vector<double> target;
  bool times = false;
  int artefact_lights = 10;
  double certify = 0.0;
  double certify_time = 60.0;
  std::string out;
};

/// "400" or "640x360".
MapSize ParseSize(const std::string& option, const std::string& text) {
  const std::vector<std::string> parts = absl::StrSplit(text, 'x');
  MapSize size;
  const bool is_size = parts.size() <= 2 && absl::SimpleAtoi(parts.front(), &size.width) &&
                       absl::SimpleAtoi(parts.back(), &size.height);
  if (!is_size || size.width < 1 || size.height < 1) {
    throw CLI::ValidationError(option, absl::StrCat("\"", text, "\" is no size; 400 or 640x360 would be"));
  }
  return size;
}

/// "near" or "near:500".
LightSet ParseKind(const std::string& text, int lights) {
  const std::vector<std::string> parts = absl::StrSplit(text, ':');
  const auto placement = LightPlacementFromName(parts[0]);
  if (!placement) {
    throw CLI::ValidationError(
        "--kind", absl::StrCat("\"", parts[0], "\" is none of near, distant, directional, inside"));
  }
  LightSet set{*placement, lights};
  if (parts.size() > 2 || (parts.size() == 2 && !absl::SimpleAtoi(parts[1], &set.count))) {
    throw CLI::ValidationError("--kind", absl::StrCat("\"", text, "\" is not KIND or KIND:LIGHTS"));
  }
  return set;
}

/// A method's name; "default" may be followed by ":aspect", ":whole", ":1map" and ":2maps" to ":6maps".
MethodVariant ParseMethod(const std::string& text, MapSize map_size) {
  MethodVariant variant{text, {}, map_size};
  const std::vector<std::string> parts = absl::StrSplit(text, ':');
  const auto method = MethodFromName(parts[0]);
  bool known = method.has_value() && (parts.size() == 1 || *method == Method::kDefault);
  for (size_t i = 1; i < parts.size(); ++i) {
    int maps = 0;
    if (parts[i] == "aspect") {
      variant.options.standard.free_aspect = true;
    } else if (parts[i] == "whole") {
      variant.options.standard.hold_all_shadow = true;
    } else if (absl::SimpleAtoi(parts[i].substr(0, 1), &maps) && maps >= 1 && maps <= kMostMaps &&
               parts[i].substr(1) == (maps == 1 ? "map" : "maps")) {
      variant.options.standard.most_maps = maps;
      variant.options.standard.divide_where_needed = maps > 1;
    } else {
      known = false;
    }
  }
  if (!known) {
    std::vector<std::string> names;
    names.reserve(AllMethods().size());
    for (const Method method_name : AllMethods()) names.emplace_back(MethodName(method_name));
    throw CLI::ValidationError(
        "--methods", absl::StrCat("\"", text, "\" is none of ", absl::StrJoin(names, ", "),
                                  ", nor default followed by :aspect, :whole, :1map or :2maps to :6maps"));
  }
  variant.options.method = *method;
  return variant;
}

ComparisonOptions OptionsOf(const Arguments& arguments) {
  ComparisonOptions options;
  options.sets.clear();
  for (const std::string& kind : arguments.kinds) options.sets.push_back(ParseKind(kind, arguments.lights));
  options.seed = arguments.seed;
  const MapSize map_size = ParseSize("--map", arguments.map);
  for (const std::string& name : arguments.methods) options.methods.push_back(ParseMethod(name, map_size));
  options.screen = ParseSize("--screen", arguments.screen);
  options.samples = ParseSize("--samples", arguments.samples);
  options.view.vertical_fov = arguments.fov_degrees * std::numbers::pi / 180.0;
  options.view.near = arguments.near;
  options.view.far = arguments.far;
  options.view.eye_height = arguments.eye_height;
  if (arguments.up == "y") options.view.ws_up = {0.0, 1.0, 0.0};
  options.views = arguments.views;
  if (!arguments.eye.empty()) {
    options.stand_point = {{arguments.eye[0], arguments.eye[1], arguments.eye[2]},
                           {arguments.target[0], arguments.target[1], arguments.target[2]}};
  }
  options.frame_times = arguments.times;
  options.artefact_lights = arguments.artefact_lights;
  options.certify_tolerance = arguments.certify;
  options.certify_seconds = arguments.certify_time;
  options.folder = arguments.out;
  return options;
}

absl::Status WriteFile(const std::filesystem::path& path, const std::string& text) {
  std::ofstream file(path, std::ios::binary);
  file << text;
  file.close();
  if (!file) return absl::PermissionDeniedError(absl::StrCat(path.string(), ": cannot be written"));
  return absl::OkStatus();
}

void Run(const Arguments& arguments, bool json) {
  const ComparisonOptions options = OptionsOf(arguments);
  const Scene scene = ValueOrThrow(LoadScene(arguments.scene));
  Comparison comparison;
  {
    ProgressBar bar("compare");
    comparison =
        ValueOrThrow(RunComparison(scene, options, [&](int done, int total) { bar.Show(done, total); }));
  }
  if (!arguments.out.empty()) {
    const std::filesystem::path folder(arguments.out);
    ThrowIfError(WriteFile(folder / "report.md", ReportMarkdown(comparison)));
    ThrowIfError(WriteFile(folder / "report.json", ReportJson(comparison).dump(2) + "\n"));
    ThrowIfError(WriteFile(folder / "report.html", ReportHtml(comparison)));
  }
  if (json) {
    PrintJson(ReportJson(comparison));
  } else {
    const std::string table = ReportMarkdown(comparison);
    std::fwrite(table.data(), 1, table.size(), stdout);
  }
}

}  // namespace

void AddCompareCommand(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  for (const Method method : AllMethods()) arguments->methods.emplace_back(MethodName(method));
  CLI::App* command = app.add_subcommand(
      "compare", "Count wrong pixels of every method against ray-traced truth, light by light");
  command->add_option("--scene", arguments->scene, "plaza, sterngarten, another generated scene, or a file")
      ->type_name("NAME|FILE")
      ->capture_default_str();
  command->add_option("--lights", arguments->lights, "Lights of each kind")
      ->check(CLI::Range(1, 1000000))
      ->capture_default_str();
  command
      ->add_option("--kind", arguments->kinds,
                   "Sets of lights: near, distant (hemispheres of point lights), directional, inside; with "
                   "another number of lights as near:500")
      ->delimiter(',')
      ->capture_default_str();
  command->add_option("--seed", arguments->seed, "Of lights and views")->capture_default_str();
  command
      ->add_option(
          "--methods", arguments->methods,
          "Methods to compare; default:aspect lets the map's aspect ratio vary at the same number of texels, "
          "default:whole never lets go of shadow, default:2maps (to 6maps) shares them among several maps "
          "where that is better, default:1map never")
      ->delimiter(',')
      ->capture_default_str();
  command->add_option("--screen", arguments->screen, "Pixels that are judged")->capture_default_str();
  command->add_option("--map", arguments->map, "Texels of a shadow map")->capture_default_str();
  command->add_option("--samples", arguments->samples, "Pixels that the methods see")->capture_default_str();
  command->add_option("--fov", arguments->fov_degrees, "Vertical field of view, degrees")
      ->check(CLI::Range(1.0, 170.0))
      ->capture_default_str();
  command->add_option("--near", arguments->near, "The camera's near plane")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--far", arguments->far, "The camera's far plane; 0: from the scene's size")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  command->add_option("--eye-height", arguments->eye_height, "Of the walker above the floor")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--up", arguments->up, "The axis that points up")
      ->check(CLI::IsMember({"y", "z"}))
      ->capture_default_str();
  CLI::Option* views =
      command
          ->add_option("--views", arguments->views,
                       "So many seeded stand points that share the lights; 0: one fixed view")
          ->check(CLI::Range(0, 10000))
          ->capture_default_str();
  CLI::Option* eye = command->add_option("--eye", arguments->eye, "Where the viewer stands: X,Y,Z")
                         ->delimiter(',')
                         ->expected(3);
  CLI::Option* target = command->add_option("--target", arguments->target, "What the viewer looks at: X,Y,Z")
                            ->delimiter(',')
                            ->expected(3);
  eye->needs(target)->excludes(views);
  target->needs(eye);
  command
      ->add_option("--artefact-lights", arguments->artefact_lights,
                   "Count acne, detached shadows, jagged edges and flicker for so many lights of each kind; "
                   "0: for none")
      ->check(CLI::Range(0, 1000000))
      ->capture_default_str();
  CLI::Option* certify =
      command
          ->add_option(
              "--certify", arguments->certify,
              "Prove how far each single map of default is from the best there is, to a tolerance as 0.01")
          ->check(CLI::Range(1e-6, 0.999))
          ->type_name("TOLERANCE");
  command->add_option("--certify-time", arguments->certify_time, "Seconds after which a proof is given up")
      ->check(CLI::PositiveNumber)
      ->needs(certify)
      ->capture_default_str();
  command->add_flag("--times", arguments->times,
                    "Measure, too, what a frame of 1 to 32 lights costs each method");
  command
      ->add_option("--out", arguments->out,
                   "Folder for results and reports; a run that was interrupted goes on from there")
      ->type_name("DIR");
  command->callback([arguments, command] { Run(*arguments, JsonRequested(*command)); });
}

}  // namespace shadowfit
