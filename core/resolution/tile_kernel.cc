#include "core/resolution/tile_kernel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/resolution/tile_kernel.cc"
// clang-format off: the order matters
#include <hwy/foreach_target.h>
#include <hwy/highway.h>
// clang-format on

#include <algorithm>
#include <bit>
#include <cstddef>
#include <limits>

HWY_BEFORE_NAMESPACE();
namespace shadowfit::resolution {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

constexpr int kStride = kTileStride;

template <class D>
HWY_INLINE hn::Vec<D> LoadDepth(D d, const float* from) {
  if constexpr (sizeof(hn::TFromD<D>) == sizeof(float)) {
    return hn::LoadU(d, from);
  } else {
    const hn::Rebind<float, D> d_float;
    return hn::PromoteTo(d, hn::LoadU(d_float, from));
  }
}

// The local depth of a tile, in the arithmetic of D.
template <class D>
class TilePreparer {
  using T = hn::TFromD<D>;
  using V = hn::Vec<D>;
  static constexpr T kNotASample = std::numeric_limits<T>::quiet_NaN();

 public:
  TilePreparer(const Tile& tile, TileDepths<T>* depths)
      : tile_(tile), lanes_(static_cast<int>(hn::Lanes(d_))), depths_(*depths) {
    LoadPixels();
    MakeCorners();
  }

 private:
  // Local depth of the tile's pixels and of one more on each side; NaN where there is no sample. Pixel (i, j)
  // of the tile is at row j + 1, column i + 1.
  T* PixelRow(int j) { return depths_.pixels + (j + 1) * kStride; }

  void LoadPixels() {
    const DepthView& depth = tile_.depth;
    const T reference = tile_.reference_depth;
    const V reference_v = hn::Set(d_, reference);
    const V lowest = hn::Set(d_, T{tile_.lowest});
    const V highest = hn::Set(d_, T{tile_.highest});
    const V nan = hn::Set(d_, kNotASample);
    const int first = tile_.x0 + tile_.begin > 0 ? tile_.begin - 1 : tile_.begin;
    const int last = tile_.x0 + tile_.end < depth.width ? tile_.end : tile_.end - 1;
    const int bottom = tile_.y0 > 0 ? -1 : 0;
    const int top = tile_.y0 + tile_.height < depth.height ? tile_.height : tile_.height - 1;
    for (int j = bottom; j <= top; ++j) {
      const float* from = depth.Row(tile_.y0 + j) + tile_.x0;
      T* row = PixelRow(j) + 1;
      // What whole vectors of corners read beyond the last.
      for (int i = tile_.end; i <= tile_.end + lanes_; i += lanes_) {
        hn::StoreU(nan, d_, row + std::min(i, kStride - 1 - lanes_));
      }
      if (last + 1 - first >= lanes_) {
        for (int i = first; i <= last; i += lanes_) {
          const int at = std::min(i, last + 1 - lanes_);  // The last vector may overlap the one before.
          const V z = LoadDepth(d_, from + at);
          const auto sample = hn::And(hn::Ge(z, lowest), hn::Le(z, highest));
          hn::StoreU(hn::IfThenElse(sample, hn::Sub(z, reference_v), nan), d_, row + at);
        }
      } else {
        for (int i = first; i <= last; ++i) {
          const bool sample = from[i] >= tile_.lowest && from[i] <= tile_.highest;
          row[i] = sample ? static_cast<T>(from[i]) - reference : kNotASample;
        }
      }
      if (first == tile_.begin) {
        row[first - 1] = depth.width > 1 ? Extrapolate(row[first], row[first + 1]) : kNotASample;
      }
      if (last < tile_.end) {
        row[tile_.end] = depth.width > 1 ? Extrapolate(row[last], row[last - 1]) : kNotASample;
      }
    }
    if (bottom == 0) ExtrapolateRow(-1, 0, 1);
    if (top < tile_.height) ExtrapolateRow(tile_.height, top, top - 1);
  }

