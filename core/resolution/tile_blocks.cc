#include "core/resolution/tile_blocks.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/resolution/tile_blocks.cc"
// clang-format off: the order matters
#include <hwy/foreach_target.h>
#include <hwy/highway.h>
// clang-format on

#include <hwy/cache_control.h>

#include <algorithm>
#include <cstddef>
#include <limits>

HWY_BEFORE_NAMESPACE();
namespace shadowfit::resolution {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Sums of two depths of at most 1 are rounded by 2^-24, and a rise is a quarter of what two of them and two
// smaller roundings make. Depths that continue the picture are rounded, too.
constexpr float kRiseRounding = 0x1p-23F;
constexpr float kContinuedRounding = 0x1p-21F;

class BlockSummarizer {
  using D = hn::ScalableTag<float>;
  using V = hn::Vec<D>;

 public:
  BlockSummarizer(const Tile& tile, TileBlocks* blocks)
      : tile_(tile), lanes_(static_cast<int>(hn::Lanes(d_))), blocks_(*blocks) {}

  void Summarize(int block) {
    blocks_.samples[block] = 0;
    blocks_.whole[block] = false;
    blocks_.least[block] = 2.0F;
    blocks_.most[block] = -1.0F;
    const int x0 = tile_.x0 + block * kBlockWidth;
    const int width = std::min(kBlockWidth, tile_.x0 + tile_.width - x0);
    if (width <= 0) return;
    const DepthView& depth = tile_.depth;
    const bool at_border =
        x0 == 0 || x0 + width == depth.width || tile_.y0 == 0 || tile_.y0 + tile_.height == depth.height;
    if (width >= lanes_) {
      bool done = false;
      if (!at_border) {
        if (x0 + 3 * kBlockWidth <= depth.width) Prefetch(x0 + 2 * kBlockWidth);
        done = SumUp(depth.Row(tile_.y0 - 1) + x0 - 1, depth.row_stride, width, block);
      } else if (depth.width > 1 && depth.height > 1) {
        Extend(x0, width);
        done = SumUp(extended_, kStride, width, block);
      }
      if (done) {
        if (blocks_.whole[block] && at_border) {
          blocks_.least[block] -= kContinuedRounding;
          blocks_.most[block] += kContinuedRounding;
          for (int diagonal = 0; diagonal < 2; ++diagonal) {
            blocks_.least_rise[diagonal][block] -= kContinuedRounding;
            blocks_.most_rise[diagonal][block] += kContinuedRounding;
          }
        }
        return;
      }
    }
    CountSamples(x0, width, block);
    const float range = blocks_.most[block] - blocks_.least[block];
    if (at_border && range >= 0.0F) {
      // Corners average extrapolated depths there: beyond the extremes by up to one and a half times the
      // range.
      blocks_.least[block] = std::max(0.0F, blocks_.least[block] - 1.5F * range - kContinuedRounding);
      blocks_.most[block] = std::min(1.0F, blocks_.most[block] + 1.5F * range + kContinuedRounding);
    }
  }

 private:
  // A block yet to come: so many rows side by side are more than the machine sees coming.
  void Prefetch(int x0) const {
    constexpr int kLine = 16;
    for (int j = -1; j <= tile_.height; ++j) {
      const float* row = tile_.depth.Row(tile_.y0 + j) + x0;
      for (int i = 0; i < kBlockWidth; i += kLine) hwy::Prefetch(row + i);
    }
  }

