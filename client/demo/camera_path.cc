#include "client/demo/camera_path.h"

#include <algorithm>
#include <cmath>
#include <glm/gtc/matrix_transform.hpp>
#include <initializer_list>
#include <nlohmann/json.hpp>
#include <numbers>
#include <string_view>

#include "absl/strings/str_format.h"
#include "core/fit/frame_optimizer.h"
#include "core/math/ray_space.h"

namespace shadowfit {
namespace {

using nlohmann::json;

constexpr double kRadians = std::numbers::pi / 180.0;
constexpr int kMaxScreen = 16384;

/// Reads members of a document and keeps the first error, so that the parser below reads as the document
/// does.
class Reader {
 public:
  const absl::Status& status() const { return status_; }

  void Fail(const std::string& where, const std::string& what) {
    if (status_.ok()) status_ = absl::InvalidArgumentError(absl::StrFormat("%s: %s", where, what));
  }

  /// Refuses members that mean nothing, which are mostly misspelt ones.
  void AllowOnly(const json& object, const std::string& where,
                 std::initializer_list<std::string_view> members) {
    if (!object.is_object()) {
      Fail(where, "must be an object");
      return;
    }
    for (const auto& [name, value] : object.items()) {
      if (std::find(members.begin(), members.end(), name) == members.end())
        Fail(Join(where, name), "unknown member");
    }
  }

  /// Leaves `value` alone where the member is missing.
  void Number(const json& object, const std::string& where, const char* name, double low, double high,
              double* value) {
    if (!object.is_object() || !object.contains(name)) return;
    const json& member = object[name];
    const double number = member.is_number() ? member.get<double>() : std::nan("");
    if (!(number >= low && number <= high)) {
      Fail(Join(where, name),
           absl::StrFormat("%s, a number from %g to %g is accepted", member.dump(), low, high));
      return;
    }
    *value = number;
  }

  void Integer(const json& object, const std::string& where, const char* name, int low, int high,
               int* value) {
    double number = *value;
    Number(object, where, name, low, high, &number);
    if (number != std::floor(number)) Fail(Join(where, name), absl::StrFormat("%g is not whole", number));
    *value = static_cast<int>(number);
  }

  void Vector(const json& object, const std::string& where, const char* name, bool required,
              glm::dvec3* value) {
    if (!object.is_object() || !object.contains(name)) {
      if (required) Fail(Join(where, name), "missing");
      return;
    }
    const json& member = object[name];
    const auto is_finite_number = [](const json& n) {
      return n.is_number() && std::isfinite(n.get<double>());
    };
    if (!member.is_array() || member.size() != 3 ||
        !std::all_of(member.begin(), member.end(), is_finite_number)) {
      Fail(Join(where, name), absl::StrFormat("%s, three numbers are accepted", member.dump()));
      return;
    }
    for (int i = 0; i < 3; ++i) (*value)[i] = member[static_cast<size_t>(i)].get<double>();
  }

  static std::string Join(const std::string& where, const std::string& name) {
    return where.empty() ? name : where + "." + name;
  }

