#pragma once

#include <glm/glm.hpp>
#include <memory>
#include <random>
#include <vector>

#include "core/fit/light_problem.h"

namespace shadowfit::testing {

/// A flat receiver: the disc of a radius around a point.
struct Disc {
  glm::dvec3 ws_center{0.0};
  glm::dvec3 ws_normal{0.0, 0.0, 1.0};
  double radius = 1.0;
};

/// What a problem is made of: discs seen by a camera through a grid of pixels, without shadows cast, so that
/// every pixel facing the light is a hull sample and a boundary sample.
struct ProblemSetup {
  glm::dvec3 ws_eye{0.0, 0.0, 1.7};
  glm::dvec3 ws_target{10.0, 0.0, 1.0};
  double fov_y = 1.0;  ///< Radians.
  double aspect = 4.0 / 3.0;
  double near_plane = 0.1;
  bool orthographic = false;  ///< Height 10, from near_plane to 100.
  ClipDepth clip_depth = ClipDepth::kNegativeOneToOne;
  Light light = DirectionalLight{};
  MapSize map_size{512, 512};
  std::vector<Disc> discs = {{{0, 0, 0}, {0, 0, 1}, 40.0}};
  /// Bounds around all discs, 5 higher (casters); otherwise those of the visible part of the frustum.
  bool scene_bounds = true;
  int pixels_x = 24;
  int pixels_y = 18;
};

/// Owns all that a LightProblem borrows.
class OwnedProblem {
 public:
  explicit OwnedProblem(const ProblemSetup& setup);

  const LightProblem& problem() const { return problem_; }
  LightProblem& problem() { return problem_; }
  const RaySpace& ray_space() const { return ray_space_; }
  const Camera& camera() const { return camera_; }
  LightSamples& samples() { return samples_; }
  const ProblemSetup& setup() const { return setup_; }

  OwnedProblem(const OwnedProblem&) = delete;
  OwnedProblem& operator=(const OwnedProblem&) = delete;

 private:
  ProblemSetup setup_;
  Camera camera_;
  RaySpace ray_space_;
  LightSamples samples_;
  LightProblem problem_;
};

/// The 4x4 matrices of a setup's camera.
CameraMatrices MakeCamera(const ProblemSetup& setup);

/// Floor and a few tilted discs; any kind of light anywhere above, sometimes among the receivers, behind the
/// camera or below the floor; any clip convention, map size and camera.
ProblemSetup RandomSetup(std::mt19937_64& random);

}  // namespace shadowfit::testing