  // `from` is the pixel below and left of the block. True where the block is whole, or is nothing but
  // background; all is said then.
  bool SumUp(const float* from, std::ptrdiff_t stride, int width, int block) {
    V least = hn::Set(d_, 2.0F), most = hn::Set(d_, -1.0F);
    V least_up = hn::Set(d_, 2.0F), most_up = hn::Set(d_, -2.0F);
    V least_down = least_up, most_down = most_up;
    V checked = hn::Zero(d_);
    for (int i = 0; i < width; i += lanes_) {
      // The last vector may overlap the one before: extremes do not mind.
      const float* at = from + std::min(i, width - lanes_);
      // A pixel's corners are means of four depths. Of the nine around pixel (i, j), four times the rise from
      // its lower left corner to its upper right one is
      //   z(i,j+1) + z(i+1,j+1) + z(i+1,j) - z(i-1,j) - z(i-1,j-1) - z(i,j-1),
      // and from upper left to lower right the same with j+1 and j-1 exchanged. Rows share sums of
      // neighbours.
      V left_below, right_below, left_here, right_here, across_here;
      const auto read = [&](V* left_sum, V* right_sum, V* across) HWY_ATTR {
        const V left = hn::LoadU(d_, at), middle = hn::LoadU(d_, at + 1), right = hn::LoadU(d_, at + 2);
        at += stride;
        least = hn::Min(least, hn::Min(left, right));
        most = hn::Max(most, hn::Max(left, right));
        *left_sum = hn::Add(left, middle);
        *right_sum = hn::Add(middle, right);
        *across = hn::Sub(right, left);
      };
      read(&left_below, &right_below, &across_here);
      read(&left_here, &right_here, &across_here);
      for (int j = 0; j < tile_.height; ++j) {
        V left_above, right_above, across_above;
        read(&left_above, &right_above, &across_above);
        const V up = hn::Add(hn::Sub(right_above, left_below), across_here);
        const V down = hn::Add(hn::Sub(right_below, left_above), across_here);
        least_up = hn::Min(least_up, up);
        most_up = hn::Max(most_up, up);
        least_down = hn::Min(least_down, down);
        most_down = hn::Max(most_down, down);
        checked = hn::Add(checked, hn::Add(up, down));
        left_below = left_here;
        right_below = right_here;
        left_here = left_above;
        right_here = right_above;
        across_here = across_above;
      }
    }
    // Extremes pass over NaN; sums do not, nor over infinities.
    if (!hn::AllTrue(d_, hn::Eq(hn::Sub(checked, checked), hn::Zero(d_)))) return false;
    const float lowest = Least(least);
    const float highest = Most(most);
    if (lowest > tile_.highest || highest < tile_.lowest) return true;
    if (lowest < tile_.lowest || highest > tile_.highest) return false;
    blocks_.whole[block] = true;
    blocks_.samples[block] = width * tile_.height;
    blocks_.least[block] = lowest;
    blocks_.most[block] = highest;
    blocks_.least_rise[0][block] = 0.25F * Least(least_up) - kRiseRounding;
    blocks_.most_rise[0][block] = 0.25F * Most(most_up) + kRiseRounding;
    blocks_.least_rise[1][block] = 0.25F * Least(least_down) - kRiseRounding;
    blocks_.most_rise[1][block] = 0.25F * Most(most_down) + kRiseRounding;
    return true;
  }

  float Least(V v) const { return hn::GetLane(hn::MinOfLanes(d_, v)); }
  float Most(V v) const { return hn::GetLane(hn::MaxOfLanes(d_, v)); }

  // The block with one more pixel on every side, as TileDepths continues the picture.
  void Extend(int x0, int width) {
    const DepthView& depth = tile_.depth;
    const int first = x0 > 0 ? -1 : 0;
    const int last = x0 + width < depth.width ? width : width - 1;
    const int bottom = tile_.y0 > 0 ? -1 : 0;
    const int top = tile_.y0 + tile_.height < depth.height ? tile_.height : tile_.height - 1;
    const auto row = [&](int j) { return extended_ + (j + 1) * kStride + 1; };
    const auto for_vectors = [&](int begin, int end, const auto& function) HWY_ATTR {
      for (int i = begin; i < end; i += lanes_) function(std::min(i, end - lanes_));
    };
    // Where one of the two is no sample, the block is not whole whatever this says.
    const auto beyond = [](float near, float next) { return std::clamp(2.0F * near - next, 0.0F, 1.0F); };
    for (int j = bottom; j <= top; ++j) {
      const float* from = depth.Row(tile_.y0 + j) + x0;
      float* to = row(j);
      for_vectors(first, last + 1, [&](int i) HWY_ATTR { hn::StoreU(hn::LoadU(d_, from + i), d_, to + i); });
      if (first == 0) to[-1] = beyond(to[0], from[1]);
      if (last < width) to[width] = beyond(to[last], from[last - 1]);
    }
    const V zero = hn::Zero(d_), one = hn::Set(d_, 1.0F);
    const auto extend_row = [&](int j, int near_row, int next_row) HWY_ATTR {
      const float *near = row(near_row), *next = row(next_row);
      float* to = row(j);
      for_vectors(-1, width + 1, [&](int i) HWY_ATTR {
        const V at = hn::LoadU(d_, near + i);
        const V z = hn::Sub(hn::Add(at, at), hn::LoadU(d_, next + i));
        hn::StoreU(hn::Min(hn::Max(z, zero), one), d_, to + i);
      });
    };
    if (bottom == 0) extend_row(-1, 0, 1);
    if (top < tile_.height) extend_row(tile_.height, top, top - 1);
  }

