#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>

namespace shadowfit {

// What the bits around a pixel say of the shadow's edge in it. A window is 5x5 bits, bit 5 row + column.

inline constexpr int kMiddleOfWindow = 12;
inline constexpr uint32_t kWholeWindow = (1u << 25) - 1;

/// How a shadow edge runs through a pixel, on the final screen.
struct EdgeDirection {
  glm::dvec2 normal;
  /// Length of edge that the pixel stands for, for each neighbour across the edge. A straight edge of length
  /// l crosses l (|n1| + |n2|) pairs of neighbours (Cauchy, Crofton); both pixels of a pair are samples, so
  /// each stands for half of it.
  double length_per_crossing;
};

/// The edge through the middle of a window, by its inner 3x3 bits: its normal is the dominant eigenvector of
/// the structure tensor, the sum of g g^T over the four 2x2 quads, with g a quad's bit gradient.
class EdgeDirections {
 public:
  /// `scale` is final-screen pixels per sample: lengths along the edge stretch with it, its normal with the
  /// inverse.
  explicit EdgeDirections(const glm::dvec2& scale = glm::dvec2(1.0));

  const EdgeDirection& Of(uint32_t window) const {
    return directions_[(window >> 6 & 7u) | (window >> 11 & 7u) << 3 | (window >> 16 & 7u) << 6];
  }

 private:
  std::array<EdgeDirection, 512> directions_;
};

/// Whether a window shows a texture that the samples do not resolve, such as the shadow of leaves, rather
/// than an edge or a corner: many neighbours differ, and their structure tensor has no direction.
bool IsTexture(uint32_t window);

/// One of a texture's many edges, on the final screen.
struct TextureEdge {
  glm::dvec2 normal;
  double length;
};

/// A texture's own normals are noise: one that is foreshortened to less than a sample looks isotropic on the
/// screen, whatever it is. What casts it knows nothing of the screen: to the light, its edges have all
/// directions alike. An edge with unit normal m there has on the screen the normal A^T m / |A^T m| and |A^T
/// m| times the length, A = (a1 a2) being the derivatives of the light's picture by the screen. `index` picks
/// m: many in turn cover all directions evenly. `extents` are the edges' extents along x and y, added up,
/// that the samples show, c (E|m.a1| + E|m.a2|) = c 2/pi (|a1| + |a2|); they see one in kTextureEdges.
TextureEdge TextureEdgeOf(size_t index, double extents, bool directional, const glm::dvec3& ray,
                          const glm::dvec3& ray_dx1, const glm::dvec3& ray_dx2);

/// Makes predictions for leaves as good as those for walls.
inline constexpr double kTextureEdges = 2.0;

}  // namespace shadowfit
