#pragma once

#include <filesystem>

#include "absl/status/statusor.h"
#include "core/scene/scene.h"

namespace shadowfit {

/// Reads a model file with Assimp, and its pictures with OpenImageIO. Coordinates stay as they are in the
/// file (no axis is swapped). Polygons are cut into triangles, points and lines are dropped, missing normals
/// are computed.
///
/// Cutouts are materials with an opacity map (`map_d`), and materials whose colour picture is one of the
/// foliage cards that the Sterngarten uses without saying so. A cutout's picture must be readable; a missing
/// colour picture is logged and the material's flat colour used, because colour changes no shadow.
///
/// NotFound where the file does not exist, InvalidArgument where it holds no triangle or cannot be read.
absl::StatusOr<Scene> ImportScene(const std::filesystem::path& file);

}  // namespace shadowfit
