#include "core/frame/frame_sampler.h"

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <utility>

#include "core/frame/edge_pattern.h"
#include "core/frame/for_lights.h"
#include "core/frame/pixel_scan.h"
#include "core/frame/pixel_surfaces.h"

namespace shadowfit {
namespace {

// Relative change of view distance beyond a pixel's linear prediction that counts as a depth discontinuity.
// On planes the prediction is exact; smooth surfaces stay far below this at any useful resolution.
constexpr float kDiscontinuity = 0.01f;

// Under an orthographic camera, where view distance has no scale of its own: the same in pixel widths.
constexpr double kOrthographicDiscontinuityPixels = 8.0;

// Cosine between normal and light below which a surface counts as grazing: its bits flip with the
// tessellation, not with a caster's edge. What is grazing need not be in the map, so that this is no more
// than rounding: ground under a low sun is seen, and lost as a whole where it does not count.
constexpr double kGrazingCosine = 0.0005;

// Chance that a crossing (neighbours of different bits) which is no plain one stands for a shadow's edge: its
// share of wrong pixels to that of plain ones, counted against rays in three scenes (study_edges). Beside a
// discontinuity it depends on how many of a sample's neighbours go on with its surface in the same light: a
// leaf has none, and an object that stands whole in shadow before a lit ground all but one.
constexpr std::array<double, 4> kChanceBesideDiscontinuity = {0.33, 0.27, 0.18, 0.12};
// At a terminator, and beside a surface that faces away from the light, whose bit means nothing: where some
// other neighbour is lit, and where all that is seen of the light's work is shadow.
constexpr double kChanceAtTerminator = 0.2;
constexpr double kChanceInTheDark = 0.03;

// Steps between the pixels inside of shadows that the map must hold, too.
constexpr int kInnerStride = 8;

// Pixels to stand in for a shadow boundary where there is none; more would add time and no information.
constexpr size_t kMostFallbackSamples = 2048;

enum class Facing : uint8_t { kUnknown, kAway, kGrazing, kTowards };

Facing FacingOf(double cosine, bool reliable) {
  if (cosine == kUnlit) return Facing::kAway;
  if (!reliable) return Facing::kUnknown;
  return cosine > kGrazingCosine ? Facing::kTowards : cosine > 0.0 ? Facing::kGrazing : Facing::kAway;
}

/// A boundary sample to be: which hull sample it lies at, and its edge.
struct EdgeAtHull {
  size_t hull;
  glm::dvec2 normal;
  double length;    ///< Of a texture: the sum of its edges' extents along x and y.
  bool is_texture;  ///< The normal means nothing.
  double inverse_limit;
};

/// Working memory of one light at a time.
struct LightScratch {
  PixelList concerned;                 ///< Active pixels that the light asks for.
  std::vector<double> listed_cosines;  ///< Of these.
  std::vector<double> cosine;          ///< By active pixel, of those concerned.
  std::vector<Facing> facing;          ///< Likewise.
  PixelList hull;                      ///< Active pixels that become hull samples.
  std::vector<EdgeAtHull> edges;
  std::vector<EdgeAtHull> rough_edges;
  PackedBits bits;

  void Clear() {
    concerned.Clear();
    hull.Clear();
    edges.clear();
    rough_edges.clear();
  }
};

}  // namespace

struct FrameSampler::Workspace {
  // Per frame.
  const Camera* camera = nullptr;
  DepthView depth;
  glm::dvec2 pixels_per_sample{0.0};  ///< Final-screen pixels per low-resolution pixel.
  EdgeDirections edge_directions;     ///< For pixels_per_sample.
  BendTolerance tolerance;
  double ndc_per_depth = 1.0;  ///< NDC depth per window depth.

  // Per pixel.
  PixelPlanes planes;
  std::vector<int32_t> active_of_pixel;  ///< -1 where there is none.
  /// Every kInnerStride-th of every kInnerStride-th row. The light's picture of a shadow may reach beyond
  /// that of its outline, where the surface folds and where it surrounds the light.
  std::vector<int32_t> inner_pixels;
  std::vector<int32_t> boundary_candidates, candidates;
  PackedBits visible;

