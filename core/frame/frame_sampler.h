#pragma once

#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "core/frame/camera.h"
#include "core/frame/images.h"
#include "core/frame/light_samples.h"
#include "core/frame/shadow_pixels.h"
#include "core/math/ray_space.h"
#include "core/math/shadow_projection.h"

namespace shadowfit {

/// What the lights of a frame share.
struct FrameExtent {
  int visible_pixels = 0;
  double nearest_ndc_depth = 0.0;  ///< Of the visible pixels; meaningless without any.
  double farthest_ndc_depth = 0.0;
};

/// Finds, in a depth and a bit buffer, what every light's fit needs: boundary samples with their derivatives,
/// and the rays that the map must hold. Each pixel is unprojected once for all lights, and only where some
/// light asks for it. Keeps its working memory between frames.
class FrameSampler {
 public:
  FrameSampler();
  ~FrameSampler();
  FrameSampler(FrameSampler&&) noexcept;
  FrameSampler& operator=(FrameSampler&&) noexcept;

  /// `samples` is resized to one entry a light. Bit i of `bits` belongs to ray_spaces[i]. `screen` is the
  /// size of the final picture, in whose pixels derivatives and lengths are expressed.
  void Sample(const Camera& camera, const DepthView& depth, const std::optional<BitsView>& bits,
              std::span<const RaySpace> ray_spaces, MapSize screen, FrameExtent* extent,
              std::vector<LightSamples>* samples);

  /// Pixels of the final screen that a light leaves in shadow and none of its maps holds, which a renderer
  /// shows lit. Of the frame that was sampled last, with its bits; `light` is its bit's number.
  double ShadowOutside(const Camera& camera, const RaySpace& ray_space, size_t light,
                       std::span<const ShadowProjection> projections) const;

  /// Samples of what the light reaches: those of every eighth pixel in every eighth row that are not in
  /// shadow, as edges either way. A map that holds them in large texels may darken them; no more than a tenth
  /// of such an edge is there, and that is their length.
  BoundarySamples LitSamples(const Camera& camera, const RaySpace& ray_space, size_t light) const;

  /// Where the light's shadow lies on a map: see PlaceShadow(). Each place stands for as many pixels of the
  /// final screen as are returned.
  double PlacesOfShadow(const Camera& camera, const RaySpace& ray_space, size_t light,
                        const ShadowProjection& projection, std::span<const ShadowProjection> others,
                        ShadowPlaces* places) const;

 private:
  struct Workspace;
  std::unique_ptr<Workspace> workspace_;
};

}  // namespace shadowfit
