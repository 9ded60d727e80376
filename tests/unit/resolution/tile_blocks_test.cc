#include "core/resolution/tile_blocks.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include "random.h"

namespace shadowfit::resolution {
namespace {

/// Planes with steps between them, noise, and things that are no samples.
std::vector<float> RandomDepth(Random& random, int width, int height) {
  std::vector<float> pixels(static_cast<size_t>(width) * static_cast<size_t>(height));
  const double base = random.In(0.1, 0.95);
  const double dx = random.In(-1e-4, 1e-4);
  const double dy = random.In(-1e-3, 1e-3);
  const double noise = random.Int(0, 1) == 0 ? 0.0 : std::pow(10.0, random.In(-7.0, -2.0));
  const int step_at = random.Int(0, 2 * width);
  const double step = random.In(-0.1, 0.1);
  const double broken = random.Int(0, 2) == 0 ? 0.01 : 0.0;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      double z = base + dx * x + dy * y + noise * random.In(-1.0, 1.0) + (x > step_at ? step : 0.0);
      if (random.In(0.0, 1.0) < broken) {
        const double kinds[] = {1.0, kNan, kInf, -kInf, -0.5, 1.5};
        z = kinds[random.Int(0, 5)];
      }
      pixels[static_cast<size_t>(y * width + x)] = static_cast<float>(z);
    }
  }
  return pixels;
}

TEST(TileBlocksTest, BoundsHoldForEveryPixel) {
  Random random(3);
  int whole = 0;
  int tight = 0;
  int promises = 0;
  for (int trial = 0; trial < 3000; ++trial) {
    const int width = random.Int(1, trial % 2 == 0 ? 600 : 60);
    const int height = random.Int(1, 30);
    const std::vector<float> pixels = RandomDepth(random, width, height);
    Tile tile;
    tile.depth = random.Int(0, 1) == 0 ? BottomFirst(pixels.data(), width, height)
                                       : TopFirst(pixels.data(), width, height);
    tile.x0 = random.Int(0, (width - 1) / kTileWidth) * kTileWidth;
    tile.y0 = random.Int(0, (height - 1) / kTileHeight) * kTileHeight;
    tile.width = std::min(kTileWidth, width - tile.x0);
    tile.height = std::min(kTileHeight, height - tile.y0);
    tile.highest = std::nextafter(1.0F, 0.0F);
    tile.reference_depth = static_cast<float>(random.In(0.0, 1.0));
    TileBlocks blocks;
    SummarizeTile(tile, &blocks);

    // Any projective map serves that has some of the tile in front.
    TileMap map{};
    for (double* row : {map.x, map.y}) {
      row[0] = random.In(-1e-2, 1e-2);
      row[1] = random.In(-1e-2, 1e-2);
      row[2] = random.In(-30.0, 30.0);
    }
    map.w[0] = random.In(-2e-3, 2e-3);
    map.w[1] = random.In(-2e-3, 2e-3);
    map.w[2] = random.In(-2.0, 2.0);
    map.w[3] = 1.0;
    PatchBounds bounds;
    BoundPatches(tile, blocks, map, &bounds);

    TileDepths<double> depths;
    for (int block = 0; block < kBlocks; ++block) {
      SCOPED_TRACE(testing::Message() << "trial " << trial << " block " << block);
      tile.begin = block * kBlockWidth;
      tile.end = std::min(tile.width, tile.begin + kBlockWidth);
      int samples = 0;
      for (int x = tile.begin; x < tile.end; ++x) {
        for (int y = 0; y < tile.height; ++y) {
          const float z = tile.depth.At(tile.x0 + x, tile.y0 + y);
          samples += z >= tile.lowest && z <= tile.highest ? 1 : 0;
        }
      }
      ASSERT_EQ(blocks.samples[block], samples);
      if (samples == 0) {
        EXPECT_EQ(bounds.smallest[0][block], kInf);
        EXPECT_EQ(bounds.smallest[1][block], kInf);
        continue;
      }
      PrepareTile(tile, &depths);
      TileExtent extent;
      ReduceTile(tile, depths, map, &extent);
      whole += blocks.whole[block] ? 1 : 0;
      if (extent.pixels == 0) continue;
      for (int axis = 0; axis < 2; ++axis) {
        const double rounding = 1e-12 * (1.0 + std::abs(extent.min[axis]) + std::abs(extent.max[axis]));
        EXPECT_LE(bounds.low[axis][block], extent.min[axis] + rounding);
        EXPECT_GE(bounds.high[axis][block], extent.max[axis] - rounding);
        EXPECT_LE(bounds.smallest[axis][block], extent.smallest[axis]);
        if (!(bounds.smallest[axis][block] > 0.0)) continue;
        ++promises;
        tight += bounds.smallest[axis][block] > 0.8 * extent.smallest[axis] ? 1 : 0;
      }
    }
  }
  EXPECT_GT(whole, 1000);
  // Worth having: most bounds are near what they bound.
  EXPECT_GT(promises, 1000);
  EXPECT_GT(tight, promises / 2);
}

}  // namespace
}  // namespace shadowfit::resolution
