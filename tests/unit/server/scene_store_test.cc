#include "server/scene_store.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <thread>

#include "core/scene/procedural.h"

namespace shadowfit {
namespace {

std::string Digest(char c) { return std::string(64, c); }

MaskScene SmallScene() { return *MaskScene::Create(MakeRandomTriangles(10, 1)); }

/// Puts a scene that claims so many bytes.
absl::StatusOr<SceneStore::Handle> Put(SceneStore& store, char name, size_t bytes) {
  absl::StatusOr<SceneStore::Room> room = store.TakeRoom(bytes);
  if (!room.ok()) return room.status();
  return store.Insert(Digest(name), SmallScene(), *std::move(room));
}

TEST(SceneStore, ForgetsWhatWasUsedLongestAgo) {
  SceneStore store(100);
  ASSERT_TRUE(Put(store, 'a', 40).ok());
  ASSERT_TRUE(Put(store, 'b', 40).ok());
  EXPECT_NE(store.Find(Digest('a')), nullptr);  // Now b is older.
  ASSERT_TRUE(Put(store, 'c', 40).ok());
  EXPECT_NE(store.Find(Digest('a')), nullptr);
  EXPECT_EQ(store.Find(Digest('b')), nullptr);
  EXPECT_EQ(store.bytes(), 80u);
  const auto list = store.List();
  ASSERT_EQ(list.size(), 2u);
  EXPECT_EQ(list[0].scene->digest, Digest('a'));
  EXPECT_EQ(list[0].uses, 0);
}

TEST(SceneStore, KeepsWhatIsInUse) {
  SceneStore store(100);
  SceneStore::Handle in_use = *Put(store, 'a', 60);
  const absl::Status busy = Put(store, 'b', 60).status();
  EXPECT_EQ(busy.code(), absl::StatusCode::kUnavailable) << busy;
  EXPECT_TRUE(busy.GetPayload("type.googleapis.com/google.rpc.RetryInfo").has_value());
  EXPECT_EQ(store.List()[0].uses, 1);
  const absl::Status never = Put(store, 'b', 101).status();
  EXPECT_EQ(never.code(), absl::StatusCode::kResourceExhausted) << never;
  in_use.reset();
  EXPECT_TRUE(Put(store, 'b', 60).ok());
  EXPECT_EQ(store.Find(Digest('a')), nullptr);
}

TEST(SceneStore, DeletedScenesLastAsLongAsTheyAreUsed) {
  SceneStore store(100);
  SceneStore::Handle in_use = *Put(store, 'a', 60);
  EXPECT_TRUE(store.Erase(Digest('a')));
  EXPECT_FALSE(store.Erase(Digest('a')));
  EXPECT_EQ(store.Find(Digest('a')), nullptr);
  EXPECT_EQ(in_use->scene.TriangleCount(), SmallScene().TriangleCount());
  EXPECT_EQ(store.bytes(), 60u);  // The memory is still taken.
  in_use.reset();
  EXPECT_EQ(store.bytes(), 0u);
}

TEST(SceneStore, TheFirstOfTwoEqualScenesStays) {
  SceneStore store(100);
  const SceneStore::Handle first = *Put(store, 'a', 40);
  EXPECT_EQ(*Put(store, 'a', 40), first);
  EXPECT_EQ(store.bytes(), 40u);
}

TEST(SceneStore, RoomThatASceneDoesNotNeedIsGivenBack) {
  SceneStore store(100);
  SceneStore::Room room = *store.TakeRoom(90);
  room.ShrinkTo(95);
  EXPECT_EQ(store.bytes(), 90u);
  room.ShrinkTo(30);
  EXPECT_EQ(store.bytes(), 30u);
  ASSERT_TRUE(Put(store, 'a', 70).ok());
  EXPECT_EQ(store.bytes(), 100u);
  room = SceneStore::Room();
  EXPECT_EQ(store.bytes(), 70u);
}

TEST(SceneStore, ManyThreadsMayUseIt) {
  SceneStore store(100);
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&store, t] {
      for (int i = 0; i < 200; ++i) {
        const char name = static_cast<char>('a' + (t + i) % 5);
        SceneStore::Handle scene = store.Find(Digest(name));
        if (scene == nullptr) {
          const auto put = Put(store, name, 30);
          if (put.ok()) scene = *put;
        }
        if (scene != nullptr) {
          EXPECT_EQ(scene->digest, Digest(name));
        }
        if (i % 17 == 0) store.Erase(Digest(name));
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_LE(store.bytes(), 100u);
  for (char name = 'a'; name < 'f'; ++name) store.Erase(Digest(name));
  EXPECT_EQ(store.bytes(), 0u);
}

}  // namespace
}  // namespace shadowfit
