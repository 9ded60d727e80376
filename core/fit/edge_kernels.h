#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>

namespace shadowfit {

// The inner loops of EdgeFit and EdgeObjective, vectorised with run-time dispatch (Highway) at eight lanes:
// sums come out the same on every machine with AVX2 or better.

/// Arrays that the kernels read are padded to a multiple of this.
inline constexpr size_t kEdgeLanes = 8;
inline constexpr size_t PaddedToEdgeLanes(size_t count) {
  return (count + kEdgeLanes - 1) / kEdgeLanes * kEdgeLanes;
}

/// As the kernels take axes and steps.
inline std::array<float, 2> Rounded(const glm::dvec2& v) {
  return {static_cast<float>(v.x), static_cast<float>(v.y)};
}

/// Covectors of `count` samples (a multiple of kEdgeLanes; padding has e1 = e2 = e3 = 0) at axis (a, b, 1),
/// see WhitenedSamples, turned into the upper half plane, and the bin of each one's direction among `bins`
/// equal steps of the diamond angle: 0.5 - 0.5 x / (|x| + y), which rises with the angle and needs no
/// trigonometry.
void EdgeCovectors(const float* x, const float* y, const float* e1, const float* e2, const float* e3,
                   size_t count, float a, float b, int bins, float* gx, float* gy, int32_t* bin);

/// Sum of s/4 + t^2 / (12 s), s >= t the sorted |g . b1|, |g . b2|, over `count` covectors (a multiple of
/// kEdgeLanes; padding is zero).
float EdgeCost(const float* gx, const float* gy, size_t count, const float b1[2], const float b2[2]);

/// Directions of which EdgeCostsOfPairs takes all pairs.
inline constexpr size_t kCoarseDirections = 8;

/// costs[i][j], i != j: the sum of EdgeCost for parallelograms whose sides run along unit directions i (along
/// map x) and j and enclose the hull, on a map of `width` x `height` texels. Each direction is projected on
/// once, for all pairs. Arrays as for EdgeCost (at most kMostGathered covectors) and HullExtents.
inline constexpr size_t kMostGathered = 64;
void EdgeCostsOfPairs(const float* gx, const float* gy, size_t count, const float* vx, const float* vy,
                      size_t hull_count, const float directions[kCoarseDirections][2], float width,
                      float height, float costs[kCoarseDirections][kCoarseDirections]);

/// Greatest minus least n . v over `count` points (a multiple of kEdgeLanes; padding repeats a point) for two
/// directions.
void HullExtents(const float* vx, const float* vy, size_t count, const float n1[2], const float n2[2],
                 float extents[2]);

/// The sum of EdgeCost over samples (as for EdgeCovectors) with its slopes along the steps b1, b2 and along
/// the axis (a, b).
struct EdgeSlopes {
  float cost;
  float per_b1[2];
  float per_b2[2];
  float per_axis[2];
};
EdgeSlopes EdgeCostAndSlopes(const float* x, const float* y, const float* e1, const float* e2,
                             const float* e3, size_t count, const float axis[2], const float b1[2],
                             const float b2[2]);

/// What samples' costs c count for: f(c) = (1 - tail) c / (1 + c inverse_limit) + tail c / (1 + c
/// inverse_tail_limit).
struct EdgeLimits {
  const float* inverse_limit;
  const float* inverse_tail_limit;
  const float* tail;
};

/// Multiplies the covectors' e1, e2, e3 (as for EdgeCovectors) of each sample by f'(c), c being its EdgeCost
/// at the axis and the steps. Returns the sum of f(c).
float WeighByTangent(const float* x, const float* y, const EdgeLimits& limits, size_t count,
                     const float axis[2], const float b1[2], const float b2[2], float* e1, float* e2,
                     float* e3);

/// The points of a hull that lie farthest down and up a normal.
struct HullSupport {
  float low[2];
  float high[2];
};
/// A hull of `count` vertices (as for HullExtents) seen along an axis (a, b, 1): the extremes of w = 1 + a x
/// + b y, and the supports of the projected points (x, y) / w along two normals; these mean something where
/// w is positive.
struct HullView {
  float least_w;
  float most_w;
  HullSupport across1;
  HullSupport across2;
};
HullView ViewHull(const float* x, const float* y, size_t count, const float axis[2], const float normal1[2],
                  const float normal2[2]);

}  // namespace shadowfit