  // The pixel beyond the border that continues the line through two inside; depth stays in [0,1]. NaN where
  // one of them is no sample.
  T Extrapolate(T near, T next) const {
    const T reference = tile_.reference_depth;
    const T z = T{2} * near - next;
    return z < T{0} - reference ? T{0} - reference : z > T{1} - reference ? T{1} - reference : z;
  }
  void ExtrapolateRow(int row, int near, int next) {
    const bool possible = tile_.depth.height > 1;
    for (int i = tile_.begin; i <= tile_.end + 1; ++i) {
      PixelRow(row)[i] = possible ? Extrapolate(PixelRow(near)[i], PixelRow(next)[i]) : kNotASample;
    }
  }

  T* CornerRow(int j) { return depths_.corners + j * kStride; }

  void MakeCorners() {
    const V quarter = hn::Set(d_, T{0.25});
    for (int j = 0; j <= tile_.height; ++j) {
      const T* below = PixelRow(j - 1);
      const T* above = PixelRow(j);
      for (int i = tile_.begin; i <= tile_.end; i += lanes_) {
        const V z00 = hn::LoadU(d_, below + i), z10 = hn::LoadU(d_, below + i + 1);
        const V z01 = hn::LoadU(d_, above + i), z11 = hn::LoadU(d_, above + i + 1);
        const V sum = hn::Add(hn::Add(z00, z10), hn::Add(z01, z11));
        V mean = hn::Mul(sum, quarter);
        if (!hn::AllTrue(d_, hn::Eq(sum, sum))) {
          // Corners with no sample around them get a value that no pixel uses.
          const V partial = hn::Add(hn::Add(SampleOrZero(z00), SampleOrZero(z10)),
                                    hn::Add(SampleOrZero(z01), SampleOrZero(z11)));
          const V count = hn::Add(hn::Add(OneIfSample(z00), OneIfSample(z10)),
                                  hn::Add(OneIfSample(z01), OneIfSample(z11)));
          mean = hn::IfThenElse(hn::Eq(sum, sum), mean, hn::Div(partial, hn::Max(count, hn::Set(d_, T{1}))));
        }
        hn::StoreU(mean, d_, CornerRow(j) + i);
      }
    }
  }

  HWY_INLINE V SampleOrZero(V z) const { return hn::IfThenElseZero(hn::Eq(z, z), z); }
  HWY_INLINE V OneIfSample(V z) const { return hn::IfThenElseZero(hn::Eq(z, z), hn::Set(d_, T{1})); }

  const D d_;
  const Tile& tile_;
  const int lanes_;
  TileDepths<T>& depths_;
};

// One tile in local coordinates, reduced in the arithmetic of D.
template <class D>
class TileReducer {
  using T = hn::TFromD<D>;
  using V = hn::Vec<D>;
  static constexpr bool kExact = sizeof(T) == sizeof(double);
  static constexpr T kInfinity = std::numeric_limits<T>::infinity();

 public:
  TileReducer(const Tile& tile, const TileDepths<T>& depths)
      : tile_(tile), depths_(depths), lanes_(static_cast<int>(hn::Lanes(d_))) {}

  void Reduce(const TileMap& map, TileExtent* extent) {
    if (map.in_cone && map.in_square) return Reduce<true, true>(map, extent);
    if (map.in_cone) return Reduce<true, false>(map, extent);
    if (map.in_square) return Reduce<false, true>(map, extent);
    Reduce<false, false>(map, extent);
  }

 private:
  HWY_INLINE V Set(double value) const { return hn::Set(d_, static_cast<T>(value)); }
  // 1 / w. Division is what float tiles would spend most of their time on; an estimate and one step of
  // Newton's method are wrong by at most 4.25 units of 2^-24, relative.
  HWY_INLINE V Reciprocal(V w) const {
#if HWY_ARCH_X86
    if constexpr (!kExact) {
      const V estimate = hn::ApproximateReciprocal(w);
      return hn::Mul(estimate, hn::NegMulAdd(w, estimate, hn::Set(d_, T{2})));
    }
#endif
    return hn::Div(hn::Set(d_, T{1}), w);
  }
  // The part of a row (c0, c1, c2, c3) that a row of pixels shares.
  HWY_INLINE V Shared(const double* row, double ly) const { return Set(row[1] * ly + row[3]); }

