#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <memory>
#include <optional>
#include <vector>

#include "absl/status/statusor.h"
#include "core/frame/camera.h"
#include "core/math/ray_space.h"
#include "core/math/shadow_projection.h"
#include "core/reference/visible_surface.h"
#include "core/scene/scene.h"

namespace shadowfit {

/// A shadow map whose every texel holds the exact first caster on the light's ray through its centre.
struct CasterMap {
  static constexpr double kNothing = 1e300;

  ShadowProjection projection;
  glm::dmat3 ray_from_texel{1.0};   ///< Inverse of projection.texel_from_ray.
  std::vector<double> along_ray;    ///< t of RaySpace::WorldRay(ray_from_texel * (u, v, 1)); or kNothing.
  std::vector<uint32_t> primitive;  ///< The caster; kNoPrimitive where the ray meets nothing.

  /// The light's ray through the centre of texel (x, y).
  RaySpace::WsRay TexelRay(const RaySpace& ray_space, int x, int y) const {
    return ray_space.WorldRay(ray_from_texel * glm::dvec3(x + 0.5, y + 0.5, 1.0));
  }
};

/// A scene in a ray tracer: the truth that every method is counted against. Triangles are solid on both
/// sides; a cutout is a hole where its texture is below the cutoff. Where only lit and shadowed are told
/// apart, a semi-transparent caster blocks light if it lets less than half of it through (mean of the
/// channels); the camera sees it either way.
///
/// All answers are the same for any number of threads.
class TruthScene {
 public:
  /// Instances are flattened into world space. An empty scene is allowed. InvalidArgument where Validate()
  /// refuses the scene; ResourceExhausted where memory runs out.
  static absl::StatusOr<TruthScene> Create(const Scene& scene);
  ~TruthScene();
  TruthScene(TruthScene&&) noexcept;
  TruthScene& operator=(TruthScene&&) noexcept;

  size_t TriangleCount() const;
  const Bounds& ws_bounds() const;

  /// Unit normal of the side on which a triangle's corners run counter-clockwise; zero where it has no area.
  glm::dvec3 WindingNormal(uint32_t primitive) const;

  struct Hit {
    double distance = 0.0;  ///< In lengths of the direction.
    glm::dvec3 ws_point{0.0};
    glm::dvec3 ws_normal{0.0};  ///< Unit, turned against the ray.
    uint32_t primitive = kNoPrimitive;
  };
  /// The first surface on a single ray; cutouts have holes.
  std::optional<Hit> FirstHit(const glm::dvec3& ws_origin, const glm::dvec3& ws_direction) const;

  /// First hits of the rays through the pixel centres between near and far plane. width, height >= 1.
  VisibleSurface RenderSurface(const Camera& camera, int width, int height) const;

  /// One shadow ray a pixel, from just above the surface's own plane (by a few float roundings of its
  /// coordinates, on the side that is seen), never meeting its own triangle.
  ShadowMask TrueShadow(const VisibleSurface& surface, const RaySpace& ray_space) const;

  /// The share of light that reaches each pixel: the product over all casters; zero behind an opaque one, one
  /// where the light is not concerned.
  std::vector<glm::vec3> TrueTransmittance(const VisibleSurface& surface, const RaySpace& ray_space) const;

  /// InvalidArgument where the projection is not finite, is singular, or has no texels.
  absl::StatusOr<CasterMap> RenderCasters(const RaySpace& ray_space,
                                          const ShadowProjection& projection) const;

 private:
  struct Impl;
  explicit TruthScene(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace shadowfit
