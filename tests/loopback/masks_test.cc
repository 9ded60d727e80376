#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <functional>
#include <glm/gtc/matrix_transform.hpp>
#include <iostream>
#include <limits>
#include <random>
#include <stop_token>
#include <string>
#include <thread>
#include <vector>

#include "client/scene_io/scene_to_wire.h"
#include "core/irregular/shadow_masks.h"
#include "core/reference/truth_scene.h"
#include "core/scene/procedural.h"
#include "google/rpc/error_details.pb.h"
#include "server/scene_digest.h"
#include "shadowfit/v1/scene.grpc.pb.h"
#include "tests/loopback/loopback.h"
#include "tests/support/wire_frame.h"

namespace shadowfit {
namespace {

using ::testing::HasSubstr;
using namespace std::chrono_literals;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr int kWidth = 101, kHeight = 70;  // No multiples of anything.

/// A scene with everything: several instances, a cutout, a semi-transparent material.
Scene ColourfulScene() {
  Scene scene = MakeRandomTriangles(600, 5);
  scene.alpha_textures.push_back({4, 4, {}});
  std::mt19937 random(3);
  for (int i = 0; i < 16; ++i) scene.alpha_textures[0].alpha.push_back(static_cast<uint8_t>(random() % 256));
  const auto base = static_cast<int>(scene.materials.size());
  scene.materials.emplace_back().alpha_texture = 0;
  scene.materials.emplace_back().transmittance = {0.9f, 0.5f, 0.25f};
  for (int m = 0; m < 2; ++m) {
    Mesh& mesh = scene.meshes.emplace_back();
    mesh.positions = {{-1, -1, 3}, {1, -1, 3}, {1, 1, 3}, {-1, 1, 3}};
    mesh.uvs = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
    mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
    mesh.material = base + m;
    Instance& instance = scene.instances.emplace_back();
    instance.mesh = static_cast<int>(scene.meshes.size()) - 1;
    instance.world_from_object[3] = {m == 0 ? -1.5f : 1.5f, 0, 0};
  }
  return scene;
}

/// What a camera sees of a scene, and three lights.
struct Shot {
  Scene scene = ColourfulScene();
  CameraMatrices matrices;
  std::vector<float> depth;
  std::vector<Light> lights = {PointLight{{2, 1, 8}}, SpotLight{{-3, -3, 9}, {0.3, 0.3, -1}, 0.5},
                               DirectionalLight{{0.3, 0.2, -1}}};

  Shot() {
    matrices.view_from_world = glm::lookAt(glm::dvec3(0, -9, 6), glm::dvec3(0, 0, 1), glm::dvec3(0, 0, 1));
    matrices.clip_from_view = glm::perspective(0.9, double(kWidth) / kHeight, 0.1, 200.0);
    depth = TruthScene::Create(scene)->RenderSurface(*Camera::Create(matrices), kWidth, kHeight).depth;
  }

  v1::MaskFrame Frame(uint64_t id, const std::string& digest) const {
    v1::MaskFrame frame;
    frame.set_frame_id(id);
    frame.set_scene_digest(digest);
    testing::SetMatrix(matrices.view_from_world, frame.mutable_camera()->mutable_view());
    testing::SetMatrix(matrices.clip_from_view, frame.mutable_camera()->mutable_projection());
    v1::DepthBuffer& buffer = *frame.add_layers()->mutable_depth();
    buffer.set_width(kWidth);
    buffer.set_height(kHeight);
    buffer.set_data(std::string(reinterpret_cast<const char*>(depth.data()), depth.size() * sizeof(float)));
    for (const Light& light : lights) {
      LightRequest request;
      request.id = 100 + static_cast<uint32_t>(frame.lights_size());
      request.light = light;
      testing::SetLight(request, frame.add_lights());
    }
    return frame;
  }

