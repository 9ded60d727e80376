#include "client/scene_io/import_scene.h"

#include <assimp/postprocess.h>
#include <assimp/scene.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <array>
#include <assimp/Importer.hpp>
#include <cmath>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/str_format.h"
#include "client/scene_io/read_image.h"

namespace shadowfit {
namespace {

namespace fs = std::filesystem;

/// Pictures whose alpha channel cuts out foliage although their material says nothing of it.
constexpr std::array<std::string_view, 2> kFoliageCards = {"hawthorne.png", "abedul.png"};

/// Aerial photographs that are stretched over the ground; shadows are baked into them, so the ground is drawn
/// in one colour instead.
constexpr std::string_view kAerialPhoto = "google_earth_snapshot_1.jpg";
constexpr glm::vec3 kGroundReflectance{0.20f, 0.22f, 0.13f};

std::string LowerCaseFileName(const std::string& path) {
  return absl::AsciiStrToLower(path.substr(path.find_last_of("/\\") + 1));
}

/// Material files hold colours as they look on a screen; the renderer wants reflectance.
glm::vec3 LinearFromSrgb(const aiColor3D& c) {
  const auto linear = [](float s) {
    s = std::clamp(s, 0.0f, 1.0f);
    return s <= 0.04045f ? s / 12.92f : std::pow((s + 0.055f) / 1.055f, 2.4f);
  };
  return {linear(c.r), linear(c.g), linear(c.b)};
}

class SceneImport {
 public:
  SceneImport(const aiScene& source, fs::path folder) : source_(source), folder_(std::move(folder)) {}

  absl::StatusOr<Scene> Run() {
    for (unsigned i = 0; i < source_.mNumMaterials; ++i) {
      if (absl::Status status = AddMaterial(*source_.mMaterials[i]); !status.ok()) return status;
    }
    mesh_of_.assign(source_.mNumMeshes, -1);
    for (unsigned i = 0; i < source_.mNumMeshes; ++i) AddMesh(i);
    if (source_.mRootNode != nullptr) AddNode(*source_.mRootNode, aiMatrix4x4());
    if (scene_.instances.empty()) return absl::InvalidArgumentError("holds no triangle");
    return std::move(scene_);
  }

 private:
  absl::StatusOr<Image8> ReadTexture(const std::string& path) const {
    if (const aiTexture* embedded = source_.GetEmbeddedTexture(path.c_str()))
      return ReadEmbedded(*embedded, path);
    // Files written on Windows separate folders with backslashes.
    std::string portable = path;
    std::replace(portable.begin(), portable.end(), '\\', '/');
    return ReadImage8(folder_ / portable);
  }

  static absl::StatusOr<Image8> ReadEmbedded(const aiTexture& texture, const std::string& path) {
    if (texture.mHeight == 0) {
      const auto* bytes = reinterpret_cast<const std::byte*>(texture.pcData);
      return ReadImage8(std::span(bytes, texture.mWidth),
                        absl::StrFormat("%s.%s", path, texture.achFormatHint));
    }
    Image8 image{static_cast<int>(texture.mWidth), static_cast<int>(texture.mHeight), 4, {}};
    image.values.reserve(image.pixels() * 4);
    for (unsigned row = texture.mHeight; row-- > 0;) {
      for (unsigned x = 0; x < texture.mWidth; ++x) {
        const aiTexel& t = texture.pcData[row * texture.mWidth + x];
        image.values.insert(image.values.end(), {t.r, t.g, t.b, t.a});
      }
    }
    return image;
  }

  int AddColorTexture(const std::string& path) {
    const auto [known, is_new] = color_of_.try_emplace(path, -1);
    if (!is_new) return known->second;
    const absl::StatusOr<Image8> image = ReadTexture(path);
    if (!image.ok()) {
      spdlog::warn("{}; the material's flat colour is used", std::string(image.status().message()));
      return -1;
    }
    ColorTexture texture{image->width, image->height, {}};
    texture.rgb.reserve(image->pixels() * 3);
    const int green = image->channels >= 3 ? 1 : 0;
    for (size_t i = 0; i < image->pixels(); ++i) {
      const uint8_t* p = image->Pixel(i);
      texture.rgb.insert(texture.rgb.end(), {p[0], p[green], p[2 * green]});
    }
    scene_.color_textures.push_back(std::move(texture));
    return known->second = static_cast<int>(scene_.color_textures.size()) - 1;
  }

  /// Opacity is the alpha channel where the picture has one, and its grey value otherwise.
  absl::StatusOr<int> AddAlphaTexture(const std::string& path) {
    const auto [known, is_new] = alpha_of_.try_emplace(path, -1);
    if (!is_new) return known->second;
    const absl::StatusOr<Image8> image = ReadTexture(path);
    if (!image.ok()) return image.status();
    AlphaTexture texture{image->width, image->height, {}};
    texture.alpha.reserve(image->pixels());
    const int channel = image->has_alpha() ? image->channels - 1 : 0;
    for (size_t i = 0; i < image->pixels(); ++i) texture.alpha.push_back(image->Pixel(i)[channel]);
    scene_.alpha_textures.push_back(std::move(texture));
    return known->second = static_cast<int>(scene_.alpha_textures.size()) - 1;
  }

