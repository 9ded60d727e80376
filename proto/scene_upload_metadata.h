#pragma once

namespace shadowfit {

/// Key of the initial metadata with which the service asks for an upload's bytes, see
/// SceneService.UploadScene.
inline constexpr char kSceneWantedKey[] = "shadowfit-scene-wanted";

}  // namespace shadowfit
