#include "core/budget/texel_budget.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <utility>

namespace shadowfit {
namespace {

/// The lengths that a side may have, and the sizes among which one light's map moves: a staircase of sizes
/// that keeps to the requested aspect ratio as closely as the lengths allow.
class SizeLadder {
 public:
  SizeLadder(MapSize requested, const SideLimits& sides)
      : aspect_(double(requested.width) / requested.height), rounding_(sides.rounding) {
    max_side_ = RoundDown(std::max(sides.max_side, 1));
    min_side_ = std::min(RoundUp(std::max(sides.min_side, 1)), max_side_);
  }

  /// The largest size of the requested aspect ratio within so many texels.
  MapSize Below(double texels) const {
    MapSize size{Clamped(std::sqrt(texels * aspect_)), 0};
    size.height = Clamped(std::min(std::sqrt(texels / aspect_), texels / size.width));
    // A height at its limit leaves texels to the width, and the other way round.
    if (size.height == min_side_ || size.height == max_side_) size.width = Clamped(texels / size.height);
    return size;
  }
  MapSize Smallest() const { return Below(0.0); }
  MapSize Largest() const { return Below(1e300); }

  /// The next size above, by one side; the same size at the top. Of the two, the one nearer to the aspect
  /// ratio.
  MapSize Above(MapSize size) const {
    return Nearer({Next(size.width), size.height}, {size.width, Next(size.height)}, size);
  }
  /// The next size below; the same size at the bottom.
  MapSize Under(MapSize size) const {
    return Nearer({Previous(size.width), size.height}, {size.width, Previous(size.height)}, size);
  }

 private:
  int RoundDown(int length) const {
    if (rounding_ == SizeRounding::kMultipleOf8) return std::max(8, length / 8 * 8);
    if (rounding_ == SizeRounding::kExact) return length;
    int power = 1;
    while (power <= length / 2) power *= 2;
    return power;
  }
  int RoundUp(int length) const {
    const int below = RoundDown(length);
    return below >= length ? below : rounding_ == SizeRounding::kMultipleOf8 ? below + 8 : below * 2;
  }
  int Clamped(double length) const {
    // A side of 63.999999 texels is one of 64.
    return std::max(min_side_, RoundDown(static_cast<int>(std::min(length + 1e-6, double(max_side_)))));
  }
  int Next(int length) const {
    const int next = rounding_ == SizeRounding::kExact         ? length + 1
                     : rounding_ == SizeRounding::kMultipleOf8 ? length + 8
                                                               : length * 2;
    return std::min(next, max_side_);
  }
  int Previous(int length) const {
    const int previous = rounding_ == SizeRounding::kExact         ? length - 1
                         : rounding_ == SizeRounding::kMultipleOf8 ? length - 8
                                                                   : length / 2;
    return std::max(previous, min_side_);
  }
  MapSize Nearer(MapSize a, MapSize b, MapSize from) const {
    if (a == from) return b;
    if (b == from) return a;
    const auto distance = [this](MapSize size) {
      return std::abs(std::log(double(size.width) / size.height / aspect_));
    };
    return distance(a) <= distance(b) ? a : b;
  }