  absl::Status AddMaterial(const aiMaterial& source) {
    Material material;
    material.name = source.GetName().C_Str();
    aiColor3D diffuse(0.8f, 0.8f, 0.8f);
    source.Get(AI_MATKEY_COLOR_DIFFUSE, diffuse);
    material.diffuse = LinearFromSrgb(diffuse);

    std::string cutout;
    aiString path;
    if (source.GetTexture(aiTextureType_OPACITY, 0, &path) == aiReturn_SUCCESS) cutout = path.C_Str();
    if (source.GetTexture(aiTextureType_DIFFUSE, 0, &path) == aiReturn_SUCCESS) {
      const std::string picture = path.C_Str();
      const std::string file_name = LowerCaseFileName(picture);
      if (file_name == kAerialPhoto) {
        material.diffuse = kGroundReflectance;
      } else {
        material.color_texture = AddColorTexture(picture);
        const bool foliage =
            std::find(kFoliageCards.begin(), kFoliageCards.end(), file_name) != kFoliageCards.end();
        if (foliage && cutout.empty()) cutout = picture;
      }
    }
    if (!cutout.empty()) {
      const absl::StatusOr<int> texture = AddAlphaTexture(cutout);
      if (!texture.ok()) {
        return absl::InvalidArgumentError(
            absl::StrFormat("cutout of material \"%s\": %s", material.name, texture.status().message()));
      }
      material.alpha_texture = *texture;
    }
    scene_.materials.push_back(std::move(material));
    return absl::OkStatus();
  }

  void AddMesh(unsigned index) {
    const aiMesh& source = *source_.mMeshes[index];
    Mesh mesh;
    mesh.material = static_cast<int>(source.mMaterialIndex);
    for (unsigned i = 0; i < source.mNumFaces; ++i) {
      const aiFace& face = source.mFaces[i];
      if (face.mNumIndices == 3)
        mesh.triangles.emplace_back(face.mIndices[0], face.mIndices[1], face.mIndices[2]);
    }
    if (mesh.triangles.empty()) return;
    for (unsigned v = 0; v < source.mNumVertices; ++v) {
      const aiVector3D& p = source.mVertices[v];
      mesh.positions.emplace_back(p.x, p.y, p.z);
      if (source.HasNormals()) {
        const aiVector3D& n = source.mNormals[v];
        mesh.normals.emplace_back(n.x, n.y, n.z);
      }
      if (source.HasTextureCoords(0)) {
        const aiVector3D& uv = source.mTextureCoords[0][v];
        mesh.uvs.emplace_back(uv.x, uv.y);
      }
    }
    mesh_of_[index] = static_cast<int>(scene_.meshes.size());
    scene_.meshes.push_back(std::move(mesh));
  }

  void AddNode(const aiNode& node, const aiMatrix4x4& world_from_parent) {
    const aiMatrix4x4 m = world_from_parent * node.mTransformation;
    for (unsigned i = 0; i < node.mNumMeshes; ++i) {
      const int mesh = mesh_of_[node.mMeshes[i]];
      if (mesh < 0) continue;
      scene_.instances.push_back(
          {mesh, glm::mat4x3(m.a1, m.b1, m.c1, m.a2, m.b2, m.c2, m.a3, m.b3, m.c3, m.a4, m.b4, m.c4)});
    }
    for (unsigned i = 0; i < node.mNumChildren; ++i) AddNode(*node.mChildren[i], m);
  }

  const aiScene& source_;
  fs::path folder_;
  Scene scene_;
  std::vector<int>
      mesh_of_;  // Index of the Assimp mesh -> index into scene_.meshes, -1 where it has no triangle.
  std::map<std::string, int> color_of_;
  std::map<std::string, int> alpha_of_;
};

}  // namespace

absl::StatusOr<Scene> ImportScene(const fs::path& file) {
  std::error_code error;
  if (!fs::exists(file, error))
    return absl::NotFoundError(absl::StrFormat("%s: no such file", file.string()));
  if (!fs::is_regular_file(file, error)) {
    return absl::InvalidArgumentError(absl::StrFormat("%s: not a file", file.string()));
  }
  Assimp::Importer importer;
  const aiScene* source =
      importer.ReadFile(file.string(), aiProcess_Triangulate | aiProcess_SortByPType | aiProcess_GenNormals |
                                           aiProcess_JoinIdenticalVertices);
  if (source == nullptr) {
    return absl::InvalidArgumentError(absl::StrFormat("%s: %s", file.string(), importer.GetErrorString()));
  }
  absl::StatusOr<Scene> scene = SceneImport(*source, file.parent_path()).Run();
  absl::Status status = scene.status();
  if (scene.ok()) {
    scene->name = file.stem().string();
    status = Validate(*scene);
  }
  if (!status.ok())
    return absl::InvalidArgumentError(absl::StrFormat("%s: %s", file.string(), status.message()));
  return scene;
}

}  // namespace shadowfit
