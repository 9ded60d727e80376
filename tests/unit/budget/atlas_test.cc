#include "core/budget/atlas.h"

#include <gtest/gtest.h>

#include <random>

namespace shadowfit {
namespace {

void ExpectDisjoint(const std::vector<MapSize>& maps, const std::vector<AtlasPosition>& positions,
                    MapSize atlas) {
  ASSERT_EQ(maps.size(), positions.size());
  for (size_t i = 0; i < maps.size(); ++i) {
    EXPECT_GE(positions[i].x, 0);
    EXPECT_GE(positions[i].y, 0);
    EXPECT_LE(positions[i].x + maps[i].width, atlas.width);
    EXPECT_LE(positions[i].y + maps[i].height, atlas.height);
    for (size_t j = 0; j < i; ++j) {
      const bool apart = positions[i].x + maps[i].width <= positions[j].x ||
                         positions[j].x + maps[j].width <= positions[i].x ||
                         positions[i].y + maps[i].height <= positions[j].y ||
                         positions[j].y + maps[j].height <= positions[i].y;
      EXPECT_TRUE(apart) << i << " and " << j;
    }
  }
}

TEST(PackAtlas, MapsLieInsideAndDoNotOverlap) {
  std::mt19937 random(1);
  int packed = 0;
  for (int trial = 0; trial < 300; ++trial) {
    std::vector<MapSize> maps(1 + random() % 32);
    double texels = 0.0;
    for (MapSize& map : maps) {
      map = {static_cast<int>(16 + random() % 500), static_cast<int>(16 + random() % 500)};
      texels += map.texels();
    }
    const int side = static_cast<int>(std::sqrt(texels * 1.25)) + 60;
    const MapSize atlas{side, side};
    const auto positions = PackAtlas(maps, atlas);
    if (!positions) continue;
    ++packed;
    ExpectDisjoint(maps, *positions, atlas);
    EXPECT_EQ(positions, PackAtlas(maps, atlas));
  }
  EXPECT_GT(packed, 250);
}

TEST(PackAtlas, FillsAnAtlasWithPowersOfTwo) {
  std::vector<MapSize> maps = {{512, 512}, {512, 512}, {512, 512}};
  for (int i = 0; i < 4; ++i) maps.push_back({256, 256});
  const auto positions = PackAtlas(maps, {1024, 1024});
  ASSERT_TRUE(positions.has_value());
  ExpectDisjoint(maps, *positions, {1024, 1024});
}

TEST(PackAtlas, SaysWhereMapsDoNotFit) {
  const MapSize maps[] = {{100, 10}, {10, 100}};
  EXPECT_FALSE(PackAtlas(maps, {100, 100}).has_value());
  EXPECT_TRUE(PackAtlas(maps, {110, 110}).has_value());
  EXPECT_FALSE(PackAtlas(std::span(maps, 1), {99, 4000}).has_value());
}

}  // namespace
}  // namespace shadowfit