  // In float, a tile that lies wholly inside the light's volume needs its boxes alone: the caller knows where
  // it lies.
  template <bool kCone, bool kSquare, bool kBoxesOnly = !kExact && !kCone && !kSquare>
  void Reduce(const TileMap& map, TileExtent* extent) {
    const V xl = Set(map.x[0]), xz = Set(map.x[2]);
    const V yl = Set(map.y[0]), yz = Set(map.y[2]);
    const V wl = Set(map.w[0]), wz = Set(map.w[2]);
    const V al = Set(map.along[0]), az = Set(map.along[2]);
    const V square_low_x = Set(map.square_low[0]), square_low_y = Set(map.square_low[1]);
    const V square_high_x = Set(map.square_high[0]), square_high_y = Set(map.square_high[1]);
    const V cone_xx = Set(map.cone[0]), cone_xy = Set(map.cone[1]), cone_yy = Set(map.cone[2]);
    const V cone_xw = Set(map.cone[3]), cone_yw = Set(map.cone[4]), cone_ww = Set(map.cone[5]);
    const V axis_x = Set(map.cone_axis[0]), axis_y = Set(map.cone_axis[1]), axis_w = Set(map.cone_axis[2]);
    const V infinity = hn::Set(d_, kInfinity);
    const V zero = hn::Zero(d_);
    const double centre_x = 0.5 * tile_.width;
    const double centre_y = 0.5 * tile_.height;
    const V first_corner = hn::Add(hn::Iota(d_, T{0}), Set(tile_.begin - centre_x));
    const V first_pixel = hn::Add(hn::Iota(d_, T{0}), Set(tile_.begin + 0.5 - centre_x));
    const V step = Set(lanes_);

    V min_x = infinity, min_y = infinity, max_x = hn::Neg(infinity), max_y = hn::Neg(infinity);
    V smallest_x = infinity, smallest_y = infinity;
    V least_along = infinity, most_along = hn::Neg(infinity);
    int64_t pixels = 0;

    for (int j = 0; j <= tile_.height; ++j) {
      // 1. This row of corners, projected.
      T* corner_x = corner_x_[j & 1];
      T* corner_y = corner_y_[j & 1];
      {
        const V x_row = Shared(map.x, j - centre_y);
        const V y_row = Shared(map.y, j - centre_y);
        const V w_row = Shared(map.w, j - centre_y);
        const T* z_row = depths_.corners + j * kStride;
        V lx = first_corner;
        for (int i = tile_.begin; i <= tile_.end; i += lanes_, lx = hn::Add(lx, step)) {
          const V z = hn::Load(d_, z_row + i);
          const V w = hn::MulAdd(wz, z, hn::MulAdd(wl, lx, w_row));
          const V x = hn::MulAdd(xz, z, hn::MulAdd(xl, lx, x_row));
          const V y = hn::MulAdd(yz, z, hn::MulAdd(yl, lx, y_row));
          const V inverse = Reciprocal(w);
          // A corner behind the light makes the pixel's box infinite, which is how the pixel drops out.
          hn::Store(hn::IfThenElse(hn::Gt(w, zero), hn::Mul(x, inverse), infinity), d_, corner_x + i);
          hn::Store(hn::Mul(y, inverse), d_, corner_y + i);
        }
      }
      if (j == 0) continue;

      // 2. The row of pixels between the last two rows of corners.
      const T* below_x = corner_x_[(j & 1) ^ 1];
      const T* below_y = corner_y_[(j & 1) ^ 1];
      [[maybe_unused]] const V x_row = Shared(map.x, j - 0.5 - centre_y);
      [[maybe_unused]] const V y_row = Shared(map.y, j - 0.5 - centre_y);
      [[maybe_unused]] const V w_row = Shared(map.w, j - 0.5 - centre_y);
      [[maybe_unused]] const V a_row = Shared(map.along, j - 0.5 - centre_y);
      const T* z_row = depths_.pixels + j * kStride + 1;
      V lx = first_pixel;
      for (int i = tile_.begin; i < tile_.end; i += lanes_, lx = hn::Add(lx, step)) {
        const V x00 = hn::Load(d_, below_x + i), x10 = hn::LoadU(d_, below_x + i + 1);
        const V x01 = hn::Load(d_, corner_x + i), x11 = hn::LoadU(d_, corner_x + i + 1);
        const V y00 = hn::Load(d_, below_y + i), y10 = hn::LoadU(d_, below_y + i + 1);
        const V y01 = hn::Load(d_, corner_y + i), y11 = hn::LoadU(d_, corner_y + i + 1);
        const V low_x = hn::Min(hn::Min(x00, x10), hn::Min(x01, x11));
        const V high_x = hn::Max(hn::Max(x00, x10), hn::Max(x01, x11));
        const V low_y = hn::Min(hn::Min(y00, y10), hn::Min(y01, y11));
        const V high_y = hn::Max(hn::Max(y00, y10), hn::Max(y01, y11));
        const V width = hn::Sub(high_x, low_x);
        const V height = hn::Sub(high_y, low_y);

        const V z = hn::LoadU(d_, z_row + i);
        auto takes_part = hn::And(hn::Lt(width, infinity), hn::Eq(z, z));
        V x = zero, y = zero, along = zero;
        if constexpr (!kBoxesOnly) {
          const V w = hn::MulAdd(wz, z, hn::MulAdd(wl, lx, w_row));
          const V inverse = Reciprocal(w);
          x = hn::Mul(hn::MulAdd(xz, z, hn::MulAdd(xl, lx, x_row)), inverse);
          y = hn::Mul(hn::MulAdd(yz, z, hn::MulAdd(yl, lx, y_row)), inverse);
          takes_part = hn::And(takes_part, hn::Gt(w, zero));
          if constexpr (kExact) along = hn::Mul(hn::MulAdd(az, z, hn::MulAdd(al, lx, a_row)), inverse);
        }
        if constexpr (kSquare) {
          takes_part = hn::And(takes_part, hn::And(hn::Ge(x, square_low_x), hn::Le(x, square_high_x)));
          takes_part = hn::And(takes_part, hn::And(hn::Ge(y, square_low_y), hn::Le(y, square_high_y)));
        }
        if constexpr (kCone) {
          const V along_x = hn::MulAdd(cone_xx, x, hn::MulAdd(cone_xy, y, cone_xw));
          const V along_y = hn::MulAdd(cone_yy, y, cone_yw);
          const V form = hn::MulAdd(x, along_x, hn::MulAdd(y, along_y, cone_ww));
          takes_part = hn::And(takes_part, hn::Ge(form, zero));
          if constexpr (kExact) {
            const V along_axis = hn::MulAdd(axis_x, x, hn::MulAdd(axis_y, y, axis_w));
            takes_part = hn::And(takes_part, hn::Gt(along_axis, zero));
          }
        }
        if (HWY_UNLIKELY(i + lanes_ > tile_.end)) {
          takes_part = hn::And(takes_part, hn::FirstN(d_, static_cast<size_t>(tile_.end - i)));
        }

        smallest_x = hn::Min(smallest_x, hn::IfThenElse(takes_part, width, infinity));
        smallest_y = hn::Min(smallest_y, hn::IfThenElse(takes_part, height, infinity));
        if constexpr (!kBoxesOnly) {
          // A pixel that stands out from its neighbours may lie outside its own corners.
          min_x = hn::IfThenElse(takes_part, hn::Min(min_x, hn::Min(low_x, x)), min_x);
          min_y = hn::IfThenElse(takes_part, hn::Min(min_y, hn::Min(low_y, y)), min_y);
          max_x = hn::IfThenElse(takes_part, hn::Max(max_x, hn::Max(high_x, x)), max_x);
          max_y = hn::IfThenElse(takes_part, hn::Max(max_y, hn::Max(high_y, y)), max_y);
        }
        if constexpr (kExact) {
          least_along = hn::Min(least_along, hn::IfThenElse(takes_part, along, infinity));
          most_along = hn::Max(most_along, hn::IfThenElse(takes_part, along, hn::Neg(infinity)));
        }
        pixels += static_cast<int64_t>(hn::CountTrue(d_, takes_part));
        if (HWY_UNLIKELY(map.histogram_x != nullptr)) {
          CountBoxes(hn::IfThenElse(takes_part, width, infinity), map.histogram_x);
          CountBoxes(hn::IfThenElse(takes_part, height, infinity), map.histogram_y);
        }
      }
    }
    extent->min[0] = Least(min_x);
    extent->min[1] = Least(min_y);
    extent->max[0] = -Least(hn::Neg(max_x));
    extent->max[1] = -Least(hn::Neg(max_y));
    extent->smallest[0] = Least(smallest_x);
    extent->smallest[1] = Least(smallest_y);
    extent->least_along = Least(least_along);
    extent->most_along = -Least(hn::Neg(most_along));
    extent->pixels = pixels;
  }

