#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/demo/walk.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

/// What PATH.json of `shadowfit render` says:
///
///     {
///       "width": 1024, "height": 768,                             optional; these are the defaults
///       "verticalFovDegrees": 60, "near": 0.2, "far": 300,        optional
///       "up": [0, 0, 1],                                          optional
///       "shadowMap": {"width": 512, "height": 512},               optional, for every light
///       "frames": [ {"eye": [x, y, z], "target": [x, y, z]}, ... ],
///       "lights": [ {"directional": {"direction": [x, y, z]}, "power": [r, g, b]},
///                   {"point": {"position": [x, y, z]}, "power": [r, g, b]},
///                   {"spot": {"position": [x, y, z], "direction": [x, y, z], "outerHalfAngleDegrees": 40},
///                    "power": [r, g, b]} ]                        optional: the scene's own lights of the
///                    demo
///     }
///
/// `power` is the irradiance of a directional light and the intensity of others; 1 where it is left out.
struct CameraPath {
  MapSize screen{1024, 768};
  MapSize map_size{512, 512};
  Walk walk;  ///< Without lights where the file names none.
};

/// InvalidArgument where the text is not such a document; the message names the member, as "frames[3].eye:
/// ...". Unknown members are errors.
absl::StatusOr<CameraPath> ParseCameraPath(const std::string& json);

}  // namespace shadowfit