  MaskRequest Request(const MaskScene& mask_scene, const Camera& camera, const ReceiverLayer& layer) const {
    MaskRequest request;
    request.scene = &mask_scene;
    request.camera = &camera;
    request.layers = {&layer, 1};
    request.lights = lights;
    return request;
  }
};

bool WireBit(const v1::LightMask& mask, int row, int x) {
  const int row_bytes = (kWidth + 7) / 8;
  return (static_cast<uint8_t>(mask.bits()[static_cast<size_t>(row * row_bytes + x / 8)]) >> (x % 8) & 1) !=
         0;
}

TEST(Scenes, AreUploadedOnceListedAndForgotten) {
  testing::Loopback loopback;
  const auto client = loopback.Connect();
  const Scene scene = ColourfulScene();
  const PackedScene packed = PackScene(SceneToWire(scene));
  const std::vector<std::string> digests = {packed.digest, std::string(64, '0')};
  auto missing = client->FindMissingScenes(digests);
  ASSERT_TRUE(missing.ok()) << missing.status();
  EXPECT_EQ(*missing, digests);

  auto uploaded = client->UploadScene(packed);
  ASSERT_TRUE(uploaded.ok()) << uploaded.status();
  EXPECT_FALSE(uploaded->existed());
  EXPECT_EQ(uploaded->scene().digest(), packed.digest);
  EXPECT_EQ(uploaded->scene().triangles(), scene.TriangleCount());
  uploaded = client->UploadScene(packed);
  ASSERT_TRUE(uploaded.ok()) << uploaded.status();
  EXPECT_TRUE(uploaded->existed());
  missing = client->FindMissingScenes(digests);
  ASSERT_TRUE(missing.ok()) << missing.status();
  EXPECT_EQ(*missing, std::vector<std::string>(1, digests[1]));

  const auto list = client->ListScenes();
  ASSERT_TRUE(list.ok()) << list.status();
  ASSERT_EQ(list->scenes_size(), 1);
  EXPECT_EQ(list->bytes(), list->scenes(0).bytes());
  EXPECT_GT(list->bytes(), 36 * scene.TriangleCount());
  EXPECT_TRUE(client->DeleteScene(packed.digest).ok());
  EXPECT_EQ(client->DeleteScene(packed.digest).code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(client->ListScenes()->scenes_size(), 0);
}

/// A service that has the scene answers before the client has sent it: no transport may wait for the rest.
TEST(Scenes, AreNotSentTwiceInProcess) {
  testing::Loopback loopback;
  const auto client = loopback.ConnectInProcess();
  const PackedScene packed = PackScene(SceneToWire(MakeRandomTriangles(50000, 5)));
  CallOptions call;
  call.timeout = std::chrono::seconds(10);
  for (const bool existed : {false, true, true}) {
    const auto uploaded = client->UploadScene(packed, call);
    ASSERT_TRUE(uploaded.ok()) << uploaded.status();
    EXPECT_EQ(uploaded->existed(), existed);
  }
}

/// Replicas take turns, call by call, wherever the turn stands when masks are asked for.
TEST(Scenes, ReachAllReplicas) {
  const Shot shot;
  const PackedScene packed = PackScene(SceneToWire(shot.scene));
  for (int calls_before = 0; calls_before < 2; ++calls_before) {
    testing::Loopback a;
    testing::Loopback b;
    auto client = Client::Connect("ipv4:" + a.tcp() + "," + b.tcp());
    ASSERT_TRUE(client.ok()) << client.status();
    for (int i = 0; i < calls_before; ++i) ASSERT_TRUE((*client)->GetInfo().ok());
    for (uint64_t frame = 1; frame <= 4; ++frame) {
      const auto masks = (*client)->RenderMasks(shot.Frame(frame, packed.digest), &packed);
      ASSERT_TRUE(masks.ok()) << masks.status();
    }
  }
}

/// Some megabytes, in many chunks.
TEST(Scenes, LargeOnesArriveWhole) {
  testing::Loopback loopback;
  const auto client = loopback.Connect();
  const Scene scene = MakeRandomTriangles(150000, 5);
  const PackedScene packed = PackScene(SceneToWire(scene));
  EXPECT_GT(packed.bytes.size(), size_t{5} << 20);
  const auto uploaded = client->UploadScene(packed);
  ASSERT_TRUE(uploaded.ok()) << uploaded.status();
  EXPECT_EQ(uploaded->scene().triangles(), scene.TriangleCount());
}

TEST(Scenes, TheQuotaHolds) {
  ServerOptions options;
  options.max_scene_bytes = 400'000;
  testing::Loopback loopback(options);
  const auto client = loopback.Connect();
  const auto put = [&](size_t triangles, uint32_t seed) {
    return client->UploadScene(PackScene(SceneToWire(MakeRandomTriangles(triangles, seed)))).status();
  };
  EXPECT_TRUE(put(3000, 1).ok());
  EXPECT_TRUE(put(3000, 2).ok());
  EXPECT_TRUE(put(3000, 3).ok());
  const auto list = client->ListScenes();
  ASSERT_TRUE(list.ok()) << list.status();
  EXPECT_LT(list->scenes_size(), 3);
  EXPECT_LE(list->bytes(), options.max_scene_bytes);
  EXPECT_EQ(put(30000, 4).code(), absl::StatusCode::kResourceExhausted);

  // Few bytes, very many triangles.
  v1::SceneData bomb = SceneToWire(MakeRandomTriangles(1000, 5));
  for (int i = 0; i < 100000; ++i) *bomb.add_instances() = bomb.instances(0);
  EXPECT_EQ(client->UploadScene(PackScene(bomb)).status().code(), absl::StatusCode::kResourceExhausted);
  EXPECT_TRUE(put(3000, 6).ok());
}

struct BadScene {
  const char* message;  // Begins thus.
  std::function<void(v1::SceneData&)> change;
};

void SetFloat(std::string* bytes, size_t index, float value) {
  std::memcpy(bytes->data() + index * sizeof(float), &value, sizeof(value));
}

TEST(Scenes, BadOnesAreRefusedByName) {
  const std::vector<BadScene> table = {
      {"meshes[0].positions[1]: ",
       [](auto& s) { SetFloat(s.mutable_meshes(0)->mutable_positions(), 4, kNan); }},
      {"meshes[0].positions[0]: ",
       [](auto& s) {
         SetFloat(s.mutable_meshes(0)->mutable_positions(), 0, std::numeric_limits<float>::infinity());
       }},
      {"meshes[0].triangles[0][2]: index",
       [](auto& s) {
         const uint32_t index = s.meshes(0).vertex_count();
         std::memcpy(s.mutable_meshes(0)->mutable_triangles()->data() + 8, &index, sizeof(index));
       }},
      {"meshes[0].triangles: ", [](auto& s) { s.mutable_meshes(0)->set_triangle_count(0x80000000u); }},
      {"meshes[0].positions: ", [](auto& s) { s.mutable_meshes(0)->set_vertex_count(0xFFFFFFFFu); }},
      {"meshes[0].triangles: ",
       [](auto& s) {
         s.mutable_meshes(0)->set_triangle_count(0);
         s.mutable_meshes(0)->clear_triangles();
       }},
      {"meshes[0].triangles: ", [](auto& s) { s.mutable_meshes(0)->mutable_triangles()->pop_back(); }},
      {"materials[2].alpha_texture: 7, but there are 1",
       [](auto& s) { s.mutable_materials(2)->set_alpha_texture(7); }},
      {"materials[2].alpha_texture: 0, but there are 0", [](auto& s) { s.clear_alpha_textures(); }},
      {"materials[2].alpha_cutoff: ", [](auto& s) { s.mutable_materials(2)->set_alpha_cutoff(256); }},
      {"materials[3].transmittance[0]: ",
       [](auto& s) { s.mutable_materials(3)->mutable_transmittance()->set_x(kNan); }},
      {"alpha_textures[0].alpha: ",
       [](auto& s) { s.mutable_alpha_textures(0)->mutable_alpha()->pop_back(); }},
      {"alpha_textures[0].width: ", [](auto& s) { s.mutable_alpha_textures(0)->set_width(0); }},
      {"alpha_textures[0].height: ", [](auto& s) { s.mutable_alpha_textures(0)->set_height(0x80000000u); }},
      {"meshes[2].uvs: none", [](auto& s) { s.mutable_meshes(2)->clear_texture_coordinates(); }},
      {"meshes[2].material: ", [](auto& s) { s.mutable_meshes(2)->set_material(0xFFFFFFFFu); }},
      {"instances[0].mesh: ", [](auto& s) { s.mutable_instances(0)->set_mesh(99); }},
      {"instances[0].world_from_object: ",
       [](auto& s) { s.mutable_instances(0)->add_world_from_object(1.0f); }},
      {"instances[0].world_from_object[3]: ",
       [](auto& s) {
         s.mutable_instances(0)->clear_world_from_object();
         for (int i = 0; i < 12; ++i) s.mutable_instances(0)->add_world_from_object(i < 9 ? 1.0f : kNan);
       }},
  };
  testing::Loopback loopback;
  const auto client = loopback.Connect();
  const v1::SceneData good = SceneToWire(ColourfulScene());
  ASSERT_EQ(good.materials_size(), 4) << "the table means these";
  ASSERT_EQ(good.meshes_size(), 4) << "the table means these";
  for (const BadScene& bad : table) {
    v1::SceneData scene = good;
    bad.change(scene);
    const absl::Status status = client->UploadScene(PackScene(scene)).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << bad.message << '\n' << status;
    EXPECT_THAT(std::string(status.message()), HasSubstr(bad.message));
    EXPECT_TRUE(status.GetPayload("type.googleapis.com/google.rpc.BadRequest").has_value()) << bad.message;
  }
  // The server is none the worse.
  EXPECT_EQ(client->ListScenes()->scenes_size(), 0);
  EXPECT_EQ(client->ListScenes()->bytes(), 0u);
  EXPECT_TRUE(client->UploadScene(PackScene(good)).ok());
}

TEST(Scenes, BadUploadsAreRefused) {
  testing::Loopback loopback;
  const auto client = loopback.Connect();
  const PackedScene good = PackScene(SceneToWire(ColourfulScene()));
  const auto upload = [&](const std::string& digest, uint64_t total, const std::vector<std::string>& chunks) {
    const auto stub = v1::SceneService::NewStub(client->channel());
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + 10s);
    v1::UploadSceneResponse response;
    const auto writer = stub->UploadScene(&context, &response);
    v1::UploadSceneRequest chunk;
    chunk.set_digest(digest);
    chunk.set_total_bytes(total);
    for (const std::string& data : chunks) {
      chunk.set_data(data);
      if (!writer->Write(chunk)) break;
    }
    writer->WritesDone();
    return writer->Finish();
  };
  const auto expect = [](const grpc::Status& status, grpc::StatusCode code, const char* message) {
    EXPECT_EQ(status.error_code(), code) << status.error_message();
    EXPECT_THAT(status.error_message(), HasSubstr(message));
  };
  const uint64_t size = good.bytes.size();
  expect(upload(good.digest, size, {}), grpc::StatusCode::INVALID_ARGUMENT, "digest: missing");
  expect(upload("x", size, {good.bytes}), grpc::StatusCode::INVALID_ARGUMENT, "digest: 1 characters");
  expect(upload(good.digest, 0, {good.bytes}), grpc::StatusCode::INVALID_ARGUMENT, "total_bytes: 0");
  expect(upload(good.digest, uint64_t{1} << 40, {good.bytes}), grpc::StatusCode::INVALID_ARGUMENT,
         "total_bytes: ");
  expect(upload(good.digest, uint64_t{1} << 30, {good.bytes}), grpc::StatusCode::RESOURCE_EXHAUSTED,
         "exceeds");
  expect(upload(good.digest, size - 1, {good.bytes}), grpc::StatusCode::INVALID_ARGUMENT, "data: ");
  expect(upload(good.digest, size + 1, {good.bytes}), grpc::StatusCode::INVALID_ARGUMENT, "total_bytes: ");
  expect(upload(std::string(64, 'a'), size, {good.bytes}), grpc::StatusCode::INVALID_ARGUMENT, "digest: aaa");
  const std::string garbage(1000, '\xFF');
  expect(upload(SceneDigest(garbage), garbage.size(), {garbage}), grpc::StatusCode::INVALID_ARGUMENT,
         "data: not a serialized SceneData");
  EXPECT_EQ(client->ListScenes()->scenes_size(), 0);
  EXPECT_TRUE(upload(good.digest, size, {good.bytes.substr(0, 7), good.bytes.substr(7)}).ok());
  EXPECT_EQ(testing::CheckHealth(client->channel(), "shadowfit.v1.SceneService"), 1);
}

TEST(Masks, EqualThoseOfTheLibrary) {
  const Shot shot;
  testing::Loopback loopback;
  const auto client = loopback.Connect();
  const PackedScene packed = PackScene(SceneToWire(shot.scene));
  const auto mask_scene = MaskScene::Create(shot.scene);
  ASSERT_TRUE(mask_scene.ok()) << mask_scene.status();
  const Camera camera = *Camera::Create(shot.matrices);
  MaskRenderer renderer;
  for (const bool top_first : {false, true}) {
    for (const auto output : {MaskOutput::kBits, MaskOutput::kTransmittance, MaskOutput::kCoverage}) {
      ReceiverLayer layer;
      layer.depth = top_first ? TopFirst(shot.depth.data(), kWidth, kHeight)
                              : BottomFirst(shot.depth.data(), kWidth, kHeight);
      MaskRequest request = shot.Request(*mask_scene, camera, layer);
      request.output = output;
      const auto masks = renderer.Render(request);
      ASSERT_TRUE(masks.ok()) << masks.status();
      v1::MaskFrame frame = shot.Frame(7, packed.digest);
      frame.mutable_layers(0)->mutable_depth()->set_row_order(top_first ? v1::ROW_ORDER_TOP_FIRST
                                                                        : v1::ROW_ORDER_BOTTOM_FIRST);
      frame.set_output(static_cast<v1::MaskOutput>(static_cast<int>(output) + v1::MASK_OUTPUT_BITS));
      const auto result = client->RenderMasks(frame, &packed);  // The first call uploads the scene.
      ASSERT_TRUE(result.ok()) << result.status();
      EXPECT_EQ(result->frame_id(), 7u);
      EXPECT_EQ(result->width(), unsigned{kWidth});
      EXPECT_EQ(result->height(), unsigned{kHeight});
      ASSERT_EQ(result->lights_size(), 3);
      for (int i = 0; i < 3; ++i) {
        const LightMask& mask = (*masks)[static_cast<size_t>(i)];
        const v1::LightMask& wire = result->lights(i);
        EXPECT_EQ(wire.id(), 100u + static_cast<unsigned>(i));
        EXPECT_EQ(wire.samples(), mask.samples);
        EXPECT_EQ(wire.shadowed_samples(), mask.shadowed_samples);
        EXPECT_EQ(wire.undecided_samples(), mask.undecided_samples);
        EXPECT_EQ(wire.outside_cone_samples(), mask.outside_cone_samples);
        EXPECT_EQ(wire.bits().size(),
                  output == MaskOutput::kCoverage ? 0 : size_t{(kWidth + 7) / 8} * kHeight);
        EXPECT_EQ(wire.rgb().size(), output == MaskOutput::kTransmittance ? size_t{kWidth} * kHeight * 3 : 0);
        EXPECT_EQ(wire.coverage().size(), output == MaskOutput::kCoverage ? size_t{kWidth} * kHeight : 0);
        for (int y = 0; y < kHeight; ++y) {
          const int row = top_first ? kHeight - 1 - y : y;
          for (int x = 0; x < kWidth; ++x) {
            const auto pixel = static_cast<size_t>(row * kWidth + x),
                       bottom_first = static_cast<size_t>(y * kWidth + x);
            if (output != MaskOutput::kCoverage) {
              ASSERT_EQ(WireBit(wire, row, x), mask.InShadow(0, kHeight, x, y)) << x << ' ' << y;
            } else {
              ASSERT_EQ(static_cast<uint8_t>(wire.coverage()[pixel]), mask.coverage[bottom_first]);
            }
            for (size_t c = 0; output == MaskOutput::kTransmittance && c < 3; ++c) {
              ASSERT_EQ(static_cast<uint8_t>(wire.rgb()[3 * pixel + c]), mask.rgb[3 * bottom_first + c]);
            }
          }
        }
      }
      EXPECT_GT(result->lights(0).shadowed_samples(), 50u);
    }
  }
}

TEST(Masks, InstancesMoveFromFrameToFrame) {
  Shot shot;
  testing::Loopback loopback;
  const auto client = loopback.Connect();
  const PackedScene packed = PackScene(SceneToWire(shot.scene));
  v1::MaskFrame frame = shot.Frame(1, packed.digest);
  const auto still = client->RenderMasks(frame, &packed);
  ASSERT_TRUE(still.ok()) << still.status();
  v1::InstanceTransform& moved = *frame.add_moved_instances();
  const auto instance = shot.scene.instances.size() - 2;
  moved.set_instance(static_cast<uint32_t>(instance));
  shot.scene.instances[instance].world_from_object[3] = {0.5f, -0.5f, -1.0f};
  for (int i = 0; i < 12; ++i) {
    moved.add_world_from_object(shot.scene.instances[instance].world_from_object[i / 3][i % 3]);
  }
  const auto elsewhere = client->RenderMasks(frame);
  ASSERT_TRUE(elsewhere.ok()) << elsewhere.status();
  EXPECT_NE(elsewhere->lights(0).bits(), still->lights(0).bits());
  // As a scene of its own, in which the instance stands there.
  const PackedScene other = PackScene(SceneToWire(shot.scene));
  const auto expected = client->RenderMasks(shot.Frame(1, other.digest), &other);
  ASSERT_TRUE(expected.ok()) << expected.status();
  EXPECT_EQ(elsewhere->lights(0).bits(), expected->lights(0).bits());
  frame.clear_moved_instances();
  const auto back = client->RenderMasks(frame);
  ASSERT_TRUE(back.ok()) << back.status();
  EXPECT_EQ(back->lights(0).bits(), still->lights(0).bits());
}

struct BadFrame {
  const char* message;
  std::function<void(v1::MaskFrame&)> change;
};

TEST(Masks, BadFramesAreRefusedByName) {
  const std::vector<BadFrame> table = {
      {"camera: missing", [](auto& f) { f.clear_camera(); }},
      {"camera.view.m: 15 entries",
       [](auto& f) { f.mutable_camera()->mutable_view()->mutable_m()->RemoveLast(); }},
      {"camera", [](auto& f) { f.mutable_camera()->mutable_projection()->set_m(0, double{kNan}); }},
      {"layers: 0, 1 to 64", [](auto& f) { f.clear_layers(); }},
      {"layers[0].depth: missing", [](auto& f) { f.mutable_layers(0)->clear_depth(); }},
      {"layers: 1 of", [](auto& f) { f.mutable_layers(0)->mutable_depth()->set_width(0x80000000u); }},
      {"layers[0].depth.data: ",
       [](auto& f) { f.mutable_layers(0)->mutable_depth()->mutable_data()->pop_back(); }},
      {"layers[0].depth.height: 0", [](auto& f) { f.mutable_layers(0)->mutable_depth()->set_height(0); }},
      {"layers[0].depth.encoding: ",
       [](auto& f) {
         f.mutable_layers(0)->mutable_depth()->set_encoding(static_cast<v1::DepthEncoding>(77));
       }},
      {"layers[1].depth: size", [](auto& f) { f.add_layers()->mutable_depth()->set_width(3); }},
      {"layers[0].normals: 5 bytes", [](auto& f) { f.mutable_layers(0)->set_normals("12345"); }},
      {"layers[0].pixel_offset: ", [](auto& f) { f.mutable_layers(0)->set_offset_x(double{kNan}); }},
      {"lights: 0, 1 to 32", [](auto& f) { f.clear_lights(); }},
      {"lights: 35, 1 to 32",
       [](auto& f) {
         for (int i = 0; i < 32; ++i) *f.add_lights() = f.lights(0);
       }},
      {"lights[0].kind: missing", [](auto& f) { f.mutable_lights(0)->clear_kind(); }},
      {"lights[0].point.position",
       [](auto& f) { f.mutable_lights(0)->mutable_point()->mutable_position()->set_x(double{kNan}); }},
      {"lights[1].spot.direction: zero-length",
       [](auto& f) { *f.mutable_lights(1)->mutable_spot()->mutable_direction() = v1::Vector3(); }},
      {"moved_instances[0].instance: 99",
       [](auto& f) {
         v1::InstanceTransform& moved = *f.add_moved_instances();
         moved.set_instance(99);
         for (int i = 0; i < 12; ++i) moved.add_world_from_object(0.0f);
       }},
      {"moved_instances[0].world_from_object: 0 entries", [](auto& f) { f.add_moved_instances(); }},
      {"output: unknown value 9", [](auto& f) { f.set_output(static_cast<v1::MaskOutput>(9)); }},
      {"method: unknown value 9", [](auto& f) { f.set_method(static_cast<v1::MaskMethod>(9)); }},
      {"scene_digest: 0 characters", [](auto& f) { f.clear_scene_digest(); }},
  };
  const Shot shot;
  testing::Loopback loopback;
  const auto client = loopback.Connect();
  const PackedScene packed = PackScene(SceneToWire(shot.scene));
  ASSERT_TRUE(client->UploadScene(packed).ok());
  for (const BadFrame& bad : table) {
    v1::MaskFrame frame = shot.Frame(1, packed.digest);
    bad.change(frame);
    const absl::Status status = client->RenderMasks(frame).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << bad.message << '\n' << status;
    EXPECT_THAT(std::string(status.message()), HasSubstr(bad.message));
  }
  const absl::Status unknown = client->RenderMasks(shot.Frame(1, std::string(64, 'b'))).status();
  EXPECT_EQ(unknown.code(), absl::StatusCode::kNotFound) << unknown;
  EXPECT_TRUE(client->RenderMasks(shot.Frame(1, packed.digest)).ok());
}

TEST(Masks, StreamGoesOnAfterErrors) {
  const Shot shot;
  testing::Loopback loopback;
  const auto client = loopback.Connect();
  const PackedScene packed = PackScene(SceneToWire(shot.scene));
  const auto stream = client->OpenMaskStream();
  const auto send = [&](uint64_t id, const std::string& digest) {
    v1::MaskFrame* frame = stream->Acquire();
    ASSERT_NE(frame, nullptr);
    *frame = shot.Frame(id, digest);
    ASSERT_TRUE(stream->Submit(frame).ok());
  };
  send(1, packed.digest);
  auto outcome = stream->Wait(10s);
  ASSERT_TRUE(outcome.has_value());
  EXPECT_EQ(outcome->result.status().code(), absl::StatusCode::kNotFound) << outcome->result.status();
  ASSERT_TRUE(client->UploadScene(packed).ok());
  std::string bits;
  for (uint64_t id = 2; id < 6; ++id) {
    send(id, packed.digest);
    outcome = stream->Wait(10s);
    ASSERT_TRUE(outcome.has_value());
    ASSERT_TRUE(outcome->result.ok()) << outcome->result.status();
    EXPECT_EQ(outcome->frame_id, id);
    if (bits.empty()) bits = outcome->result->lights(0).bits();
    EXPECT_EQ(outcome->result->lights(0).bits(), bits);
  }
  EXPECT_TRUE(stream->Finish(10s).ok());
}

/// A service with the scene needs no bits: the matrices are those of exact bits.
TEST(Masks, GiveTheOptimizerItsBits) {
  const Shot shot;
  testing::Loopback loopback;
  const auto client = loopback.Connect();
  const PackedScene packed = PackScene(SceneToWire(shot.scene));
  const auto masks = client->RenderMasks(shot.Frame(1, packed.digest), &packed);
  ASSERT_TRUE(masks.ok()) << masks.status();
  v1::Frame frame;
  const v1::MaskFrame mask_frame = shot.Frame(1, packed.digest);
  frame.set_frame_id(1);
  *frame.mutable_camera() = mask_frame.camera();
  *frame.mutable_depth() = mask_frame.layers(0).depth();
  for (const v1::Light& light : mask_frame.lights()) {
    *frame.add_lights() = light;
    frame.mutable_lights(frame.lights_size() - 1)->mutable_shadow_map()->set_width(512);
    frame.mutable_lights(frame.lights_size() - 1)->mutable_shadow_map()->set_height(512);
  }
  const auto without = client->Optimize(frame);
  ASSERT_TRUE(without.ok()) << without.status();
  frame.set_scene_digest(packed.digest);
  const auto with_scene = client->Optimize(frame);
  ASSERT_TRUE(with_scene.ok()) << with_scene.status();
  frame.clear_scene_digest();
  v1::BitBuffer& bits = *frame.mutable_shadow_bits();
  bits.set_width(kWidth);
  bits.set_height(kHeight);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      uint32_t value = 0;
      for (int i = 0; i < 3; ++i) value |= uint32_t{WireBit(masks->lights(i), y, x)} << i;
      bits.mutable_data()->append(reinterpret_cast<const char*>(&value), sizeof(value));
    }
  }
  const auto with_bits = client->Optimize(frame);
  ASSERT_TRUE(with_bits.ok()) << with_bits.status();
  EXPECT_EQ(testing::MatrixBytes(*with_scene), testing::MatrixBytes(*with_bits));
  EXPECT_NE(testing::MatrixBytes(*with_scene), testing::MatrixBytes(*without));
  EXPECT_EQ(with_scene->lights(0).sample_source(), v1::SAMPLE_SOURCE_SHADOW_BOUNDARY);
  frame.clear_shadow_bits();
  frame.set_scene_digest(std::string(64, 'c'));
  EXPECT_EQ(client->Optimize(frame).status().code(), absl::StatusCode::kNotFound);
}

