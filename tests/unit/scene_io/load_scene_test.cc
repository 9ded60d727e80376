#include "client/scene_io/load_scene.h"

#include <OpenImageIO/imageio.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

namespace shadowfit {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;

class LoadSceneTest : public ::testing::Test {
 protected:
  LoadSceneTest() {
    std::string name = (fs::temp_directory_path() / "load_scene_test.XXXXXX").string();
    folder_ = mkdtemp(name.data());
  }
  ~LoadSceneTest() override { fs::remove_all(folder_); }

  std::string Write(const std::string& name, const std::string& text) const {
    std::ofstream(folder_ / name, std::ios::binary) << text;
    return (folder_ / name).string();
  }

  /// values: top row first, as pictures are stored in files.
  void WritePicture(const std::string& name, int width, int height, int channels,
                    const std::vector<uint8_t>& values) const {
    const std::string path = (folder_ / name).string();
    const auto output = OIIO::ImageOutput::create(path);
    ASSERT_TRUE(output);
    OIIO::ImageSpec spec(width, height, channels, OIIO::TypeDesc::UINT8);
    spec.attribute("oiio:UnassociatedAlpha", 1);
    ASSERT_TRUE(output->open(path, spec));
    ASSERT_TRUE(output->write_image(OIIO::TypeDesc::UINT8, values.data()));
    ASSERT_TRUE(output->close());
  }

  fs::path folder_;
};

// A square of Z-up ground (a quad, to be cut in two), one foliage card without map_d, one card with it.
constexpr char kGarden[] = R"(mtllib garden.mtl
v 0 0 0
v 4 0 0
v 4 4 0
v 0 4 0
v 0 0 3
v 4 0 3
vt 0 0
vt 1 0
vt 1 1
vt 0 1
vn 0 0 1
usemtl ground
f 1/1/1 2/2/1 3/3/1 4/4/1
usemtl leaves
f 1/1 2/2 6/3
usemtl mesh
f 1/1 6/3 5/4
)";
constexpr char kGardenMaterials[] = R"(newmtl ground
Kd 0.5 0.5 0.5
map_Kd pictures\Google_Earth_Snapshot_1.jpg
newmtl leaves
Kd 1 1 1
map_Kd hawthorne.png
newmtl mesh
Kd 1 0 0
map_d wire.png
)";

TEST_F(LoadSceneTest, ImportsTrianglesMaterialsAndCutouts) {
  Write("garden.mtl", kGardenMaterials);
  // Two by two, top row first: red opaque, green hole / blue hole, white opaque.
  WritePicture("hawthorne.png", 2, 2, 4, {255, 0, 0, 255, 0, 255, 0, 0, 0, 0, 255, 0, 255, 255, 255, 200});
  WritePicture("wire.png", 2, 1, 1, {255, 10});
  const absl::StatusOr<Scene> scene = LoadScene(Write("garden.obj", kGarden));
  ASSERT_TRUE(scene.ok()) << scene.status();
  EXPECT_EQ(scene->name, "garden");
  EXPECT_EQ(scene->TriangleCount(), 4u);
  EXPECT_EQ(scene->WsBounds().max, glm::dvec3(4, 4, 3)) << "no axis may be swapped";

  ASSERT_EQ(scene->color_textures.size(), 1u) << "the aerial photograph is not used, wire.png is no colour";
  ASSERT_EQ(scene->alpha_textures.size(), 2u);
  int seen = 0;
  for (const Mesh& mesh : scene->meshes) {
    const Material& material = scene->materials[static_cast<size_t>(mesh.material)];
    if (material.name == "ground") {
      EXPECT_EQ(mesh.triangles.size(), 2u);
      EXPECT_EQ(material.alpha_texture, -1);
      EXPECT_EQ(material.color_texture, -1);
      EXPECT_EQ(mesh.normals.at(0), glm::vec3(0, 0, 1));
      ++seen;
    } else if (material.name == "leaves") {
      ASSERT_GE(material.alpha_texture, 0);
      const AlphaTexture& alpha = scene->alpha_textures[static_cast<size_t>(material.alpha_texture)];
      EXPECT_EQ(alpha.AlphaAt({0.25f, 0.75f}), 255);
      EXPECT_EQ(alpha.AlphaAt({0.75f, 0.75f}), 0);
      EXPECT_EQ(alpha.AlphaAt({0.25f, 0.25f}), 0);
      EXPECT_EQ(alpha.AlphaAt({-0.25f, 1.25f}), 200) << "repeated outside [0,1]";
      ASSERT_EQ(material.color_texture, 0);
      // Row 0 is v = 0, the bottom: the blue texel comes first.
      EXPECT_THAT(scene->color_textures[0].rgb,
                  ::testing::ElementsAre(0, 0, 255, 255, 255, 255, 255, 0, 0, 0, 255, 0));
      EXPECT_EQ(mesh.normals.size(), mesh.positions.size()) << "missing normals are computed";
      ++seen;
    } else if (material.name == "mesh") {
      ASSERT_GE(material.alpha_texture, 0);
      const AlphaTexture& alpha = scene->alpha_textures[static_cast<size_t>(material.alpha_texture)];
      EXPECT_EQ(alpha.AlphaAt({0.25f, 0.5f}), 255);
      EXPECT_EQ(alpha.AlphaAt({0.75f, 0.5f}), 10) << "a picture without alpha gives opacity by its grey";
      ++seen;
    }
  }
  EXPECT_EQ(seen, 3);
}

