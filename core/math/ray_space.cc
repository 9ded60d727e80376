#include "core/math/ray_space.h"

#include <cmath>
#include <numbers>

#include "absl/status/status.h"
#include "absl/strings/str_format.h"

namespace shadowfit {
namespace {

bool IsFinite(const glm::dvec3& v) { return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z); }

absl::Status CheckPosition(const glm::dvec3& p) {
  if (IsFinite(p)) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrFormat("position: (%g, %g, %g) is not finite", p.x, p.y, p.z));
}

absl::StatusOr<glm::dvec3> UnitDirection(const glm::dvec3& d) {
  if (!IsFinite(d)) {
    return absl::InvalidArgumentError(
        absl::StrFormat("direction: (%g, %g, %g) is not finite", d.x, d.y, d.z));
  }
  // Scaling by the largest component first keeps tiny and huge vectors from under- and overflowing.
  const double largest = std::max({std::abs(d.x), std::abs(d.y), std::abs(d.z)});
  if (largest == 0.0) return absl::InvalidArgumentError("direction: zero-length vector");
  return glm::normalize(d / largest);
}

/// Rows (a1, a2, d): an orthonormal right-handed basis whose third axis is the unit vector d. The helper axis
/// is the coordinate axis least aligned with d, so the basis changes smoothly while d stays in one octant.
glm::dmat3 RowsAround(const glm::dvec3& d) {
  const glm::dvec3 a = glm::abs(d);
  const glm::dvec3 helper = a.x <= a.y && a.x <= a.z ? glm::dvec3(1, 0, 0)
                            : a.y <= a.z             ? glm::dvec3(0, 1, 0)
                                                     : glm::dvec3(0, 0, 1);
  const glm::dvec3 a1 = glm::normalize(glm::cross(helper, d));
  return glm::transpose(glm::dmat3(a1, glm::cross(d, a1), d));
}

}  // namespace

absl::StatusOr<RaySpace> RaySpace::Create(const Light& light) {
  RaySpace space;
  if (const auto* point = std::get_if<PointLight>(&light)) {
    if (absl::Status status = CheckPosition(point->ws_position); !status.ok()) return status;
    space.ws_position_ = point->ws_position;
    space.offset_ = -point->ws_position;
    return space;
  }
  if (const auto* spot = std::get_if<SpotLight>(&light)) {
    if (absl::Status status = CheckPosition(spot->ws_position); !status.ok()) return status;
    const absl::StatusOr<glm::dvec3> direction = UnitDirection(spot->ws_direction);
    if (!direction.ok()) return direction.status();
    if (!(spot->outer_half_angle > 0.0 && spot->outer_half_angle < std::numbers::pi / 2)) {
      return absl::InvalidArgumentError(
          absl::StrFormat("outer_half_angle: %g is outside (0, pi/2) radians", spot->outer_half_angle));
    }
    space.ws_position_ = spot->ws_position;
    space.ws_direction_ = *direction;
    space.linear_ = RowsAround(*direction);
    space.offset_ = -(space.linear_ * spot->ws_position);
    space.cos_outer_ = std::cos(spot->outer_half_angle);
    return space;
  }
  const absl::StatusOr<glm::dvec3> direction = UnitDirection(std::get<DirectionalLight>(light).ws_direction);
  if (!direction.ok()) return direction.status();
  space.directional_ = true;
  space.ws_direction_ = *direction;
  space.linear_ = RowsAround(*direction);
  for (int column = 0; column < 3; ++column) space.linear_[column][2] = 0.0;
  space.offset_ = glm::dvec3(0.0, 0.0, 1.0);
  return space;
}

bool RaySpace::Illuminates(const glm::dvec3& ws_point) const {
  if (!cos_outer_) return true;
  const glm::dvec3 from_light = ws_point - ws_position_;
  return glm::dot(from_light, ws_direction_) >= *cos_outer_ * glm::length(from_light);
}

RaySpace::WsRay RaySpace::WorldRay(const glm::dvec3& r) const {
  // The rows of the linear part are orthonormal (or zero), so its transpose undoes it.
  if (directional_) {
    const glm::dvec3 ws_on_plane = glm::transpose(linear_) * (glm::dvec3(r.x, r.y, 0.0) / r.z);
    return {ws_on_plane, ws_direction_};
  }
  return {ws_position_, glm::transpose(linear_) * r};
}

glm::dvec3 RaySpace::PointFromRay(const glm::dvec3& r, double q) const {
  const WsRay ray = WorldRay(r);
  return ray.origin + q * ray.direction;
}

}  // namespace shadowfit