  // Per active pixel: one that some light needs.
  std::vector<int32_t> active_pixels;
  std::vector<uint32_t> active_crossing;  ///< Lights whose bit differs from a visible neighbour's.
  std::vector<uint32_t>
      active_differing;  ///< Lights whose bit differs from a neighbour's on the same surface.
  /// Lights whose shadow reaches the screen border or a discontinuity here, or that sample its inside here.
  std::vector<uint32_t> active_rim;
  std::vector<std::array<uint32_t, 4>> active_crossings;  ///< The same for neighbour k alone.
  std::vector<uint8_t> active_continuous;                 ///< Bit k: the surface goes on to neighbour k.
  PixelDepths active_depths;
  PixelSurfaces surfaces;

  // Lights are sampled side by side.
  tbb::enumerable_thread_specific<LightScratch> scratch;

  void Begin(const Camera& frame_camera, const DepthView& frame_depth, MapSize screen, FrameExtent* extent);
  /// Steps to the four neighbours in the planes: along x, then along y.
  std::array<std::ptrdiff_t, 4> Neighbours() const { return {-1, 1, -planes.stride, planes.stride}; }
  /// Magnitude of the second difference of inverse distance over the tolerance: above 1 is a discontinuity,
  /// NaN beside pixels without a surface.
  float Bend(std::ptrdiff_t i, std::ptrdiff_t step) const {
    const float here = planes.At(i);
    return std::abs(planes.At(i - step) - (here + here) + planes.At(i + step)) / tolerance.At(here);
  }
  bool Smooth(std::ptrdiff_t i, std::ptrdiff_t step) const {
    const float here = planes.At(i);
    return std::abs(planes.At(i - step) - (here + here) + planes.At(i + step)) <= tolerance.At(here);
  }
  /// True where the surface goes on from a pixel to its visible neighbour: either side predicts the other.
  bool Continuous(std::ptrdiff_t i, std::ptrdiff_t step) const {
    return Smooth(i, step) || Smooth(i + step, step);
  }
  void AddActive(std::ptrdiff_t i, const std::array<uint32_t, 4>& crossings, uint32_t differing, uint32_t rim,
                 uint8_t continuous);
  /// Neighbour k of an active pixel, where some bit differs from its own: both are active.
  size_t ActiveNeighbour(size_t active, size_t k) const {
    return static_cast<size_t>(active_of_pixel[static_cast<size_t>(active_pixels[active] + Neighbours()[k])]);
  }
  void FindActive();
  void AddAllVisible(size_t stride);
  void UnprojectActive();
  /// Derivative of NDC depth along an axis; false where neither side can be trusted.
  bool DepthDerivative(int x, int y, int dx, int dy, double* derivative) const;
  /// Fills cosine and facing of the pixels in `concerned`.
  void JudgeFacing(const RaySpace& ray_space, LightScratch* light) const;
  /// A light's bits in the window around a pixel.
  uint32_t BitsAround(std::ptrdiff_t i, const PackedBits& light) const;
  void SampleBoundary(const RaySpace& ray_space, uint32_t light_bit, LightScratch* light,
                      LightSamples* samples) const;
  void SampleAllVisible(const RaySpace& ray_space, LightScratch* light, LightSamples* samples) const;
  /// Makes the samples of `hull`, `edges` and `rough_edges`.
  void MakeSamples(const RaySpace& ray_space, LightScratch* light, LightSamples* samples) const;
};

void FrameSampler::Workspace::Begin(const Camera& frame_camera, const DepthView& frame_depth, MapSize screen,
                                    FrameExtent* extent) {
  camera = &frame_camera;
  depth = frame_depth;
  const int width = frame_depth.width;
  const int height = frame_depth.height;
  const glm::dvec2 scale(static_cast<double>(screen.width) / width,
                         static_cast<double>(screen.height) / height);
  if (scale != pixels_per_sample) {
    pixels_per_sample = scale;
    edge_directions = EdgeDirections(scale);
  }

  const ClipDepth convention = frame_camera.clip_depth();
  const glm::dmat4& world_from_clip = frame_camera.world_from_clip();
  const glm::dvec4 w_row = glm::transpose(world_from_clip)[3];
  const bool perspective =
      std::abs(w_row.x) + std::abs(w_row.y) + std::abs(w_row.z) > 1e-12 * std::abs(w_row.w);
  const double background = BackgroundWindowDepth(convention);
  ndc_per_depth = NdcFromWindowDepth(convention, 1.0) - NdcFromWindowDepth(convention, 0.0);
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

  if (planes.width != width || planes.height != height) {
    planes.Resize(width, height);
    inner_pixels.clear();
    for (int y = kInnerStride / 2; y < height; y += kInnerStride) {
      for (int x = kInnerStride / 2; x < width; x += kInnerStride) {
        inner_pixels.push_back(static_cast<int32_t>(planes.Index(x, y)));
      }
    }
  }
  const VisibleDepths visible = ScanDepth(frame_depth, law, &planes);
  const bool reversed = convention == ClipDepth::kReversedZeroToOne;
  extent->visible_pixels = visible.count;
  extent->nearest_ndc_depth =
      NdcFromWindowDepth(convention, static_cast<double>(reversed ? visible.largest : visible.smallest));
  extent->farthest_ndc_depth =
      NdcFromWindowDepth(convention, static_cast<double>(reversed ? visible.smallest : visible.largest));

  active_of_pixel.assign(planes.inverse_distance.size(), -1);
  active_pixels.clear();
  active_crossings.clear();
  active_crossing.clear();
  active_differing.clear();
  active_rim.clear();
  active_continuous.clear();
}

void FrameSampler::Workspace::AddActive(std::ptrdiff_t i, const std::array<uint32_t, 4>& crossings,
                                        uint32_t differing, uint32_t rim, uint8_t continuous) {
  active_of_pixel[static_cast<size_t>(i)] = static_cast<int32_t>(active_pixels.size());
  active_pixels.push_back(static_cast<int32_t>(i));
  active_crossings.push_back(crossings);
  active_crossing.push_back(crossings[0] | crossings[1] | crossings[2] | crossings[3]);
  active_differing.push_back(differing);
  active_rim.push_back(rim);
  active_continuous.push_back(continuous);
}

void FrameSampler::Workspace::FindActive() {
  // All in the order of their places, whichever lights ask for them: a light's samples come in the same order
  // with other lights and without.
  const std::span<const int32_t> boundary = FindBoundaryCandidates(planes, tolerance, &boundary_candidates);
  candidates.clear();
  std::ranges::set_union(boundary, inner_pixels, std::back_inserter(candidates));
  auto next_inner = inner_pixels.begin();
  for (const int32_t i : candidates) {
    const bool is_inner = next_inner != inner_pixels.end() && *next_inner == i;
    if (is_inner) ++next_inner;
    if (!planes.Visible(i)) continue;
    const uint32_t here = planes.Bits(i);
    uint32_t differing = 0;
    uint32_t rim = is_inner ? here : 0;
    uint32_t crossing = 0;
    uint8_t continuous = 0;
    std::array<uint32_t, 4> crossings{};
    const std::array<std::ptrdiff_t, 4> neighbours = Neighbours();
    for (size_t k = 0; k < neighbours.size(); ++k) {
      const std::ptrdiff_t step = neighbours[k];
      const bool visible = planes.Visible(i + step);
      if (visible) crossings[k] = here ^ planes.Bits(i + step);
      crossing |= crossings[k];
      if (!visible || !Continuous(i, step)) {
        rim |= here;
      } else {
        differing |= crossings[k];
        continuous = static_cast<uint8_t>(continuous | (1u << k));
      }
    }
    if ((crossing | rim) != 0) AddActive(i, crossings, differing, rim, continuous);
  }
}

void FrameSampler::Workspace::AddAllVisible(size_t stride) {
  // Every stride-th visible pixel, row by row, and every visible pixel at the rim of a surface or of the
  // screen: the latter make the hull.
  size_t seen = 0;
  for (int y = 0; y < planes.height; ++y) {
    for (int x = 0; x < planes.width; ++x) {
      const std::ptrdiff_t i = planes.Index(x, y);
      if (!planes.Visible(i)) continue;
      const bool chosen = seen++ % stride == 0;
      bool rim = false;
      for (const std::ptrdiff_t step : Neighbours()) rim = rim || !planes.Visible(i + step);
      if ((chosen || rim) && active_of_pixel[static_cast<size_t>(i)] < 0) AddActive(i, {}, 0, 0, 0);
    }
  }
}

bool FrameSampler::Workspace::DepthDerivative(int x, int y, int dx, int dy, double* derivative) const {
  const std::ptrdiff_t i = planes.Index(x, y);
  const std::ptrdiff_t step = dx + dy * planes.stride;
  // NDC depth is an affine function of window depth.
  const auto difference = [&](int to, int from) {
    return ndc_per_depth * (static_cast<double>(depth.At(x + to * dx, y + to * dy)) -
                            static_cast<double>(depth.At(x + from * dx, y + from * dy)));
  };
  *derivative = 0.0;
  if (Smooth(i, step)) {
    *derivative = 0.5 * difference(1, -1);
    return true;
  }
  // A side is trusted where the neighbour's own bend is small. Bends are NaN beside pixels without a surface
  // and where a camera's entries are extreme: those fail every comparison, and never choose a side.
  constexpr float kNoSide = std::numeric_limits<float>::infinity();
  const float forward = planes.Visible(i + step) ? Bend(i + step, step) : kNoSide;
  const float backward = planes.Visible(i - step) ? Bend(i - step, step) : kNoSide;
  const bool use_forward = forward <= 1.0f && !(backward < forward);
  if (!use_forward && !(backward <= 1.0f)) return false;
  *derivative = use_forward ? difference(1, 0) : difference(0, -1);
  return true;
}

void FrameSampler::Workspace::UnprojectActive() {
  active_depths.Clear();
  active_depths.Reserve(active_pixels.size());
  const auto stride = static_cast<uint32_t>(planes.stride);
  for (const int32_t i : active_pixels) {
    const auto index = static_cast<uint32_t>(i);
    const int y = static_cast<int>(index / stride) - 1;
    const int x = static_cast<int>(index % stride) - 1;
    active_depths.ndc[0].push_back((x + 0.5) * 2.0 / planes.width - 1.0);
    active_depths.ndc[1].push_back((y + 0.5) * 2.0 / planes.height - 1.0);
    active_depths.ndc[2].push_back(
        NdcFromWindowDepth(camera->clip_depth(), static_cast<double>(depth.At(x, y))));
    double dz1 = 0.0;
    double dz2 = 0.0;
    const bool known1 = DepthDerivative(x, y, 1, 0, &dz1);
    const bool known2 = DepthDerivative(x, y, 0, 1, &dz2);
    active_depths.dz1.push_back(dz1);
    active_depths.dz2.push_back(dz2);
    active_depths.reliable.push_back(known1 && known2 ? 1 : 0);
  }
  UnprojectPixels(*camera, planes.width, planes.height, active_depths, &surfaces);
}

void FrameSampler::Workspace::JudgeFacing(const RaySpace& ray_space, LightScratch* light) const {
  light->cosine.resize(surfaces.size());
  light->facing.resize(surfaces.size());
  light->concerned.Pad();
  LightCosines(surfaces, light->concerned, ray_space, &light->listed_cosines);
  for (size_t k = 0; k < light->concerned.size(); ++k) {
    const size_t active = light->concerned[k];
    light->cosine[active] = light->listed_cosines[k];
    light->facing[active] = FacingOf(light->listed_cosines[k], surfaces.reliable[active] != 0);
  }
}

uint32_t FrameSampler::Workspace::BitsAround(std::ptrdiff_t i, const PackedBits& light) const {
  const auto x = static_cast<int>(i % planes.stride) - 1;
  const auto y = static_cast<int>(i / planes.stride) - 1;
  // Where there is no surface, light and shadow go on.
  const uint32_t seen = visible.Around(x, y);
  const uint32_t bits = light.Around(x, y);
  return (bits & seen) | ((bits >> kMiddleOfWindow & 1u) != 0 ? ~seen & kWholeWindow : 0u);
}

void FrameSampler::Workspace::MakeSamples(const RaySpace& ray_space, LightScratch* light,
                                          LightSamples* samples) const {
  light->hull.Pad();
  FillHull(surfaces, light->hull, ray_space, samples);
  const auto add = [&](const std::vector<EdgeAtHull>& from, BoundarySamples* to) {
    const glm::dvec2 samples_per_pixel = 1.0 / pixels_per_sample;
    to->Resize(from.size());
    for (size_t i = 0; i < from.size(); ++i) {
      const EdgeAtHull& edge = from[i];
      const glm::dvec3& ray = samples->hull_rays[edge.hull];
      const glm::dvec3 dx1 = samples->hull_rays_dx1[edge.hull] * samples_per_pixel.x;
      const glm::dvec3 dx2 = samples->hull_rays_dx2[edge.hull] * samples_per_pixel.y;
      glm::dvec2 normal = edge.normal;
      double length = edge.length;
      if (edge.is_texture) {
        const TextureEdge texture = TextureEdgeOf(i, length, ray_space.is_directional(), ray, dx1, dx2);
        normal = texture.normal;
        length = texture.length;
      }
      to->Set(i, ray, dx1, dx2, samples->hull_along_ray[edge.hull], normal, length, edge.inverse_limit);
    }
  };
  add(light->edges, &samples->boundary);
  add(light->rough_edges, &samples->rough_boundary);
}

void FrameSampler::Workspace::SampleBoundary(const RaySpace& ray_space, uint32_t light_bit,
                                             LightScratch* light, LightSamples* samples) const {
  light->Clear();
  PixelList& concerned = light->concerned;
  PixelList& hull = light->hull;
  const std::vector<double>& cosine = light->cosine;
  const std::vector<Facing>& facing = light->facing;
  for (size_t i = 0; i < active_pixels.size(); ++i) {
    if (((active_crossing[i] | active_rim[i]) & light_bit) != 0) concerned.Add(i);
  }
  JudgeFacing(ray_space, light);
  PackLight(planes, light_bit, &light->bits);
  // Where a share p of a pixel is in shadow at random, a map that resolves nothing is wrong in 2 p (1 - p) of
  // it, a third in the mean over p.
  const double most_wrong = pixels_per_sample.x * pixels_per_sample.y / 3.0;
  // A crossing between two pixels side by side is an edge as high as a pixel, half of it each one's; between
  // two upon another, as wide.
  const double mean_extent = 0.25 * (pixels_per_sample.x + pixels_per_sample.y);
  for (size_t listed = 0; listed < concerned.size(); ++listed) {
    const size_t i = concerned[listed];
    if (facing[i] == Facing::kAway) continue;
    // Lit and beside a discontinuity: what is in shadow there has the edge, if there is one.
    if (((active_differing[i] | active_rim[i]) & light_bit) == 0) continue;
    const bool differs = (active_differing[i] & light_bit) != 0;
    if (!differs && facing[i] == Facing::kGrazing) continue;
    const size_t at_hull = hull.size();
    hull.Add(i);
    if (facing[i] == Facing::kGrazing) continue;

    int crossings = 0;
    int discontinuous_crossings = 0;
    int terminators = 0;
    int away_crossings = 0;
    int supports = 0;
    for (size_t k = 0; k < 4; ++k) {
      const bool continuous = (active_continuous[i] >> k & 1) != 0;
      if ((active_crossings[i][k] & light_bit) == 0) {
        if (continuous) ++supports;
        continue;
      }
      const size_t neighbour = ActiveNeighbour(i, k);
      if (facing[neighbour] == Facing::kAway || facing[neighbour] == Facing::kGrazing) {
        ++away_crossings;
      } else if (!continuous || facing[i] != Facing::kTowards || facing[neighbour] != Facing::kTowards) {
        ++discontinuous_crossings;
      } else {
        // At a terminator the light's cosine, carried on at the same rate, reaches zero within a step.
        ++(2.0 * cosine[i] - cosine[neighbour] > 0.0 ? crossings : terminators);
      }
    }
    const bool lit_beside = crossings + discontinuous_crossings + terminators > 0;
    const double rough_crossings =
        discontinuous_crossings * kChanceBesideDiscontinuity[static_cast<size_t>(std::min(supports, 3))] +
        terminators * kChanceAtTerminator +
        away_crossings * (lit_beside ? kChanceAtTerminator : kChanceInTheDark);
    if (crossings == 0 && rough_crossings == 0.0) continue;
    const uint32_t window = BitsAround(active_pixels[i], light->bits);
    const EdgeDirection& edge = edge_directions.Of(window);
    const bool is_texture = IsTexture(window);
    const double length = is_texture ? mean_extent : edge.length_per_crossing;
    if (crossings > 0) {
      light->edges.push_back({at_hull, edge.normal, crossings * length, is_texture, 0.0});
    }
    if (rough_crossings > 0.0) {
      light->rough_edges.push_back(
          {at_hull, edge.normal, rough_crossings * length, is_texture, 4.0 / (rough_crossings * most_wrong)});
    }
  }
  MakeSamples(ray_space, light, samples);
}

void FrameSampler::Workspace::SampleAllVisible(const RaySpace& ray_space, LightScratch* light,
                                               LightSamples* samples) const {
  light->Clear();
  PixelList& hull = light->hull;
  const std::vector<Facing>& facing = light->facing;
  for (size_t i = 0; i < active_pixels.size(); ++i) light->concerned.Add(i);
  JudgeFacing(ray_space, light);
  for (size_t i = 0; i < active_pixels.size(); ++i) {
    if (facing[i] == Facing::kAway || facing[i] == Facing::kGrazing) continue;
    const size_t at_hull = hull.size();
    hull.Add(i);
    if (facing[i] != Facing::kTowards) continue;
    // An edge could run either way.
    light->edges.push_back({at_hull, {1.0, 0.0}, 0.5 * pixels_per_sample.y, false, 0.0});
    light->edges.push_back({at_hull, {0.0, 1.0}, 0.5 * pixels_per_sample.x, false, 0.0});
  }
  MakeSamples(ray_space, light, samples);
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
    light.Clear();
    light.pixels_per_sample = work.pixels_per_sample.x * work.pixels_per_sample.y;
  }

  const auto all_lights =
      static_cast<uint32_t>(ray_spaces.size() >= 32 ? ~uint32_t{0} : (uint32_t{1} << ray_spaces.size()) - 1);
  if (bits) {
    CopyBits(*bits, all_lights, &work.planes);
    PackVisible(work.planes, &work.visible);
    work.FindActive();
    work.UnprojectActive();
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
    work.AddAllVisible(stride);
    work.UnprojectActive();
    ForLights(ray_spaces.size(), [&](size_t i) {
      LightSamples& light = (*samples)[i];
      if (light.source == SampleSource::kShadowBoundary) return;
      light.Clear();
      work.SampleAllVisible(ray_spaces[i], &work.scratch.local(), &light);
      if (!light.hull_rays.empty()) light.source = SampleSource::kAllVisible;
    });
  }
}

}  // namespace shadowfit
