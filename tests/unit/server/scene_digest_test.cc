#include "server/scene_digest.h"

#include <gtest/gtest.h>

namespace shadowfit {
namespace {

TEST(SceneDigest, IsSha256) {
  EXPECT_EQ(SceneDigest("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
  EXPECT_EQ(SceneDigest(std::string(1000000, 'a')),  // The standard's longest example.
            "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
}

TEST(SceneDigest, OfSeveralPiecesIsThatOfTheWhole) {
  const std::string data(3000000, 'a');
  const Cancellation never;
  EXPECT_EQ(SceneDigest(data, &never), "2a152c894398719c0570f83fac34ac03a0f6e8e474b995c2403aa5434f7b9dd4");
}

TEST(SceneDigest, HasSixtyFourLowerCaseDigits) {
  EXPECT_TRUE(IsSceneDigest(SceneDigest("")));
  EXPECT_FALSE(IsSceneDigest(""));
  EXPECT_FALSE(IsSceneDigest(std::string(64, 'A')));
  EXPECT_FALSE(IsSceneDigest(std::string(65, 'a')));
}

TEST(SceneDigest, IsNotFinishedOnceCancelled) {
  Cancellation gone;
  gone.Cancel();
  EXPECT_EQ(SceneDigest("abc", &gone), SceneDigest(""));
}

}  // namespace
}  // namespace shadowfit