  HWY_INLINE double Least(V v) const { return hn::GetLane(hn::MinOfLanes(d_, v)); }

  void CountBoxes(V sizes, uint32_t* histogram) const {
    HWY_ALIGN T buffer[HWY_MAX_BYTES / sizeof(T)] = {};
    hn::Store(sizes, d_, buffer);
    for (int k = 0; k < lanes_; ++k) {
      if (buffer[k] < kInfinity) {
        ++histogram[std::bit_cast<uint32_t>(static_cast<float>(buffer[k])) >> kHistogramShift];
      }
    }
  }

  const D d_;
  const Tile& tile_;
  const TileDepths<T>& depths_;
  const int lanes_;
  HWY_ALIGN T corner_x_[2][kStride];
  HWY_ALIGN T corner_y_[2][kStride];
};

void PrepareInFloat(const Tile& tile, TileDepths<float>* depths) {
  TilePreparer<hn::ScalableTag<float>>(tile, depths);
}
void PrepareInDouble(const Tile& tile, TileDepths<double>* depths) {
  TilePreparer<hn::ScalableTag<double>>(tile, depths);
}
void ReduceInFloat(const Tile& tile, const TileDepths<float>& depths, const TileMap& map,
                   TileExtent* extent) {
  TileReducer<hn::ScalableTag<float>>(tile, depths).Reduce(map, extent);
}
void ReduceInDouble(const Tile& tile, const TileDepths<double>& depths, const TileMap& map,
                    TileExtent* extent) {
  TileReducer<hn::ScalableTag<double>>(tile, depths).Reduce(map, extent);
}

}  // namespace HWY_NAMESPACE
}  // namespace shadowfit::resolution
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit::resolution {

HWY_EXPORT(PrepareInFloat);
HWY_EXPORT(PrepareInDouble);
HWY_EXPORT(ReduceInFloat);
HWY_EXPORT(ReduceInDouble);

void PrepareTile(const Tile& tile, TileDepths<float>* depths) {
  HWY_DYNAMIC_DISPATCH(PrepareInFloat)(tile, depths);
}
void PrepareTile(const Tile& tile, TileDepths<double>* depths) {
  HWY_DYNAMIC_DISPATCH(PrepareInDouble)(tile, depths);
}
void ReduceTile(const Tile& tile, const TileDepths<float>& depths, const TileMap& map, TileExtent* extent) {
  HWY_DYNAMIC_DISPATCH(ReduceInFloat)(tile, depths, map, extent);
}
void ReduceTile(const Tile& tile, const TileDepths<double>& depths, const TileMap& map, TileExtent* extent) {
  HWY_DYNAMIC_DISPATCH(ReduceInDouble)(tile, depths, map, extent);
}

}  // namespace shadowfit::resolution
#endif
