#include "server/scene_decoder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "client/scene_io/scene_to_wire.h"
#include "core/irregular/mask_scene.h"
#include "core/scene/procedural.h"
#include "server/scene_digest.h"
#include "shadowfit/v1/scene.pb.h"

namespace shadowfit {
namespace {

using ::testing::HasSubstr;
using Clock = Cancellation::Clock;

std::string WireBytes(const Scene& scene) { return SceneToWire(scene).SerializeAsString(); }

TEST(SceneDecoder, BringsBackWhatWasSerialized) {
  // More bytes than are read, or copied, at a time.
  const Scene scene = MakeRandomTriangles(100000, 3);
  const Cancellation never;
  const absl::StatusOr<Scene> decoded = DecodeScene(WireBytes(scene), &never);
  ASSERT_TRUE(decoded.ok()) << decoded.status();
  ASSERT_EQ(decoded->meshes.size(), scene.meshes.size());
  for (size_t i = 0; i < scene.meshes.size(); ++i) {
    EXPECT_EQ(decoded->meshes[i].positions, scene.meshes[i].positions);
    EXPECT_EQ(decoded->meshes[i].triangles, scene.meshes[i].triangles);
  }
}

TEST(SceneDecoder, SaysWhatIsWrong) {
  const auto message = [](const std::string& bytes) { return DecodeScene(bytes).status().ToString(); };
  EXPECT_THAT(message("\xFF\xFF"), HasSubstr("data: not a serialized SceneData"));
  std::string bytes = WireBytes(MakeRandomTriangles(10, 3));
  bytes.resize(bytes.size() / 2);
  EXPECT_THAT(message(bytes), HasSubstr("data: not a serialized SceneData"));
  v1::SceneData data;
  data.add_materials();
  data.add_meshes()->set_triangle_count(0x80000000u);
  EXPECT_THAT(message(data.SerializeAsString()), HasSubstr("meshes[0].triangles: 0 bytes, 2147483648"));
}

TEST(SceneDecoder, SaysThatItWasCancelled) {
  const std::string bytes = WireBytes(MakeRandomTriangles(10, 3));
  Cancellation gone;
  gone.Cancel();
  EXPECT_EQ(DecodeScene(bytes, &gone).status().code(), absl::StatusCode::kCancelled);
  const Cancellation late(Clock::now());
  EXPECT_EQ(DecodeScene(bytes, &late).status().code(), absl::StatusCode::kDeadlineExceeded);
}

/// All that an upload costs once its bytes are there.
absl::Status Take(const std::string& bytes, const Cancellation* cancellation) {
  const std::string digest = SceneDigest(bytes, cancellation);
  if (!IsSceneDigest(digest)) return absl::InternalError(digest);
  const absl::StatusOr<Scene> scene = DecodeScene(bytes, cancellation);
  if (!scene.ok()) return scene.status();
  if (absl::Status status = Validate(*scene, cancellation); !status.ok()) return status;
  return MaskScene::Create(*scene, cancellation).status();
}

TEST(SceneDecoder, AScenesPreparationStopsWhereverItIs) {
  const std::string bytes = WireBytes(MakeRandomTriangles(300000, 9));
  const Clock::time_point start = Clock::now();
  ASSERT_TRUE(Take(bytes, nullptr).ok());
  const Clock::duration whole = Clock::now() - start;
  std::vector<double> late_milliseconds;
  constexpr int kSteps = 20;
  for (int i = 0; i < kSteps; ++i) {
    const Clock::time_point deadline = Clock::now() + i * whole / kSteps;
    const Cancellation soon(deadline);
    const absl::Status status = Take(bytes, &soon);
    if (status.ok()) continue;  // It was faster this time.
    EXPECT_EQ(status.code(), absl::StatusCode::kDeadlineExceeded) << status;
    late_milliseconds.push_back(std::chrono::duration<double, std::milli>(Clock::now() - deadline).count());
  }
  ASSERT_GE(late_milliseconds.size(), size_t{kSteps / 2});
  std::sort(late_milliseconds.begin(), late_milliseconds.end());
  // Not the worst: another process may have had the processor.
  EXPECT_LT(late_milliseconds[late_milliseconds.size() * 3 / 4], 20.0);
}

}  // namespace
}  // namespace shadowfit
