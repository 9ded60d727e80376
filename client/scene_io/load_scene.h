#pragma once

#include <string_view>

#include "absl/status/statusor.h"
#include "core/scene/scene.h"

namespace shadowfit {

/// A scene by name, or from a file.
///
///   sterngarten        the Sterngarten in Vienna (model by Georg Zotti, CC BY-SA 4.0), from the cache folder
///   that
///                      deploy/fetch-sterngarten.sh fills
///   plaza, hall, ...   generated scenes, see core/scene/procedural.h; `plaza:20000` asks for a number of
///   triangles anything else      the path of a file that Assimp imports (OBJ, glTF, FBX, PLY, ...); see
///   import_scene.h
///
/// NotFound where there is no such scene or file; InvalidArgument where it cannot be used, with the reason.
/// The returned scene passes Validate().
absl::StatusOr<Scene> LoadScene(std::string_view name_or_path);

}  // namespace shadowfit
