#pragma once

#include <cstdint>
#include <vector>

#include "absl/status/statusor.h"
#include "core/bias/depth_test.h"
#include "core/bias/standard_test.h"
#include "core/math/ray_space.h"
#include "core/math/shadow_projection.h"
#include "core/reference/truth_scene.h"
#include "core/reference/visible_surface.h"

/// The standard shadow map as renderers make it, with its depth errors, and counts of what they do to the
/// picture.
namespace shadowfit {

/// The casters that a map's texels hold, before depth is rounded to a format.
struct StandardMap {
  CasterMap casters;
  DepthRange range;
  std::vector<double> depth;  ///< Window depth of each caster, not clamped; 1 where there is nothing.
};

/// Errors as of TruthScene::RenderCasters. With one kind of face alone, every surface that the camera could
/// see counts as a caster.
absl::StatusOr<StandardMap> RenderStandardMap(const TruthScene& scene, const RaySpace& ray_space,
                                              const ShadowProjection& projection, const DepthRange& range,
                                              CasterFaces casters = CasterFaces::kBoth);

/// What a renderer would show; `test.casters` was said when the map was rendered. `truth` says which pixels
/// the light concerns; those off the map are lit.
ShadowMask ShadowFromStandardMap(const StandardMap& map, const StandardTest& test,
                                 const VisibleSurface& surface, const ShadowMask& truth,
                                 const RaySpace& ray_space);

/// What it would show if depth had no errors: the test of ShadowFromMaps, filtered, in which low casters
/// count as well. They do lie above the plane: that a texel's centre sees them is the map's coarseness, not
/// an error of its depth.
ShadowMask ShadowWithoutDepthErrors(const StandardMap& map, int pcf_radius, const VisibleSurface& surface,
                                    const ShadowMask& truth, const RaySpace& ray_space,
                                    PcfKernel kernel = PcfKernel::kBox);

/// Wrong pixels, by cause.
struct ArtefactCounts {
  int acne = 0;           ///< In shadow by depth errors alone: false self-shadowing.
  int peter_panning = 0;  ///< Lit by bias or by the choice of faces alone: detached shadows, leaks.
  int jagged = 0;         ///< Wrong even without depth errors: texels are too coarse.
  int wrong() const { return acne + peter_panning + jagged; }
};

/// `ideal` is ShadowWithoutDepthErrors of a map with both faces and the same kernel.
ArtefactCounts CountArtefacts(const ShadowMask& truth, const ShadowMask& ideal, const ShadowMask& shown);

/// Points of one surface whose answer changes between two frames although the truth does not.
int CountFlicker(const ShadowMask& truth_before, const ShadowMask& before, const ShadowMask& truth_after,
                 const ShadowMask& after);

}  // namespace shadowfit