TEST_F(LoadSceneTest, ColourIsReflectanceNotScreenValue) {
  Write("garden.mtl", "newmtl m\nKd 0.5 0 1\n");
  const absl::StatusOr<Scene> scene =
      LoadScene(Write("t.obj", "mtllib garden.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n"));
  ASSERT_TRUE(scene.ok()) << scene.status();
  const Material& material = scene->materials[static_cast<size_t>(scene->meshes[0].material)];
  EXPECT_NEAR(material.diffuse.r, 0.21404, 1e-4);
  EXPECT_EQ(material.diffuse.g, 0.0f);
  EXPECT_EQ(material.diffuse.b, 1.0f);
}

TEST_F(LoadSceneTest, MissingColourPictureIsNoErrorButMissingCutoutIs) {
  const std::string triangle = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\n";
  Write("m.mtl", "newmtl m\nKd 1 1 1\nmap_Kd gone.png\n");
  EXPECT_TRUE(LoadScene(Write("t.obj", triangle)).ok());
  Write("m.mtl", "newmtl m\nKd 1 1 1\nmap_d gone.png\n");
  const absl::Status status = LoadScene(Write("t.obj", triangle)).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(status.message(), AllOf(HasSubstr("cutout"), HasSubstr("gone.png"), HasSubstr("\"m\"")));
}

TEST_F(LoadSceneTest, BadInputIsNamed) {
  struct Case {
    std::string name;
    std::string contents;  // Written to `name` unless empty.
    absl::StatusCode code;
    std::string message;
  };
  const std::vector<Case> cases = {
      {"missing.obj", "", absl::StatusCode::kNotFound, "no such file"},
      {"empty.obj", " ", absl::StatusCode::kInvalidArgument, "empty.obj"},
      {"noise.obj", "\x01\x02\xff\xfe noise", absl::StatusCode::kInvalidArgument, "noise.obj"},
      {"points.obj", "v 0 0 0\nv 1 0 0\n", absl::StatusCode::kInvalidArgument, "points.obj"},
      {"index.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", absl::StatusCode::kInvalidArgument, "index.obj"},
      {"nan.obj", "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", absl::StatusCode::kInvalidArgument, "nan.obj"},
      {"unknown.xyzzy", "hello", absl::StatusCode::kInvalidArgument, "unknown.xyzzy"},
      {"cut.glb", "glTF\x02", absl::StatusCode::kInvalidArgument, "cut.glb"},
      {"wire.obj", "mtllib wire.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n",
       absl::StatusCode::kInvalidArgument, "wire.png"},
  };
  Write("wire.mtl", "newmtl m\nmap_d wire.png\n");
  Write("wire.png", "not a picture");
  for (const Case& c : cases) {
    SCOPED_TRACE(c.name);
    const std::string path = c.contents.empty() ? (folder_ / c.name).string() : Write(c.name, c.contents);
    const absl::Status status = LoadScene(path).status();
    EXPECT_EQ(status.code(), c.code) << status;
    EXPECT_THAT(status.message(), HasSubstr(c.message));
  }
  EXPECT_EQ(LoadScene("").status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(LoadScene(folder_.string()).status().code(), absl::StatusCode::kInvalidArgument) << "a folder";
}

TEST_F(LoadSceneTest, GeneratedScenesGoByName) {
  const absl::StatusOr<Scene> scene = LoadScene("plaza:20000");
  ASSERT_TRUE(scene.ok()) << scene.status();
  EXPECT_EQ(scene->TriangleCount(), 20000u);
  EXPECT_EQ(LoadScene("plaza:many").status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(LoadScene("plazza").status().message(), AllOf(HasSubstr("plazza"), HasSubstr("plaza,")));
}

TEST_F(LoadSceneTest, SterngartenComesFromTheCacheFolder) {
  ASSERT_EQ(setenv("XDG_CACHE_HOME", folder_.c_str(), 1), 0);
  const absl::Status missing = LoadScene("sterngarten").status();
  EXPECT_EQ(missing.code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(missing.message(),
              AllOf(HasSubstr("deploy/fetch-sterngarten.sh"), HasSubstr(folder_.string())));

  fs::create_directories(folder_ / "shadowfit/scenes/sterngarten");
  Write("shadowfit/scenes/sterngarten/Sterngarten_Wien_innerArea-optimized.obj",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
  const absl::StatusOr<Scene> scene = LoadScene("sterngarten");
  ASSERT_TRUE(scene.ok()) << scene.status();
  EXPECT_EQ(scene->name, "sterngarten");
  EXPECT_EQ(scene->TriangleCount(), 1u);
}

}  // namespace
}  // namespace shadowfit
