#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/frame/lane_list.h"
#include "core/frame/pixel_scan.h"

namespace shadowfit {

/// Samples that a shadow must be wide, or the light between shadows, to count as wide at an edge of it: this
/// pixel and those behind it.
inline constexpr int kWideSamples = 3;

/// The pixels that some light of a frame needs, with what its bits say of their neighbours, structure of
/// arrays. Neighbours 0 to 3 are those to the left, to the right, below and above. In the order of their
/// places, whichever lights ask for them: a light's samples come in the same order with other lights and
/// without.
struct ActivePixels {
  LaneList<int32_t> index;  ///< PixelPlanes::Index.
  /// Lights whose bit differs from visible neighbour k's. That one is active, too.
  std::array<LaneList<uint32_t>, 4> crossing;
  LaneList<uint32_t> continuous;  ///< Bit k: the surface goes on to neighbour k, which is visible.
  /// Lights whose shadow reaches the screen border or a discontinuity here, or that sample its inside here.
  LaneList<uint32_t> rim;
  /// Lights with an edge here whose shadow, or light, on this side of it is narrower than kWideSamples, or
  /// not known to be wider.
  LaneList<uint32_t> narrow;
  /// By index, of pixels that are active; meaningless of others.
  std::vector<int32_t> place_of_index;

  size_t size() const { return index.size(); }
  /// Whether the pixel with this index is active.
  bool Has(int32_t pixel) const;
  void Reserve(size_t size);
  void Resize(size_t size);
};

/// Finds the pixels at shadows' boundaries, at their rims and, every so often, inside of them. Most pixels
/// are inside a lit or a shadowed region, and settled a vector at a time.
void FindActivePixels(const PixelPlanes& planes, const BendTolerance& tolerance, ActivePixels* active);

}  // namespace shadowfit
