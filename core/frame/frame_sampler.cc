#include "core/frame/frame_sampler.h"

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>

#include "core/frame/active_pixels.h"
#include "core/frame/edge_pattern.h"
#include "core/frame/for_lights.h"
#include "core/frame/light_pixels.h"
#include "core/frame/narrow_shadows.h"
#include "core/frame/pixel_scan.h"
#include "core/frame/pixel_surfaces.h"
#include "core/frame/sample_rays.h"
#include "core/frame/shadow_pixels.h"
#include "core/frame/visible_pixels.h"

namespace shadowfit {
namespace {

// Relative change of view distance beyond a pixel's linear prediction that counts as a depth discontinuity.
// On planes the prediction is exact; smooth surfaces stay far below this at any useful resolution.
constexpr float kDiscontinuity = 0.01f;

// Under an orthographic camera, where view distance has no scale of its own: the same in pixel widths.
constexpr double kOrthographicDiscontinuityPixels = 8.0;

// Pixels to stand in for a shadow boundary where there is none; more would add time and no information.
constexpr size_t kMostFallbackSamples = 2048;

// Steps between samples of what is lit, and the share of an edge that each stands for. Of 0, 0.01, 0.1 and
// 0.5 this leaves two maps on the plaza and in the hall as they were, and takes what neighbours' far texels
// darkened in the warehouse.
constexpr int kLitStride = 8;
constexpr double kLitEdges = 0.1;

/// Working memory of one light at a time.
struct LightScratch {
  LightPixels pixels;
  PackedBits bits;
  LaneList<EdgePattern> patterns;
  SampledTextures textures;
  LaneList<int32_t> lit;
};

}  // namespace

struct FrameSampler::Workspace {
  // Per frame.
  glm::dvec2 pixels_per_sample{0.0};  ///< Final-screen pixels per low-resolution pixel.
  EdgeDirections edge_directions;     ///< For pixels_per_sample.
  BendTolerance tolerance;
  PixelPlanes planes;
  PackedBits visible;
  ActivePixels active;
  VisiblePixels visible_pixels;
  PixelSurfaces surfaces;  ///< Of the active pixels, or of the visible ones.
  TextureEdges texture_edges;

  // Lights are sampled side by side.
  tbb::enumerable_thread_specific<LightScratch> scratch;

  void Begin(const Camera& camera, const DepthView& depth, MapSize screen, FrameExtent* extent);
  void SampleBoundary(const RaySpace& ray_space, uint32_t light_bit, LightScratch* light,
                      LightSamples* samples) const;
  void SampleAllVisible(const RaySpace& ray_space, LightScratch* light, LightSamples* samples) const;

