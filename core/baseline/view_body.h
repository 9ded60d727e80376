#pragma once

#include <glm/glm.hpp>
#include <vector>

#include "core/baseline/light_frustum.h"
#include "core/fit/light_problem.h"
#include "core/frame/camera.h"
#include "core/scene/bounds.h"

namespace shadowfit {

/// A convex polyhedron in world space that is cut by half spaces: the part of the view frustum that can hold
/// receivers. Methods look at its vertices alone.
class ViewBody {
 public:
  /// The view frustum between two NDC depths; empty where one of its corners is infinitely far away.
  ViewBody(const Camera& camera, double ndc_depth_a, double ndc_depth_b);

  /// Keeps the points with plane . [X;1] >= 0.
  void Clip(const glm::dvec4& plane);
  void ClipToBounds(const Bounds& bounds);

  /// Keeps what lies in front of a point light's image plane, short of the light itself, whose image is
  /// infinite. Does nothing for directional lights.
  void ClipToFront(const RaySpace& ray_space, const PlaneMap& plane);
  /// Keeps what lies in the light's frustum.
  void ClipToFrustum(const RaySpace& ray_space, const LightFrustum& frustum);

  bool empty() const { return faces_.empty(); }
  /// Vertices, each once for every face that it belongs to.
  std::vector<glm::dvec3> Vertices() const;

 private:
  std::vector<std::vector<glm::dvec3>> faces_;
};

}  // namespace shadowfit
