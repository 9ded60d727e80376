#pragma once

#include <glm/glm.hpp>
#include <span>
#include <vector>

#include "core/cancellation.h"
#include "core/irregular/mask_types.h"

namespace shadowfit::irregular {

/// An axis around which one plane of projection holds all these ray coordinates with room to spare, or a zero
/// vector where there is none and the six sides of a cube are needed.
glm::dvec3 SingleFaceAxis(std::span<const glm::vec3> rays);

/// Rows of an orthonormal basis whose third is `axis`, a unit vector; `second_hint` says where the second
/// should point as far as it can.
void BasisAround(const glm::dvec3& axis, const glm::dvec3& second_hint, double rotation[3][3]);

/// Plans the cells of a face for so many samples, of which `uv` are typical ones: rows of about equal
/// population, each with its own range of u. Samples outside what was foreseen go to the outermost cells. The
/// measures of the face's samples are given; `first_cell` is left alone. Reuses the face's memory.
void PlanFace(std::span<const glm::vec2> uv, double samples, Face* face);

/// The paper's BSP: axis-aligned median splits, along the longer side, down to leaves of at most 64 samples.
/// Reorders `order` (indices into `samples`: u, v and depth) so that leaves are contiguous; first_sample and
/// end_sample of the nodes index it. Once `cancellation` (may be null) asks, nodes are left unsplit.
void BuildBsp(std::span<const glm::vec3> uvw, std::span<uint32_t> order, const Cancellation* cancellation,
              std::vector<BspNode>* nodes);

}  // namespace shadowfit::irregular
