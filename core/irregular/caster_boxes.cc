#include "core/irregular/caster_boxes.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/irregular/parallel.h"

namespace shadowfit::irregular {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();

/// By how much a direction may be off: plane coordinates by that times 1 + u^2 + v^2, and those of a
/// directional light by that share of themselves.
constexpr double kSlack = 6e-4;

struct Box {
  float u_min, v_min, u_max, v_max, nearest;
};

/// Encloses the corners' box as the face sees it, whose samples have |u| and |v| up to `widest`. The slack
/// covers the rounding of corners and samples to single precision, and that of slivers' edges.
Box BoxOf(const LightFrame& frame, const Face& face, double widest, const MaskScene::Cluster& cluster) {
  const glm::dvec3 low = glm::dvec3(cluster.ws_min) - frame.ws_origin;
  const glm::dvec3 high = glm::dvec3(cluster.ws_max) - frame.ws_origin;
  const glm::dvec3 centre = 0.5 * (low + high), extent = 0.5 * (high - low);
  double least[3], most[3];
  for (int row = 0; row < 3; ++row) {
    const double* m = face.rotation[row];
    const double at = m[0] * centre.x + m[1] * centre.y + m[2] * centre.z;
    const double reach = std::abs(m[0]) * extent.x + std::abs(m[1]) * extent.y + std::abs(m[2]) * extent.z;
    const double slack = 1e-5 * (std::abs(at) + reach);
    least[row] = at - reach - slack;
    most[row] = at + reach + slack;
  }
  double u[2] = {least[0], most[0]}, v[2] = {least[1], most[1]};
  double nearest = least[2];
  if (!frame.directional) {
    constexpr Box kNone = {kInfinity, kInfinity, -kInfinity, -kInfinity, kInfinity};
    if (!(most[2] > 0.0)) return kNone;
    // Beyond a side of the pyramid that holds the samples' rays, by as much as the slack below at its edge?
    const double margin = kSlack * (1.0 + 2.0 * widest * widest) * most[2];
    for (int row = 0; row < 2; ++row) {
      for (const double sign : {-1.0, 1.0}) {
        double at = 0.0, reach = 0.0;
        for (int i = 0; i < 3; ++i) {
          const double side = sign * face.rotation[row][i] - widest * face.rotation[2][i];
          at += side * centre[i];
          reach += std::abs(side) * extent[i];
        }
        if (at - reach > margin) return kNone;
      }
    }
    if (!(least[2] > 1e-3 * most[2])) return {-kInfinity, -kInfinity, kInfinity, kInfinity, -kInfinity};
    for (double* x : {u, v}) {
      x[0] /= x[0] < 0.0 ? least[2] : most[2];
      x[1] /= x[1] > 0.0 ? least[2] : most[2];
    }
    nearest = -1.0 / least[2];
  }
  const double reach_u = std::max(std::abs(u[0]), std::abs(u[1]));
  const double reach_v = std::max(std::abs(v[0]), std::abs(v[1]));
  const double slack =
      kSlack * (frame.directional ? std::max(reach_u, reach_v) : 1.0 + reach_u * reach_u + reach_v * reach_v);
  return {static_cast<float>(u[0] - slack), static_cast<float>(v[0] - slack),
          static_cast<float>(u[1] + slack), static_cast<float>(v[1] + slack), static_cast<float>(nearest)};
}

}  // namespace

BoxArrays CasterBoxes::Of(int face) const {
  const float* first = values_.data() + static_cast<size_t>(face) * 5 * stride_;
  return {first, first + stride_, first + 2 * stride_, first + 3 * stride_, first + 4 * stride_};
}

bool CasterBoxes::Compute(std::span<const CasterSegment> segments, const LightPlan& plan,
                          const Cancellation* cancellation) {
  count_ = 0;
  for (const CasterSegment& segment : segments) count_ += segment.clusters.size();
  stride_ = (count_ + 2 * kPadding - 1) / kPadding * kPadding;
  if (!values_.Reserve(static_cast<size_t>(plan.face_count) * 5 * stride_)) return false;
  size_t first = 0;
  for (const CasterSegment& segment : segments) {
    ForEachPiece(segment.clusters.size(), 256, [&](size_t begin, size_t end) {
      if (cancellation != nullptr && cancellation->Requested()) return;
      const double widest = plan.face_count == 1 ? static_cast<double>(kWidestFace) : 1.0;
      for (int f = 0; f < plan.face_count; ++f) {
        float* const out = values_.data() + static_cast<size_t>(f) * 5 * stride_ + first;
        for (size_t i = begin; i < end; ++i) {
          const Box box = BoxOf(plan.frame, plan.faces[static_cast<size_t>(f)], widest, segment.clusters[i]);
          out[i] = box.u_min;
          out[stride_ + i] = box.v_min;
          out[2 * stride_ + i] = box.u_max;
          out[3 * stride_ + i] = box.v_max;
          out[4 * stride_ + i] = box.nearest;
        }
      }
    });
    first += segment.clusters.size();
  }
  return true;
}

}  // namespace shadowfit::irregular
