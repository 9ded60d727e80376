#include "core/frame/camera.h"

#include <cmath>
#include <string_view>

#include "absl/status/status.h"
#include "absl/strings/str_format.h"

namespace shadowfit {
namespace {

absl::Status CheckFinite(const glm::dmat4& m, std::string_view name) {
  for (int column = 0; column < 4; ++column) {
    for (int row = 0; row < 4; ++row) {
      if (std::isfinite(m[column][row])) continue;
      return absl::InvalidArgumentError(
          absl::StrFormat("%s.m[%d]: %g is not finite", name, 4 * column + row, m[column][row]));
    }
  }
  return absl::OkStatus();
}

/// A determinant is judged after every row is scaled to unit length, so that the units of the scene do not
/// matter.
absl::Status CheckRegular(const glm::dmat4& m, std::string_view name) {
  glm::dmat4 rows = glm::transpose(m);
  for (int row = 0; row < 4; ++row) {
    const glm::dvec4 a = glm::abs(rows[row]);
    const double largest = std::max({a.x, a.y, a.z, a.w});
    if (largest == 0.0) {
      return absl::InvalidArgumentError(absl::StrFormat("%s: singular, row %d is zero", name, row));
    }
    rows[row] /= largest;
    rows[row] = glm::normalize(rows[row]);
  }
  const double volume = std::abs(glm::determinant(rows));
  if (volume > 1e-14) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrFormat("%s: singular, determinant of its normalised rows is %g", name, volume));
}

}  // namespace

absl::StatusOr<Camera> Camera::Create(const CameraMatrices& matrices) {
  for (const auto& [matrix, name] : {std::pair(&matrices.view_from_world, std::string_view("view")),
                                     std::pair(&matrices.clip_from_view, std::string_view("projection"))}) {
    if (absl::Status status = CheckFinite(*matrix, name); !status.ok()) return status;
    if (absl::Status status = CheckRegular(*matrix, name); !status.ok()) return status;
  }
  Camera camera;
  camera.matrices_ = matrices;
  camera.clip_from_world_ = matrices.clip_from_view * matrices.view_from_world;
  camera.world_from_clip_ = glm::inverse(camera.clip_from_world_);
  if (absl::Status status = CheckFinite(camera.world_from_clip_, "projection * view, inverted");
      !status.ok()) {
    return status;
  }
  // The eye is the point that projects to no x, no y and no w: the third column of the inverse.
  glm::dvec4 eye = camera.world_from_clip_[2];
  const double largest = std::max({std::abs(eye.x), std::abs(eye.y), std::abs(eye.z)});
  if (std::abs(eye.w) > 1e-12 * largest) {
    eye /= eye.w;
  } else {
    // Orthographic: a direction, turned against the view direction (far minus near).
    const glm::dvec4 near_point = camera.WsFromNdc({0.0, 0.0, NearNdc(matrices.clip_depth)});
    const glm::dvec4 far_point = camera.WsFromNdc({0.0, 0.0, FarNdc(matrices.clip_depth)});
    const glm::dvec3 backwards = glm::dvec3(near_point) / near_point.w - glm::dvec3(far_point) / far_point.w;
    eye = glm::dvec4(glm::normalize(backwards), 0.0);
  }
  camera.ws_eye_ = eye;
  return camera;
}

}  // namespace shadowfit