  // One by one.
  void CountSamples(int x0, int width, int block) {
    const DepthView& depth = tile_.depth;
    const int first = std::max(0, x0 - 1);
    const int last = std::min(depth.width - 1, x0 + width);
    for (int y = std::max(0, tile_.y0 - 1); y <= std::min(depth.height - 1, tile_.y0 + tile_.height); ++y) {
      const bool own_row = y >= tile_.y0 && y < tile_.y0 + tile_.height;
      const float* from = depth.Row(y);
      for (int x = first; x <= last; ++x) {
        if (!(from[x] >= tile_.lowest && from[x] <= tile_.highest)) continue;
        blocks_.least[block] = std::min(blocks_.least[block], from[x]);
        blocks_.most[block] = std::max(blocks_.most[block], from[x]);
        if (own_row && x >= x0 && x < x0 + width) ++blocks_.samples[block];
      }
    }
  }

  // Room for whole vectors is not needed: the last one overlaps the one before.
  static constexpr int kStride = kBlockWidth + 2;

  const D d_;
  const Tile& tile_;
  const int lanes_;
  TileBlocks& blocks_;
  float extended_[(kTileHeight + 2) * kStride];
};

void SummarizeBlocks(const Tile& tile, TileBlocks* blocks) {
  BlockSummarizer summarizer(tile, blocks);
  for (int block = 0; block < kBlocks; ++block) summarizer.Summarize(block);
}

// The distance, along one axis of the picture, between the projections of two opposite corners of a pixel is
// a lower bound of its box. With homogeneous coordinates x and w, affine in (lx, ly, lz), that step by dx and
// dw from the first corner to the second, and X = x/w of the first,
//
//   (x + dx) / (w + dw) - X = (dx - X dw) / (w + dw)
//
// and dx - X dw = x0 + s x1 - X (w0 + s w1) + (x2 - X w2) rise for a step of (1, s, rise). It is linear in X
// and in the rise: over intervals of both, extremes are at the ends. On a plane the longer of the two
// diagonals is as long as the box.
class PatchBounder {
  using D = hn::CappedTag<double, kBlocks>;
  using V = hn::Vec<D>;

