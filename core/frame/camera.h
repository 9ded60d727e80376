#pragma once

#include <glm/glm.hpp>

#include "absl/status/statusor.h"
#include "core/math/clip_space.h"

namespace shadowfit {

/// A camera as renderers describe it. Matrices are column-major and act on column vectors.
struct CameraMatrices {
  glm::dmat4 view_from_world{1.0};
  glm::dmat4 clip_from_view{1.0};
  ClipDepth clip_depth = ClipDepth::kNegativeOneToOne;
};

/// A checked camera with the products and inverses that unprojection needs, computed once a frame.
class Camera {
 public:
  /// Fails with InvalidArgument where `view` or `projection` has an entry that is not finite or is singular.
  static absl::StatusOr<Camera> Create(const CameraMatrices& matrices);

  const glm::dmat4& view_from_world() const { return matrices_.view_from_world; }
  const glm::dmat4& clip_from_view() const { return matrices_.clip_from_view; }
  const glm::dmat4& clip_from_world() const { return clip_from_world_; }
  const glm::dmat4& world_from_clip() const { return world_from_clip_; }
  ClipDepth clip_depth() const { return matrices_.clip_depth; }

  /// The homogeneous world point of NDC coordinates; w > 0 in front of a perspective camera.
  glm::dvec4 WsFromNdc(const glm::dvec3& ndc) const { return world_from_clip_ * glm::dvec4(ndc, 1.0); }

  /// Centre of projection, homogeneous: w = 0 (a direction) for an orthographic camera.
  const glm::dvec4& ws_eye() const { return ws_eye_; }

  /// Unnormalised vector from a surface point towards the viewer.
  glm::dvec3 TowardsViewer(const glm::dvec3& ws_point) const {
    return glm::dvec3(ws_eye_) - ws_eye_.w * ws_point;
  }

 private:
  CameraMatrices matrices_;
  glm::dmat4 clip_from_world_{1.0};
  glm::dmat4 world_from_clip_{1.0};
  glm::dvec4 ws_eye_{0.0, 0.0, 0.0, 1.0};
};

}  // namespace shadowfit
