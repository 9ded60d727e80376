#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <optional>
#include <string_view>
#include <vector>

#include "core/frame/camera.h"
#include "core/math/light.h"
#include "core/reference/truth_scene.h"
#include "core/scene/bounds.h"
#include "core/scene/procedural.h"

namespace shadowfit {

/// Where the lights of a comparison stand. R is half the horizontal diagonal of the scene's bounds, and
/// hemispheres stand on the bounds' floor.
enum class LightPlacement {
  kNear,         ///< "near": point lights on a hemisphere of radius 1.2 R, just outside the scene.
  kDistant,      ///< "distant": point lights on a hemisphere of radius 5 R.
  kDirectional,  ///< "directional": shining from a hemisphere at infinity.
  kInside,       ///< "inside": point lights in the upper half of the bounds, for enclosed scenes.
};

std::string_view LightPlacementName(LightPlacement placement);
std::optional<LightPlacement> LightPlacementFromName(std::string_view name);

/// Uniformly distributed lights; light i depends on the seed and i alone. `ws_up` is the coordinate axis that
/// points up; lights on a hemisphere stand at least 1 degree above its rim.
std::vector<Light> PlaceLights(LightPlacement placement, int count, uint64_t seed, const Bounds& ws_bounds,
                               const glm::dvec3& ws_up = {0.0, 0.0, 1.0});

/// A walk-through's camera.
struct ViewOptions {
  double vertical_fov = 1.0471975511965976;  ///< Radians.
  double aspect = 1.0;                       ///< Width over height.
  double near = 0.2;                         ///< Metres. LiSPSM and Focused depend on it strongly.
  double far = 0.0;                          ///< 0: four times R, see LightPlacement.
  double eye_height = 1.7;                   ///< Of stand points that are searched for.
  glm::dvec3 ws_up{0.0, 0.0, 1.0};           ///< A coordinate axis.
};

/// `far` is resolved from the bounds. OpenGL's clip convention.
CameraMatrices CameraAt(const StandPoint& stand_point, const Bounds& ws_bounds, const ViewOptions& options);

/// Seeded places in the scene where a walker may stand and see something: on an upward face, clear of walls,
/// looking level in the direction that shows most at the most varied distances. At most `count`; fewer where
/// the scene has no floor.
std::vector<StandPoint> FindStandPoints(const TruthScene& scene, int count, uint64_t seed,
                                        const ViewOptions& options);

}  // namespace shadowfit