/// From the client's wish to the worker's being free again.
TEST(Masks, AreCancelledAtOnce) {
  Shot shot;
  shot.scene = MakeRandomTriangles(300000, 5);
  testing::Loopback loopback;
  const auto client = loopback.Connect();
  const PackedScene packed = PackScene(SceneToWire(shot.scene));
  ASSERT_TRUE(client->UploadScene(packed).ok());
  v1::MaskFrame frame = shot.Frame(1, packed.digest);
  frame.set_method(v1::MASK_METHOD_EXHAUSTIVE);  // Takes seconds.
  std::vector<double> waits;
  for (const auto delay : {30ms, 60ms, 110ms, 170ms, 240ms}) {
    std::stop_source stop;
    std::chrono::steady_clock::time_point asked;
    std::thread canceller([&] {
      std::this_thread::sleep_for(delay);
      asked = std::chrono::steady_clock::now();
      stop.request_stop();
    });
    CallOptions call;
    call.stop = stop.get_token();
    const absl::Status status = client->RenderMasks(frame, nullptr, call).status();
    canceller.join();
    EXPECT_EQ(status.code(), absl::StatusCode::kCancelled) << status;
    while (client->GetInfo()->load().admitted_jobs() > 0) std::this_thread::yield();
    waits.push_back(
        std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - asked).count());
  }
  std::sort(waits.begin(), waits.end());
  std::cout << "workers free after " << waits.front() << " to " << waits.back() << " ms, median " << waits[2]
            << " ms\n";
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  EXPECT_LT(waits[2], 500.0);  // What lies between two polls is slower.
#else
  EXPECT_LT(waits[2],
            50.0);  // 20 ms on a machine of its own, of which it needs 2 to 6; this one may be busy.
#endif
}

}  // namespace
}  // namespace shadowfit
