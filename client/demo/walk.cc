#include "client/demo/walk.h"

#include <algorithm>
#include <cmath>
#include <glm/gtc/matrix_transform.hpp>
#include <numbers>

#include "absl/strings/str_format.h"
#include "core/scene/procedural.h"

namespace shadowfit {
namespace {

/// Where the walker stands and looks at one moment.
struct Pose {
  glm::dvec3 ws_eye;
  glm::dvec3 ws_target;
};

glm::dvec3 CatmullRom(const glm::dvec3& a, const glm::dvec3& b, const glm::dvec3& c, const glm::dvec3& d,
                      double t) {
  return 0.5 * (2.0 * b + (c - a) * t + (2.0 * a - 5.0 * b + 4.0 * c - d) * t * t +
                (3.0 * b - a - 3.0 * c + d) * t * t * t);
}

/// The pose at `t` in [0,1] on a smooth way through the given poses.
Pose At(const std::vector<Pose>& poses, double t) {
  const double position = t * static_cast<double>(poses.size() - 1);
  const int last = static_cast<int>(poses.size()) - 1;
  const int segment = std::clamp(static_cast<int>(position), 0, std::max(last - 1, 0));
  const auto pose = [&](int i) { return poses[static_cast<size_t>(std::clamp(i, 0, last))]; };
  const Pose a = pose(segment - 1);
  const Pose b = pose(segment);
  const Pose c = pose(segment + 1);
  const Pose d = pose(segment + 2);
  const double u = position - segment;
  return {CatmullRom(a.ws_eye, b.ws_eye, c.ws_eye, d.ws_eye, u),
          CatmullRom(a.ws_target, b.ws_target, c.ws_target, d.ws_target, u)};
}

/// Past the south western corner of the stepped pyramid with its mast, and on along its western side, into
/// the shadows that a low sun throws this way.
std::vector<Pose> SterngartenPoses() {
  return {{{-6.0, -13.5, 2.4}, {3.0, -1.0, 2.4}},
          {{-8.5, -9.5, 2.4}, {3.0, 1.5, 2.2}},
          {{-9.5, -4.5, 2.4}, {2.5, 4.0, 2.0}},
          {{-9.5, 0.5, 2.4}, {2.0, 7.5, 1.9}}};
}

/// A quarter of a turn around the target.
std::vector<Pose> PosesAround(const StandPoint& stand) {
  std::vector<Pose> poses;
  const glm::dvec3 out = stand.ws_eye - stand.ws_target;
  for (const double degrees : {-12.0, 0.0, 12.0, 24.0}) {
    const double a = degrees * std::numbers::pi / 180.0;
    const glm::dvec3 turned(out.x * std::cos(a) - out.y * std::sin(a),
                            out.x * std::sin(a) + out.y * std::cos(a), out.z);
    poses.push_back({stand.ws_target + turned, stand.ws_target});
  }
  return poses;
}

StandPoint StandPointOf(const Scene& scene, const Bounds& bounds) {
  if (const std::optional<StandPoint> known = ProceduralStandPoint(scene.name)) return *known;
  const glm::dvec3 size = bounds.max - bounds.min;
  StandPoint stand;
  stand.ws_target = bounds.Center();
  stand.ws_eye = stand.ws_target + glm::dvec3(0.35 * size.x, -0.55 * size.y, 0.35 * size.z + 0.1 * size.y);
  return stand;
}

constexpr glm::dvec3 kLampColors[] = {
    {1.0, 0.66, 0.38}, {0.75, 0.85, 1.0}, {1.0, 0.8, 0.55}, {0.8, 1.0, 0.8}};

SceneLight Lamp(int number, bool spot, const glm::dvec3& ws_position, const glm::dvec3& ws_target,
                double brightness) {
  SceneLight lamp;
  lamp.name = absl::StrFormat("lamp %d (%s)", number, spot ? "spot" : "point");
  const double distance = glm::distance(ws_position, ws_target);
  // Bright enough to give `brightness` where it is aimed.
  lamp.power = kLampColors[(number - 1) % 4] * (brightness * distance * distance);
  if (spot) {
    lamp.light = SpotLight{ws_position, ws_target - ws_position, 40.0 * std::numbers::pi / 180.0};
  } else {
    lamp.light = PointLight{ws_position};
  }
  return lamp;
}

/// Lamps on masts around `ws_center`, aimed at it; the golden angle keeps any number of them apart.
void AddLampsAround(const glm::dvec3& ws_center, double radius, double height, int count,
                    std::vector<SceneLight>* lights) {
  for (int i = 0; i < count; ++i) {
    const double angle = 3.9 + 2.399963 * i;
    const int number = static_cast<int>(lights->size());
    const glm::dvec3 ws_position = ws_center + glm::dvec3(radius * std::cos(angle), radius * std::sin(angle),
                                                          height * (1.0 + 0.13 * (i % 3)));
    lights->push_back(Lamp(number, i % 2 == 0, ws_position, ws_center, 0.4));
  }
}

}  // namespace

Walk PlanWalk(const Scene& scene, int frames, int lights, double aspect) {
  const Bounds bounds =
      scene.WsBounds().empty() ? Bounds{glm::dvec3(-1.0), glm::dvec3(1.0)} : scene.WsBounds();
  const double diagonal = glm::distance(bounds.min, bounds.max);
  Walk walk;
  std::vector<Pose> poses;
  std::vector<SceneLight> placed;
  if (scene.name == "sterngarten") {
    poses = SterngartenPoses();
    placed.push_back({"sun", DirectionalLight{{-0.74, -0.36, -0.46}}, {2.5, 1.95, 1.3}});
    // A floodlight in the south west, a lamp south east of the pyramid, and a floodlight over the ramp.
    placed.push_back(Lamp(1, true, {-15.0, -9.0, 7.5}, {2.0, -2.0, 1.5}, 0.55));
    placed.push_back(Lamp(2, false, {9.5, -19.0, 6.0}, {2.0, -6.0, 1.0}, 0.3));
    placed.push_back(Lamp(3, true, {-9.0, 15.0, 8.0}, {0.0, 3.0, 1.0}, 0.5));
    AddLampsAround({3.0, 1.0, 1.0}, 18.0, 7.0, std::max(0, lights - 4), &placed);
  } else {
    const StandPoint stand = StandPointOf(scene, bounds);
    poses = PosesAround(stand);
    walk.near = std::min(0.2, 0.002 * diagonal);
    walk.far = 3.0 * diagonal;
    placed.push_back({"sun", DirectionalLight{{-0.62, 0.55, -0.56}}, {2.5, 1.95, 1.3}});
    const double reach =
        0.8 * glm::distance(glm::dvec2(stand.ws_eye), glm::dvec2(stand.ws_target)) + 0.02 * diagonal;
    AddLampsAround(stand.ws_target, reach, 0.45 * reach, lights - 1, &placed);
  }
  placed.resize(std::min(placed.size(), static_cast<size_t>(lights)));
  walk.lights = std::move(placed);

  const glm::dmat4 clip_from_view = glm::perspective(walk.vertical_fov, aspect, walk.near, walk.far);
  for (int i = 0; i < frames; ++i) {
    const Pose pose = At(poses, frames > 1 ? static_cast<double>(i) / (frames - 1) : 0.5);
    walk.cameras.push_back({glm::lookAt(pose.ws_eye, pose.ws_target, glm::dvec3(0.0, 0.0, 1.0)),
                            clip_from_view, ClipDepth::kNegativeOneToOne});
  }
  return walk;
}

}  // namespace shadowfit
