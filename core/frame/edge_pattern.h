#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <vector>

#include "core/frame/lane_list.h"
#include "core/frame/light_samples.h"
#include "core/frame/pixel_scan.h"

namespace shadowfit {

// What the bits around a pixel say of the shadow's edge in it. Vectorised with run-time dispatch (Highway).

/// The direction of the edge in the 5x5 bits around a pixel, from their structure tensor: the sum of d d^T
/// over the sixteen 2x2 quads, d being a quad's bit gradient. Of a quad with bits v00 v10 / v01 v11 that is,
/// but for a factor, (g + e, g - e) with g = v11 - v00 and e = v10 - v01, so that two numbers from -16 to 16
/// say all of a direction: xx - yy = 4 sum g e and xy = sum g^2 - sum e^2. (The 3x3 bits alone know too few
/// directions: an edge of slope 1/4 looks level.) Or kTexture where the bits show a texture that the samples
/// do not resolve, such as the shadow of leaves, rather than an edge or a corner: many neighbours differ, and
/// their structure tensor has no direction.
using EdgePattern = int32_t;
inline constexpr int32_t kQuads = 16;
inline constexpr int32_t kSums = 2 * kQuads + 1;
inline constexpr EdgePattern EdgePatternOf(int32_t sum_ge, int32_t sum_gg_less_ee) {
  return (sum_ge + kQuads) * kSums + sum_gg_less_ee + kQuads;
}
inline constexpr EdgePattern kTexture = kSums * kSums;

/// The patterns of a light's bits around the listed ones of the pixels with these indices. Where nothing is
/// `visible`, light and shadow go on.
void FindEdgePatterns(const PackedBits& visible, const PackedBits& light, const LaneList<int32_t>& indices,
                      const LaneList<int32_t>& listed, LaneList<EdgePattern>* patterns);

/// How a shadow edge runs through a pixel, on the final screen.
struct EdgeDirection {
  glm::dvec2 normal;
  /// Length of edge that the pixel stands for, for each neighbour across the edge. A straight edge of length
  /// l crosses l (|n1| + |n2|) pairs of neighbours (Cauchy, Crofton); both pixels of a pair are samples, so
  /// each stands for half of it.
  double length_per_crossing;
};

/// The edge of every pattern: its normal is the dominant eigenvector of the structure tensor. A texture's
/// normal means nothing, and its length is the sum of its edges' extents along x and y.
class EdgeDirections {
 public:
  /// `scale` is final-screen pixels per sample: lengths along the edge stretch with it, its normal with the
  /// inverse.
  explicit EdgeDirections(const glm::dvec2& scale = glm::dvec2(1.0));

  /// By pattern.
  const EdgeDirection* data() const { return directions_.data(); }

 private:
  std::array<EdgeDirection, kTexture + 1> directions_;
};

/// A texture's own normals are noise: one that is foreshortened to less than a sample looks isotropic on the
/// screen, whatever it is. What casts it knows nothing of the screen: to the light, its edges have all
/// directions alike. An edge with unit normal m there has on the screen the normal A^T m / |A^T m| and |A^T
/// m| times the length, A = (a1 a2) being the derivatives of the light's picture by the screen. Many m in
/// turn cover all directions evenly.
class TextureEdges {
 public:
  /// What Turn needs for samples 0 to `count` - 1.
  void Prepare(size_t count);

  /// Gives the listed samples such edges. Their lengths are the edges' extents along x and y, added up, that
  /// the samples show, c (E|m.a1| + E|m.a2|) = c 2/pi (|a1| + |a2|); they see one in kTextureEdges.
  void Turn(LaneList<int32_t>* listed, bool directional, BoundarySamples* samples) const;

 private:
  std::vector<double> cosines_, sines_;  ///< m of each sample.
};

}  // namespace shadowfit