 private:
  absl::Status status_;
};

SceneLight ReadLight(const json& source, const std::string& where, Reader* reader) {
  SceneLight light;
  reader->AllowOnly(source, where, {"directional", "point", "spot", "power"});
  reader->Vector(source, where, "power", false, &light.power);
  const int kinds =
      source.is_object()
          ? static_cast<int>(source.count("directional") + source.count("point") + source.count("spot"))
          : 0;
  if (kinds != 1) {
    reader->Fail(where, "exactly one of directional, point and spot is needed");
    return light;
  }
  std::string kind;
  if (source.contains("directional")) {
    kind = where + ".directional";
    DirectionalLight directional;
    reader->AllowOnly(source["directional"], kind, {"direction"});
    reader->Vector(source["directional"], kind, "direction", true, &directional.ws_direction);
    light.light = directional;
  } else if (source.contains("point")) {
    kind = where + ".point";
    PointLight point;
    reader->AllowOnly(source["point"], kind, {"position"});
    reader->Vector(source["point"], kind, "position", true, &point.ws_position);
    light.light = point;
  } else {
    kind = where + ".spot";
    SpotLight spot;
    double degrees = spot.outer_half_angle / kRadians;
    reader->AllowOnly(source["spot"], kind, {"position", "direction", "outerHalfAngleDegrees"});
    reader->Vector(source["spot"], kind, "position", true, &spot.ws_position);
    reader->Vector(source["spot"], kind, "direction", true, &spot.ws_direction);
    reader->Number(source["spot"], kind, "outerHalfAngleDegrees", 0.1, 89.0, &degrees);
    spot.outer_half_angle = degrees * kRadians;
    light.light = spot;
  }
  if (const absl::StatusOr<RaySpace> space = RaySpace::Create(light.light); !space.ok()) {
    reader->Fail(kind, std::string(space.status().message()));
  }
  return light;
}

}  // namespace

absl::StatusOr<CameraPath> ParseCameraPath(const std::string& text) {
  const json document = json::parse(text, nullptr, /*allow_exceptions=*/false);
  if (document.is_discarded()) return absl::InvalidArgumentError("not a JSON document");

  CameraPath path;
  Reader reader;
  reader.AllowOnly(
      document, "path",
      {"width", "height", "verticalFovDegrees", "near", "far", "up", "shadowMap", "frames", "lights"});
  if (!reader.status().ok()) return reader.status();
  reader.Integer(document, "", "width", 1, kMaxScreen, &path.screen.width);
  reader.Integer(document, "", "height", 1, kMaxScreen, &path.screen.height);
  double fov_degrees = path.walk.vertical_fov / kRadians;
  reader.Number(document, "", "verticalFovDegrees", 1.0, 170.0, &fov_degrees);
  path.walk.vertical_fov = fov_degrees * kRadians;
  reader.Number(document, "", "near", 1e-6, 1e9, &path.walk.near);
  reader.Number(document, "", "far", 1e-6, 1e12, &path.walk.far);
  if (!(path.walk.near < path.walk.far)) {
    reader.Fail("far",
                absl::StrFormat("%g, must be beyond near, which is %g", path.walk.far, path.walk.near));
  }
  glm::dvec3 ws_up(0.0, 0.0, 1.0);
  reader.Vector(document, "", "up", false, &ws_up);
  if (document.contains("shadowMap")) {
    reader.AllowOnly(document["shadowMap"], "shadowMap", {"width", "height"});
    reader.Integer(document["shadowMap"], "shadowMap", "width", 1, kMaxScreen, &path.map_size.width);
    reader.Integer(document["shadowMap"], "shadowMap", "height", 1, kMaxScreen, &path.map_size.height);
  }

  const json frames = document.value("frames", json());
  if (!frames.is_array() || frames.empty())
    reader.Fail("frames", "an array with at least one frame is needed");
  const glm::dmat4 clip_from_view =
      glm::perspective(path.walk.vertical_fov, static_cast<double>(path.screen.width) / path.screen.height,
                       path.walk.near, path.walk.far);
  for (size_t i = 0; frames.is_array() && i < frames.size(); ++i) {
    const std::string where = absl::StrFormat("frames[%d]", i);
    glm::dvec3 ws_eye(0.0);
    glm::dvec3 ws_target(0.0);
    reader.AllowOnly(frames[i], where, {"eye", "target"});
    reader.Vector(frames[i], where, "eye", true, &ws_eye);
    reader.Vector(frames[i], where, "target", true, &ws_target);
    const glm::dvec3 forward = ws_target - ws_eye;
    if (!(glm::length(glm::cross(forward, ws_up)) > 1e-9 * glm::length(forward) * glm::length(ws_up))) {
      reader.Fail(where, "the camera looks along `up`, or nowhere");
    }
    path.walk.cameras.push_back(
        {glm::lookAt(ws_eye, ws_target, ws_up), clip_from_view, ClipDepth::kNegativeOneToOne});
  }

  const json lights = document.value("lights", json::array());
  if (!lights.is_array() || lights.size() > static_cast<size_t>(kMaxLights)) {
    reader.Fail("lights", absl::StrFormat("an array of at most %d lights is accepted", kMaxLights));
  }
  for (size_t i = 0; lights.is_array() && i < lights.size(); ++i) {
    const std::string where = absl::StrFormat("lights[%d]", i);
    path.walk.lights.push_back(ReadLight(lights[i], where, &reader));
    path.walk.lights.back().name = where;
  }
  if (!reader.status().ok()) return reader.status();
  return path;
}

}  // namespace shadowfit