 public:
  PatchBounder(const Tile& tile, const TileBlocks& blocks, const TileMap& map, PatchBounds* bounds) {
    HWY_ALIGN double middle_z[kBlocks];
    HWY_ALIGN double half_z[kBlocks];
    HWY_ALIGN double centre_x[kBlocks];
    HWY_ALIGN double rises[2][2][kBlocks];  // [diagonal][least, most]
    HWY_ALIGN double ceiling[kBlocks];      // Of what may be promised.
    for (int block = 0; block < kBlocks; ++block) {
      const bool whole = blocks.whole[block];
      const bool empty = blocks.samples[block] == 0;
      const double least = double{blocks.least[block]} - tile.reference_depth;
      const double most = double{blocks.most[block]} - tile.reference_depth;
      middle_z[block] = empty ? 0.0 : 0.5 * (least + most);
      half_z[block] = empty ? 0.0 : 0.5 * (most - least);
      const int width = std::min(kBlockWidth, tile.width - block * kBlockWidth);
      centre_x[block] = block * kBlockWidth + 0.5 * width - 0.5 * tile.width;
      for (int diagonal = 0; diagonal < 2; ++diagonal) {
        rises[diagonal][0][block] = whole ? blocks.least_rise[diagonal][block] : 0.0;
        rises[diagonal][1][block] = whole ? blocks.most_rise[diagonal][block] : 0.0;
      }
      ceiling[block] = whole ? std::numeric_limits<double>::infinity() : 0.0;
    }
    const double half_x = 0.5 * std::min(kBlockWidth, tile.width);
    const double half_y = 0.5 * tile.height;
    const double* const rows[2] = {map.x, map.y};
    const V zero = hn::Zero(d_);
    for (int block = 0; block < kBlocks; block += static_cast<int>(hn::Lanes(d_))) {
      const V z = hn::Load(d_, middle_z + block), z_half = hn::Load(d_, half_z + block);
      const V lx = hn::Load(d_, centre_x + block);
      const auto middle = [&](const double* row) HWY_ATTR {
        return hn::MulAdd(Set(row[0]), lx, hn::MulAdd(Set(row[2]), z, Set(row[3])));
      };
      const auto half = [&](const double* row) HWY_ATTR {
        return hn::MulAdd(Set(std::abs(row[2])), z_half,
                          Set(std::abs(row[0]) * half_x + std::abs(row[1]) * half_y));
      };
      const V w_middle = middle(map.w), w_half = half(map.w);
      const V least_w = hn::Sub(w_middle, w_half), most_w = hn::Add(w_middle, w_half);
      const V one = Set(1.0);
      const V by_least_w = hn::Div(one, least_w), by_most_w = hn::Div(one, most_w);
      const auto before_light = hn::Gt(least_w, zero);
      const V promise = hn::IfThenElseZero(before_light, hn::Load(d_, ceiling + block));
      const V infinity = Set(std::numeric_limits<double>::infinity());
      for (int axis = 0; axis < 2; ++axis) {
        const double* row = rows[axis];
        const V x_middle = middle(row), x_half = half(row);
        const V x_low = hn::Sub(x_middle, x_half), x_high = hn::Add(x_middle, x_half);
        const V low = hn::Min(hn::Mul(x_low, by_least_w), hn::Mul(x_low, by_most_w));
        const V high = hn::Max(hn::Mul(x_high, by_least_w), hn::Mul(x_high, by_most_w));
        hn::Store(hn::IfThenElse(before_light, low, hn::Neg(infinity)), d_, bounds->low[axis] + block);
        hn::Store(hn::IfThenElse(before_light, high, infinity), d_, bounds->high[axis] + block);
        V longest = zero;
        for (int diagonal = 0; diagonal < 2; ++diagonal) {
          const double s = diagonal == 0 ? 1.0 : -1.0;
          const V rise_low = hn::Load(d_, rises[diagonal][0] + block);
          const V rise_high = hn::Load(d_, rises[diagonal][1] + block);
          V least = infinity;
          V most = hn::Neg(infinity);
          V size = zero;
          for (const V at : {low, high}) {
            const V flat = hn::NegMulAdd(at, Set(map.w[0] + s * map.w[1]), Set(row[0] + s * row[1]));
            const V per_rise = hn::NegMulAdd(at, Set(map.w[2]), Set(row[2]));
            for (const V rise : {rise_low, rise_high}) {
              const V step = hn::MulAdd(per_rise, rise, flat);
              least = hn::Min(least, step);
              most = hn::Max(most, step);
            }
            const V at_size = hn::Abs(at);
            size = hn::Max(
                size, hn::MulAdd(at_size, Set(std::abs(map.w[0]) + std::abs(map.w[1]) + std::abs(map.w[2])),
                                 Set(std::abs(row[0]) + std::abs(row[1]) + std::abs(row[2]))));
          }
          // Roundings are of 2^-53 of the terms' sizes each.
          const V shortest = hn::NegMulAdd(size, Set(1e-14), hn::Max(least, hn::Neg(most)));
          longest = hn::Max(longest, shortest);
        }
        const V bound = hn::Mul(hn::Mul(longest, by_most_w), Set(1.0 - 1e-12));
        hn::Store(hn::Min(bound, promise), d_, bounds->smallest[axis] + block);
      }
    }
    for (int block = 0; block < kBlocks; ++block) {
      if (blocks.samples[block] > 0) continue;
      bounds->smallest[0][block] = bounds->smallest[1][block] = std::numeric_limits<double>::infinity();
    }
  }

 private:
  V Set(double value) const { return hn::Set(d_, value); }

  const D d_;
};

void BoundBlocks(const Tile& tile, const TileBlocks& blocks, const TileMap& map, PatchBounds* bounds) {
  PatchBounder(tile, blocks, map, bounds);
}

}  // namespace HWY_NAMESPACE
}  // namespace shadowfit::resolution
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit::resolution {

HWY_EXPORT(SummarizeBlocks);
HWY_EXPORT(BoundBlocks);

void SummarizeTile(const Tile& tile, TileBlocks* blocks) {
  HWY_DYNAMIC_DISPATCH(SummarizeBlocks)(tile, blocks);
}
void BoundPatches(const Tile& tile, const TileBlocks& blocks, const TileMap& map, PatchBounds* bounds) {
  HWY_DYNAMIC_DISPATCH(BoundBlocks)(tile, blocks, map, bounds);
}

}  // namespace shadowfit::resolution
#endif
