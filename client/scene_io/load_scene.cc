#include "client/scene_io/load_scene.h"

#include <cstdlib>
#include <filesystem>
#include <string>

#include "absl/strings/str_format.h"
#include "client/scene_io/import_scene.h"
#include "core/scene/procedural.h"

namespace shadowfit {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kSterngartenFile = "Sterngarten_Wien_innerArea-optimized.obj";

fs::path SceneCacheFolder() {
  if (const char* cache = std::getenv("XDG_CACHE_HOME"); cache != nullptr && *cache != '\0') {
    return fs::path(cache) / "shadowfit" / "scenes";
  }
  const char* home = std::getenv("HOME");
  return fs::path(home != nullptr ? home : ".") / ".cache" / "shadowfit" / "scenes";
}

absl::StatusOr<Scene> LoadSterngarten() {
  const fs::path file = SceneCacheFolder() / "sterngarten" / kSterngartenFile;
  std::error_code error;
  if (!fs::exists(file, error)) {
    return absl::NotFoundError(absl::StrFormat(
        "scene \"sterngarten\": %s does not exist; run deploy/fetch-sterngarten.sh to download it, or "
        "use the scene \"plaza\"",
        file.string()));
  }
  absl::StatusOr<Scene> scene = ImportScene(file);
  if (scene.ok()) scene->name = "sterngarten";
  return scene;
}

}  // namespace

absl::StatusOr<Scene> LoadScene(std::string_view name_or_path) {
  if (name_or_path.empty()) {
    return absl::InvalidArgumentError("scene: empty; a scene's name or the path of a model file is accepted");
  }
  if (name_or_path == "sterngarten") return LoadSterngarten();
  absl::StatusOr<Scene> generated = MakeProceduralScene(name_or_path);
  if (!absl::IsNotFound(generated.status())) return generated;
  absl::StatusOr<Scene> imported = ImportScene(fs::path(name_or_path));
  if (absl::IsNotFound(imported.status())) {
    return absl::NotFoundError(absl::StrFormat(
        "scene \"%s\": no such file, and no scene has this name (known: sterngarten, plaza, hall, "
        "city, warehouse, random, terrain, hairball, dueling)",
        name_or_path));
  }
  return imported;
}

}  // namespace shadowfit
