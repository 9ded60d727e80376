#pragma once

#include <glm/glm.hpp>
#include <optional>
#include <span>

namespace shadowfit {

/// A circular cone of rays around an axis.
struct EnclosingCone {
  glm::dvec3 axis{0.0, 0.0, 1.0};  ///< Unit length.
  double cos_half_angle = 1.0;     ///< In (0, 1].
};

/// The smallest cone that contains all rays, exactly, in expected linear time. Its axis is the best-centred
/// one for which every ray has axis . r > 0: the natural start of a search over light axes. The rays' lengths
/// do not matter; zero rays are skipped. None where the rays do not fit into a half space (no axis sees them
/// all) or where there is no ray. Deterministic: the order of processing is a fixed shuffle of the input's.
std::optional<EnclosingCone> SmallestEnclosingCone(std::span<const glm::dvec3> rays);

}  // namespace shadowfit