  /// Of pixels in any order.
  PixelSurfaces Unproject(const Camera& camera, LaneList<int32_t> indices) const;
  /// All that the light may shine on: its hull samples, and where it surely does such a share of an edge,
  /// which may run either way and be anywhere.
  void SampleEitherWay(const PixelSurfaces& pixels, const RaySpace& ray_space, double edges,
                       LightScratch* light, LightSamples* samples) const;
};

void FrameSampler::Workspace::Begin(const Camera& camera, const DepthView& depth, MapSize screen,
                                    FrameExtent* extent) {
  const int width = depth.width;
  const int height = depth.height;
  const glm::dvec2 scale(static_cast<double>(screen.width) / width,
                         static_cast<double>(screen.height) / height);
  if (scale != pixels_per_sample) {
    pixels_per_sample = scale;
    edge_directions = EdgeDirections(scale);
  }

  const ClipDepth convention = camera.clip_depth();
  const glm::dmat4& world_from_clip = camera.world_from_clip();
  const glm::dvec4 w_row = glm::transpose(world_from_clip)[3];
  const bool perspective =
      std::abs(w_row.x) + std::abs(w_row.y) + std::abs(w_row.z) > 1e-12 * std::abs(w_row.w);
  const double background = BackgroundWindowDepth(convention);
  const double ndc_per_depth = NdcFromWindowDepth(convention, 1.0) - NdcFromWindowDepth(convention, 0.0);
  InverseDistanceLaw law;
  law.background = static_cast<float>(background);
  law.must_be_positive = perspective;
  if (perspective) {
    law.per_x = w_row.x * 2.0 / width;
    law.per_y = w_row.y * 2.0 / height;
    law.per_depth = w_row.z * ndc_per_depth;
    law.constant = w_row.x * (1.0 / width - 1.0) + w_row.y * (1.0 / height - 1.0) +
                   w_row.z * NdcFromWindowDepth(convention, background) + w_row.w;
    tolerance = {kDiscontinuity, 0.0f};
  } else {
    law.per_depth = ndc_per_depth;
    const double pixel_width = glm::length(glm::dvec3(world_from_clip[0])) * 2.0 / width;
    tolerance = {0.0f, static_cast<float>(kOrthographicDiscontinuityPixels * pixel_width /
                                          glm::length(glm::dvec3(world_from_clip[2])))};
  }

  planes.Resize(width, height);
  const VisibleDepths visible_depths = ScanDepth(depth, law, &planes);
  const bool reversed = convention == ClipDepth::kReversedZeroToOne;
  extent->visible_pixels = visible_depths.count;
  extent->nearest_ndc_depth = NdcFromWindowDepth(
      convention, static_cast<double>(reversed ? visible_depths.largest : visible_depths.smallest));
  extent->farthest_ndc_depth = NdcFromWindowDepth(
      convention, static_cast<double>(reversed ? visible_depths.smallest : visible_depths.largest));

  active.Resize(0);
}

void FrameSampler::Workspace::SampleBoundary(const RaySpace& ray_space, uint32_t light_bit,
                                             LightScratch* light, LightSamples* samples) const {
  FindLightPixels(active, surfaces, planes.stride, ray_space, light_bit, &light->pixels);
  PackLight(planes, light_bit, &light->bits);
  samples->narrow_share = NarrowShare(visible, light->bits);
  FindEdgePatterns(visible, light->bits, active.index, light->pixels.hull, &light->patterns);
  FillSamples(surfaces, light->pixels, light->patterns, edge_directions, pixels_per_sample, ray_space,
              &light->textures, samples);
  samples->hull_in_shadow.resize(light->pixels.hull.size());
  for (size_t i = 0; i < samples->hull_in_shadow.size(); ++i) {
    const int32_t index = active.index[static_cast<size_t>(light->pixels.hull[i])];
    samples->hull_in_shadow[i] = (planes.bits[static_cast<size_t>(index)] & light_bit) != 0 ? 1 : 0;
  }
  texture_edges.Turn(&light->textures.boundary, ray_space.is_directional(), &samples->boundary);
  texture_edges.Turn(&light->textures.rough_boundary, ray_space.is_directional(), &samples->rough_boundary);
  texture_edges.Turn(&light->textures.unseen_boundary, ray_space.is_directional(), &samples->unseen_boundary);
}

PixelSurfaces FrameSampler::Workspace::Unproject(const Camera& camera, LaneList<int32_t> indices) const {
  PixelSurfaces pixels;
  indices.Pad(static_cast<int32_t>(planes.Index(0, 0)));
  UnprojectPixels(camera, planes, tolerance, indices, &pixels);
  return pixels;
}

void FrameSampler::Workspace::SampleEitherWay(const PixelSurfaces& pixels, const RaySpace& ray_space,
                                              double edges, LightScratch* light,
                                              LightSamples* samples) const {
  FindLitPixels(pixels, ray_space, &light->pixels, &light->lit);
  FillSamples(pixels, light->pixels, light->patterns, edge_directions, pixels_per_sample, ray_space,
              &light->textures, samples);
  samples->boundary.limit = kUnseenEdgeLimit;
  samples->boundary.Resize(2 * light->lit.size());
  for (size_t i = 0; i < light->lit.size(); ++i) {
    const auto at = static_cast<size_t>(light->lit[i]);
    const auto set = [&](size_t sample, const glm::dvec2& normal, double length) {
      samples->boundary.Set(sample, samples->hull_rays[at],
                            samples->hull_rays_dx1[at] * (1.0 / pixels_per_sample.x),
                            samples->hull_rays_dx2[at] * (1.0 / pixels_per_sample.y),
                            samples->hull_along_ray[at], normal, edges * length);
    };
    set(2 * i, {1.0, 0.0}, 0.5 * pixels_per_sample.y);
    set(2 * i + 1, {0.0, 1.0}, 0.5 * pixels_per_sample.x);
  }
}

void FrameSampler::Workspace::SampleAllVisible(const RaySpace& ray_space, LightScratch* light,
                                               LightSamples* samples) const {
  SampleEitherWay(surfaces, ray_space, 1.0, light, samples);
  samples->narrow_share = kCommonNarrowShare;
  samples->hull_in_shadow.assign(light->pixels.hull.size(), 1);  // Any of them may be.
}

FrameSampler::FrameSampler() : workspace_(std::make_unique<Workspace>()) {}
FrameSampler::~FrameSampler() = default;
FrameSampler::FrameSampler(FrameSampler&&) noexcept = default;
FrameSampler& FrameSampler::operator=(FrameSampler&&) noexcept = default;

void FrameSampler::Sample(const Camera& camera, const DepthView& depth, const std::optional<BitsView>& bits,
                          std::span<const RaySpace> ray_spaces, MapSize screen, FrameExtent* extent,
                          std::vector<LightSamples>* samples) {
  Workspace& work = *workspace_;
  work.Begin(camera, depth, screen, extent);
  samples->resize(ray_spaces.size());
  for (LightSamples& light : *samples) {
    light.source = SampleSource::kNone;
    light.boundary.limit = kEdgeLimit;
    light.unseen_boundary.limit = kUnseenEdgeLimit;
    light.pixels_per_sample = work.pixels_per_sample.x * work.pixels_per_sample.y;
  }

  const auto all_lights =
      static_cast<uint32_t>(ray_spaces.size() >= 32 ? ~uint32_t{0} : (uint32_t{1} << ray_spaces.size()) - 1);
  if (bits) {
    CopyBits(*bits, all_lights, &work.planes);
    PackVisible(work.planes, &work.visible);
    FindActivePixels(work.planes, work.tolerance, &work.active);
    UnprojectPixels(camera, work.planes, work.tolerance, work.active.index, &work.surfaces);
    work.texture_edges.Prepare(work.active.size());
    ForLights(ray_spaces.size(), [&](size_t i) {
      LightSamples& light = (*samples)[i];
      work.SampleBoundary(ray_spaces[i], uint32_t{1} << i, &work.scratch.local(), &light);
      if (light.boundary.size() > 0) light.source = SampleSource::kShadowBoundary;
    });
  }
  const bool all_served = std::all_of(samples->begin(), samples->end(), [](const LightSamples& light) {
    return light.source == SampleSource::kShadowBoundary;
  });
  if (!all_served) {
    const size_t stride =
        std::max<size_t>(1, static_cast<size_t>(extent->visible_pixels) / kMostFallbackSamples);
    ListVisiblePixels(work.planes, work.active, stride, &work.visible_pixels);
    UnprojectPixels(camera, work.planes, work.tolerance, work.visible_pixels.index, &work.surfaces);
    ForLights(ray_spaces.size(), [&](size_t i) {
      LightSamples& light = (*samples)[i];
      if (light.source == SampleSource::kShadowBoundary) return;
      work.SampleAllVisible(ray_spaces[i], &work.scratch.local(), &light);
      if (!light.hull_rays.empty()) light.source = SampleSource::kAllVisible;
    });
  }
}

double FrameSampler::ShadowOutside(const Camera& camera, const RaySpace& ray_space, size_t light,
                                   std::span<const ShadowProjection> projections) const {
  const Workspace& work = *workspace_;
  LaneList<int32_t> shadowed;
  FindShadowOutside(camera, work.planes, uint32_t{1} << light, ray_space, projections, &shadowed);
  LightPixels pixels;
  LaneList<int32_t> lit;
  FindLitPixels(work.Unproject(camera, std::move(shadowed)), ray_space, &pixels, &lit);
  // Those that face away are dark without any map.
  return static_cast<double>(pixels.hull.size()) * work.pixels_per_sample.x * work.pixels_per_sample.y;
}

BoundarySamples FrameSampler::LitSamples(const Camera& camera, const RaySpace& ray_space,
                                         size_t light) const {
  const Workspace& work = *workspace_;
  const PixelPlanes& planes = work.planes;
  const uint32_t light_bit = uint32_t{1} << light;
  LaneList<int32_t> unshadowed;
  for (int y = kLitStride / 2; y < planes.height; y += kLitStride) {
    for (int x = kLitStride / 2; x < planes.width; x += kLitStride) {
      const std::ptrdiff_t i = planes.Index(x, y);
      const bool in_shadow = (planes.bits[static_cast<size_t>(i)] & light_bit) != 0;
      if (planes.Visible(i) && !in_shadow) unshadowed.Append(static_cast<int32_t>(i));
    }
  }
  LightScratch scratch;
  LightSamples samples;
  work.SampleEitherWay(work.Unproject(camera, std::move(unshadowed)), ray_space, kLitEdges, &scratch,
                       &samples);
  return std::move(samples.boundary);
}

double FrameSampler::PlacesOfShadow(const Camera& camera, const RaySpace& ray_space, size_t light,
                                    const ShadowProjection& projection,
                                    std::span<const ShadowProjection> others, ShadowPlaces* places) const {
  const Workspace& work = *workspace_;
  PlaceShadow(camera, work.planes, uint32_t{1} << light, ray_space, projection, others, places);
  return kShadowRowStep * work.pixels_per_sample.x * work.pixels_per_sample.y;
}

}  // namespace shadowfit
