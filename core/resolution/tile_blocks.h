#pragma once

#include <cstdint>

#include "core/resolution/tile_kernel.h"

/// What the pixels of a tile's blocks have in common, found once for all maps, and what follows from it for
/// one map without looking at a pixel again.
namespace shadowfit::resolution {

/// A tile is a row of blocks. The pixels of narrow ones have much in common.
inline constexpr int kBlockWidth = 32;
static_assert(kBlockWidth % kColumnStep == 0);
inline constexpr int kBlocks = kTileWidth / kBlockWidth;

struct TileBlocks {
  /// Samples among the block's own pixels.
  int samples[kBlocks];
  /// The block, one pixel around it, and what continues it beyond the picture's border are samples
  /// throughout.
  bool whole[kBlocks];
  /// Bounds of the window depth of samples and of the corners of their pixels; least > most without any.
  float least[kBlocks];
  float most[kBlocks];
  /// Bounds of how much corner depth grows over a pixel, from lower left to upper right [0], and from upper
  /// left to lower right [1]. Where the block is whole.
  float least_rise[2][kBlocks];
  float most_rise[2][kBlocks];
};

/// Blocks beyond the tile's width have no samples.
void SummarizeTile(const Tile& tile, TileBlocks* blocks);

/// Bounds for every pixel's box in a block, along x [0] and y [1] of the picture; [0, infinity) about where
/// nothing is known.
struct PatchBounds {
  alignas(64) double smallest[2][kBlocks];  ///< Of width and height from below. Infinity without a sample.
  alignas(64) double low[2][kBlocks];       ///< Of where they lie, relative to the tile's reference point.
  alignas(64) double high[2][kBlocks];
};

void BoundPatches(const Tile& tile, const TileBlocks& blocks, const TileMap& map, PatchBounds* bounds);

}  // namespace shadowfit::resolution