  double aspect_;
  SizeRounding rounding_;
  int min_side_ = 1;
  int max_side_ = 1;
};

struct Shares {
  std::vector<MapSize> sizes;
  double left = 0.0;  ///< Texels.
};

/// Steps up the ladders where a texel gains most, while texels are left.
void Spend(std::span<const TexelDemand> demands, std::span<const SizeLadder> ladders, Shares* shares) {
  for (;;) {
    double best_gain = 0.0;
    size_t best = 0;
    for (size_t i = 0; i < demands.size(); ++i) {
      const MapSize above = ladders[i].Above(shares->sizes[i]);
      const double texels = above.texels() - shares->sizes[i].texels();
      if (!(texels > 0.0) || texels > shares->left) continue;
      const double gain = demands[i].weight *
                          (demands[i].WrongPixels(shares->sizes[i]) - demands[i].WrongPixels(above)) / texels;
      if (gain > best_gain) {
        best_gain = gain;
        best = i;
      }
    }
    if (best_gain == 0.0) return;
    const MapSize above = ladders[best].Above(shares->sizes[best]);
    shares->left -= above.texels() - shares->sizes[best].texels();
    shares->sizes[best] = above;
  }
}

/// Steps up the ladders, each of which doubles a map and so takes a power of two of texels and gains less
/// than the one before it: a knapsack whose sizes are powers of two, which is solved exactly from the
/// smallest size up. An odd bit of the capacity holds the best thing of its size; what else there is of that
/// size is of use in pairs only, the best with the next best, and a pair is a thing of the next size (the
/// "package-merge" of L. L. Larmore, D. S. Hirschberg, "A fast algorithm for optimal length-limited Huffman
/// codes", 1990).
std::vector<MapSize> SharePowersOfTwo(std::span<const TexelDemand> demands,
                                      std::span<const SizeLadder> ladders, double total) {
  struct Package {
    double gain = 0.0;
    std::vector<size_t> lights;  ///< A step up for each entry.
  };
  constexpr size_t kBits = 48;
  std::array<std::vector<Package>, kBits + 1> packages;
  std::vector<MapSize> sizes;
  double left = total;
  for (size_t i = 0; i < demands.size(); ++i) {
    sizes.push_back(ladders[i].Smallest());
    left -= sizes.back().texels();
    MapSize size = sizes.back();
    for (;;) {
      const MapSize above = ladders[i].Above(size);
      const double gain = demands[i].weight * (demands[i].WrongPixels(size) - demands[i].WrongPixels(above));
      if (above == size || !(gain > 0.0)) break;
      const auto texels = static_cast<uint64_t>(above.texels() - size.texels());
      packages[static_cast<size_t>(std::countr_zero(texels))].push_back({gain, {i}});
      size = above;
    }
  }
  if (!(left > 0.0)) return sizes;
  const auto capacity = static_cast<uint64_t>(std::min(left, std::ldexp(1.0, kBits) - 1.0));
  for (size_t bit = 0; bit < kBits; ++bit) {
    std::vector<Package>& here = packages[bit];
    std::stable_sort(here.begin(), here.end(),
                     [](const Package& a, const Package& b) { return a.gain > b.gain; });
    size_t next = 0;
    if ((capacity >> bit & 1) != 0 && !here.empty()) {
      for (const size_t light : here[0].lights) sizes[light] = ladders[light].Above(sizes[light]);
      next = 1;
    }
    for (; next < here.size(); next += 2) {
      Package pair = std::move(here[next]);
      if (next + 1 < here.size()) {
        pair.gain += here[next + 1].gain;
        pair.lights.insert(pair.lights.end(), here[next + 1].lights.begin(), here[next + 1].lights.end());
      }
      packages[bit + 1].push_back(std::move(pair));
    }
  }
  return sizes;
}

}  // namespace

double TexelDemand::WrongPixels(MapSize size) const { return cost / std::sqrt(size.texels()); }

double TexelDemand::Predicted(double displaced) const {
  return (1.0 - tail) * displaced / (1.0 + displaced / most_pixels) + tail * displaced;
}

double TexelDemand::Displaced(double predicted) const {
  // With q = predicted / most_pixels the displaced y solve tail y^2 / most_pixels + (1 - q) y = predicted.
  // Without a tail that is without end at q = 1.
  constexpr double kLeast = 0.001;
  const double q = predicted / most_pixels;
  return 2.0 * predicted / std::max(kLeast, 1.0 - q + std::sqrt((1.0 - q) * (1.0 - q) + 4.0 * tail * q));
}

std::vector<double> ShareTexels(std::span<const double> demand, std::span<const double> least,
                                std::span<const double> most, double total) {
  std::vector<double> shares(demand.size());
  const auto fill = [&](double log_lambda) {
    const double lambda = std::exp(log_lambda);
    double sum = 0.0;
    for (size_t i = 0; i < demand.size(); ++i) {
      const double wanted = demand[i] > 0.0 ? lambda * std::cbrt(demand[i] * demand[i]) : 0.0;
      shares[i] = std::max(least[i], std::min(wanted, most[i]));
      sum += shares[i];
    }
    return sum;
  };
  double low = -700.0;
  double high = 700.0;
  for (int i = 0; i < 100; ++i) {
    const double middle = 0.5 * (low + high);
    (fill(middle) <= total ? low : high) = middle;
  }
  fill(low);
  return shares;
}

std::vector<MapSize> ShareSizes(std::span<const TexelDemand> demands, const SideLimits& sides, double total) {
  std::vector<SizeLadder> ladders;
  std::vector<double> weighted;
  std::vector<double> least;
  std::vector<double> most;
  for (const TexelDemand& demand : demands) {
    ladders.emplace_back(demand.requested, sides);
    weighted.push_back(demand.weight * demand.cost);
    least.push_back(ladders.back().Smallest().texels());
    most.push_back(ladders.back().Largest().texels());
  }
  if (sides.rounding == SizeRounding::kPowerOfTwo) return SharePowersOfTwo(demands, ladders, total);
  const std::vector<double> ideal = ShareTexels(weighted, least, most, total);
  Shares shares;
  shares.left = total;
  for (size_t i = 0; i < demands.size(); ++i) {
    shares.sizes.push_back(ladders[i].Below(ideal[i]));
    shares.left -= shares.sizes.back().texels();
  }
  Spend(demands, ladders, &shares);
  return shares.sizes;
}

double ToleranceSafety(double texel_pixels) {
  return std::clamp(1.45 - 0.28 * std::log(texel_pixels), 1.25, 2.2);
}

namespace {

double Safe(const TexelDemand& demand, double texels) {
  const double predicted = demand.Predicted(demand.cost / std::sqrt(texels));
  if (!(predicted > 0.0) || !(demand.unit_pixels > 0.0)) return 0.0;
  return predicted * ToleranceSafety(predicted / demand.unit_pixels);
}

}  // namespace

double SafeWrongPixels(const TexelDemand& demand, MapSize size) { return Safe(demand, size.texels()); }

double SafeTexels(const TexelDemand& demand, double allowed) {
  double low = 1.0;
  double high = 1e12;
  if (!(Safe(demand, low) > allowed)) return 0.0;
  for (int i = 0; i < 100; ++i) {
    const double middle = std::sqrt(low * high);
    (Safe(demand, middle) > allowed ? low : high) = middle;
  }
  return high;
}

MapSize SizeFrom(MapSize requested, double texels, const SideLimits& sides) {
  const SizeLadder ladder(requested, sides);
  MapSize size = ladder.Below(texels);
  // Rounding down may have left a ladder's step out.
  while (size.texels() >= texels && !(ladder.Under(size) == size)) size = ladder.Under(size);
  while (size.texels() < texels) {
    const MapSize above = ladder.Above(size);
    if (above == size) break;
    size = above;
  }
  return size;
}

MapSize SmallestSize(MapSize requested, const SideLimits& sides) {
  return SizeLadder(requested, sides).Smallest();
}

ShadowProjection Resized(const ShadowProjection& projection, MapSize size) {
  const glm::dvec3 scale(double(size.width) / projection.size.width,
                         double(size.height) / projection.size.height, 1.0);
  ShadowProjection resized{projection.texel_from_ray, size};
  for (int column = 0; column < 3; ++column) resized.texel_from_ray[column] *= scale;
  return resized;
}

}  // namespace shadowfit
