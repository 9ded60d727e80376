#include "tests/unit/frame/plain_sampler.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>

#include "core/frame/edge_pattern.h"
#include "core/math/clip_space.h"

namespace shadowfit::testing {
namespace {

constexpr float kNothing = std::numeric_limits<float>::quiet_NaN();

struct Step {
  int x, y;
  Step operator-() const { return {-x, -y}; }
};
constexpr std::array<Step, 4> kNeighbours = {{{-1, 0}, {1, 0}, {0, -1}, {0, 1}}};

struct Pixel {
  int x, y;
  Pixel operator+(Step step) const { return {x + step.x, y + step.y}; }
};

enum class Facing { kUnknown, kAway, kGrazing, kTowards };

struct Surface {
  glm::dvec3 position, dx1, dx2;
  glm::dvec3 normal;
  bool reliable;
};

class PlainSampler {
 public:
  PlainSampler(const Camera& camera, const DepthView& depth, const std::optional<BitsView>& bits,
               uint32_t lights, MapSize screen)
      : camera_(camera),
        depth_(depth),
        bits_(bits),
        lights_(lights),
        scale_(static_cast<double>(screen.width) / depth.width,
               static_cast<double>(screen.height) / depth.height),
        directions_(scale_) {
    const glm::dvec4 w_row = glm::transpose(camera.world_from_clip())[3];
    perspective_ = std::abs(w_row.x) + std::abs(w_row.y) + std::abs(w_row.z) > 1e-12 * std::abs(w_row.w);
    for (int y = 0; y < depth.height; ++y) {
      for (int x = 0; x < depth.width; ++x) inverse_distances_.push_back(InverseDistanceOf({x, y}));
    }
  }

  LightSamples Boundary(const RaySpace& space, uint32_t light) const {
    LightSamples samples;
    samples.pixels_per_sample = scale_.x * scale_.y;
    for (const Pixel& p : AllPixels()) {
      if (!Visible(p)) continue;
      bool differs = false;
      for (const Step step : kNeighbours)
        differs = differs || (Continuous(p, step) && Crosses(p, step, light));
      if (!differs && (Rim(p) & light) == 0) continue;
      const Facing facing = FacingOf(space, p);
      if (facing == Facing::kAway || (facing == Facing::kGrazing && !differs)) continue;
      AddHull(space, p, (Bits(p) & light) != 0, &samples);
      if (facing != Facing::kGrazing) AddEdges(space, p, facing, light, &samples);
    }
    if (samples.boundary.size() > 0) samples.source = SampleSource::kShadowBoundary;
    samples.narrow_share = NarrowShare(light);
    samples.unseen_boundary.limit = 1e4;
    return samples;
  }

  double NarrowShare(uint32_t light) const {
    const auto shadowed = [&](const Pixel& p) { return Visible(p) && (Bits(p) & light) != 0; };
    int runs = 0;
    int narrow = 0;
    for (const Pixel& p : AllPixels()) {
      for (const Step along : {Step{1, 0}, Step{0, 1}}) {
        if (!shadowed(p) || shadowed(p + Step{-along.x, -along.y})) continue;
        ++runs;
        narrow += shadowed(p + along) ? 0 : 1;
      }
    }
    return runs > 0 ? static_cast<double>(narrow) / runs : 0.0;
  }

  LightSamples AllVisible(const RaySpace& space) const {
    LightSamples samples;
    samples.pixels_per_sample = scale_.x * scale_.y;
    std::vector<Pixel> pixels, further;
    const std::vector<Pixel> all = AllPixels();
    const auto visible = static_cast<size_t>(
        std::count_if(all.begin(), all.end(), [this](const Pixel& p) { return Visible(p); }));
    const size_t stride = std::max<size_t>(1, visible / 2048);
    size_t seen = 0;
    for (const Pixel& p : all) {
      if (!Visible(p)) continue;
      const bool chosen = seen++ % stride == 0;
      uint32_t asked = Rim(p);
      bool at_end = false;
      for (const Step step : kNeighbours) {
        if (!Visible(p + step))
          at_end = true;
        else
          asked |= Bits(p) ^ Bits(p + step);
      }
      if (asked != 0)
        pixels.push_back(p);
      else if (chosen || at_end)
        further.push_back(p);
    }
    pixels.insert(pixels.end(), further.begin(), further.end());
    for (const Pixel& p : pixels) {
      const Facing facing = FacingOf(space, p);
      if (facing == Facing::kAway || facing == Facing::kGrazing) continue;
      AddHull(space, p, true, &samples);
      if (facing != Facing::kTowards) continue;
      AddSample(samples, {1.0, 0.0}, 0.5 * scale_.y, 0.0, &samples.boundary);
      AddSample(samples, {0.0, 1.0}, 0.5 * scale_.x, 0.0, &samples.boundary);
    }
    if (!samples.hull_rays.empty()) samples.source = SampleSource::kAllVisible;
    samples.boundary.limit = samples.unseen_boundary.limit = 1e4;
    return samples;
  }

 private:
  bool Inside(Pixel p) const { return p.x >= 0 && p.y >= 0 && p.x < depth_.width && p.y < depth_.height; }
  std::vector<Pixel> AllPixels() const {
    std::vector<Pixel> pixels;
    for (int y = 0; y < depth_.height; ++y) {
      for (int x = 0; x < depth_.width; ++x) pixels.push_back({x, y});
    }
    return pixels;
  }
  uint32_t Bits(Pixel p) const { return bits_ && Inside(p) ? bits_->At(p.x, p.y) & lights_ : 0; }

  float InverseDistanceOf(Pixel p) const {
    const float value = depth_.At(p.x, p.y);
    const auto background = static_cast<float>(BackgroundWindowDepth(camera_.clip_depth()));
    if (!(value >= 0.0f && value <= 1.0f) || value == background) return kNothing;
    const double ndc_per_depth =
        NdcFromWindowDepth(camera_.clip_depth(), 1.0) - NdcFromWindowDepth(camera_.clip_depth(), 0.0);
    const float beyond = value - background;
    if (!perspective_) return static_cast<float>(ndc_per_depth) * beyond;
    const glm::dvec4 w_row = glm::transpose(camera_.world_from_clip())[3];
    const double ndc_background = NdcFromWindowDepth(camera_.clip_depth(), background);
    const double y_part = w_row.y * ((2.0 * p.y + 1.0) / depth_.height - 1.0);
    const double x_part = w_row.x * ((2.0 * p.x + 1.0) / depth_.width - 1.0);
    const double inverse =
        x_part + y_part + w_row.w + w_row.z * (ndc_background + ndc_per_depth * static_cast<double>(beyond));
    return inverse > 0.0 ? static_cast<float>(inverse) : kNothing;
  }
  float At(Pixel p) const {
    return Inside(p) ? inverse_distances_[static_cast<size_t>(p.y) * static_cast<size_t>(depth_.width) +
                                          static_cast<size_t>(p.x)]
                     : kNothing;
  }
  bool Visible(Pixel p) const { return !std::isnan(At(p)); }

  /// Above 1: a discontinuity.
  float Bend(Pixel p, Step step) const {
    const double pixel_width = glm::length(glm::dvec3(camera_.world_from_clip()[0])) * 2.0 / depth_.width;
    const float tolerance =
        perspective_
            ? 0.01f * At(p)
            : static_cast<float>(8.0 * pixel_width / glm::length(glm::dvec3(camera_.world_from_clip()[2])));
    return std::abs(At(p + -step) - 2.0f * At(p) + At(p + step)) / tolerance;
  }
  bool Continuous(Pixel p, Step step) const { return Bend(p, step) <= 1.0f || Bend(p + step, step) <= 1.0f; }
  bool Crosses(Pixel p, Step step, uint32_t light) const {
    return Visible(p + step) && ((Bits(p) ^ Bits(p + step)) & light) != 0;
  }
  uint32_t Rim(Pixel p) const {
    const bool inner = p.x % 8 == 4 && p.y % 8 == 4;
    const bool rim =
        std::any_of(kNeighbours.begin(), kNeighbours.end(), [&](Step step) { return !Continuous(p, step); });
    return inner || rim ? Bits(p) : 0;
  }

  double NdcDepth(Pixel p) const {
    return NdcFromWindowDepth(camera_.clip_depth(), static_cast<double>(depth_.At(p.x, p.y)));
  }
  std::optional<double> DepthDerivative(Pixel p, Step step) const {
    const float central = Bend(p, step);
    const float forward = Bend(p + step, step);
    const float backward = Bend(p + -step, step);
    const bool creased = central > 0.02f && (forward < 0.25f * central || backward < 0.25f * central);
    if (central <= 1.0f && !creased) return 0.5 * (NdcDepth(p + step) - NdcDepth(p + -step));
    if (forward <= 1.0f && !(backward < forward)) return NdcDepth(p + step) - NdcDepth(p);
    if (backward <= 1.0f) return NdcDepth(p) - NdcDepth(p + -step);
    return std::nullopt;
  }
  Surface SurfaceOf(Pixel p) const {
    const glm::dvec2 size(depth_.width, depth_.height);
    const glm::dvec2 ndc = (glm::dvec2(p.x, p.y) + 0.5) * 2.0 / size - 1.0;
    const std::optional<double> dz1 = DepthDerivative(p, {1, 0});
    const std::optional<double> dz2 = DepthDerivative(p, {0, 1});
    const glm::dvec4 point = camera_.WsFromNdc({ndc, NdcDepth(p)});
    Surface surface;
    surface.position = glm::dvec3(point) / point.w;
    const auto derivative = [&](const glm::dvec3& dndc) {
      const glm::dvec4 change = camera_.world_from_clip() * glm::dvec4(dndc, 0.0);
      return (glm::dvec3(change) - surface.position * change.w) / point.w;
    };
    surface.dx1 = derivative({2.0 / size.x, 0.0, dz1.value_or(0.0)});
    surface.dx2 = derivative({0.0, 2.0 / size.y, dz2.value_or(0.0)});
    const glm::dvec3 normal = glm::cross(surface.dx1, surface.dx2);
    const double length = glm::length(normal);
    surface.reliable = dz1 && dz2 && length > 0.0 && std::isfinite(length);
    const bool turned = glm::dot(normal, camera_.TowardsViewer(surface.position)) < 0.0;
    surface.normal = (turned ? -normal : normal) / length;
    return surface;
  }

  static double Cosine(const RaySpace& space, const Surface& surface) {
    return glm::dot(surface.normal, glm::normalize(space.TowardsLight(surface.position)));
  }
  Facing FacingOf(const RaySpace& space, Pixel p) const {
    const Surface surface = SurfaceOf(p);
    if (!space.Illuminates(surface.position)) return Facing::kAway;
    if (!surface.reliable) return Facing::kUnknown;
    const double cosine = Cosine(space, surface);
    return cosine > 0.0005 ? Facing::kTowards : cosine > 0.0 ? Facing::kGrazing : Facing::kAway;
  }

  void AddHull(const RaySpace& space, Pixel p, bool in_shadow, LightSamples* samples) const {
    const Surface surface = SurfaceOf(p);
    samples->hull_in_shadow.push_back(in_shadow ? 1 : 0);
    samples->hull_rays.push_back(space.RayFromPoint(surface.position));
    samples->hull_along_ray.push_back(space.AlongRay(surface.position));
    samples->hull_rays_dx1.push_back(space.RayFromVector(surface.dx1));
    samples->hull_rays_dx2.push_back(space.RayFromVector(surface.dx2));
  }
  /// At the last hull sample.
  void AddSample(const LightSamples& hull, const glm::dvec2& normal, double length, double tail,
                 BoundarySamples* to) const {
    to->Add(hull.hull_rays.back(), hull.hull_rays_dx1.back() / scale_.x, hull.hull_rays_dx2.back() / scale_.y,
            hull.hull_along_ray.back(), normal, length, tail);
  }

  void AddEdges(const RaySpace& space, Pixel p, Facing facing, uint32_t light, LightSamples* samples) const {
    double crossings = 0, discontinuous = 0, terminators = 0, away = 0;
    size_t supports = 0;
    for (const Step step : kNeighbours) {
      const bool continuous = Continuous(p, step);
      if (!Crosses(p, step, light)) {
        if (continuous) ++supports;
        continue;
      }
      const Facing other = FacingOf(space, p + step);
      if (other == Facing::kAway || other == Facing::kGrazing) {
        ++away;
      } else if (!continuous || facing != Facing::kTowards || other != Facing::kTowards) {
        ++discontinuous;
      } else {
        const double next = 2.0 * Cosine(space, SurfaceOf(p)) - Cosine(space, SurfaceOf(p + step));
        ++(next > 0.0 ? crossings : terminators);
      }
    }
    const std::array<double, 4> edges = {0.53, 0.43, 0.29, 0.19};
    const bool lit_beside = crossings + discontinuous + terminators > 0;
    const double rough = discontinuous * edges[std::min<size_t>(supports, 3)] + terminators * 0.32 +
                         away * (lit_beside ? 0.32 : 0.05);
    const double tail = IsWide(p, light) ? 0.05 : 0.0;
    if (crossings > 0) AddEdge(space, p, light, crossings, tail, *samples, &samples->boundary);
    if (rough > 0) AddEdge(space, p, light, rough, tail, *samples, &samples->rough_boundary);
    if (crossings + rough == 0 && (Rim(p) & light) != 0) {
      AddTexture(space, 0.01, 0.0, *samples, &samples->unseen_boundary);
    }
  }

  /// Whether shadow or light go on for three samples from all edges here.
  bool IsWide(Pixel p, uint32_t light) const {
    return std::all_of(kNeighbours.begin(), kNeighbours.end(), [&](Step step) {
      const Pixel behind = p + -step;
      return !Crosses(p, step, light) || (Continuous(p, -step) && ((Bits(p) ^ Bits(behind)) & light) == 0 &&
                                          ((Bits(p) ^ Bits(behind + -step)) & light) == 0);
    });
  }

  void AddEdge(const RaySpace& space, Pixel p, uint32_t light, double crossings, double tail,
               const LightSamples& hull, BoundarySamples* to) const {
    const auto bit = [&](int dx, int dy) {
      const Pixel at = p + Step{dx, dy};
      return (Bits(Visible(at) ? at : p) & light) != 0 ? 1 : 0;
    };
    int differences = 0;
    double xx = 0.0, xy = 0.0, yy = 0.0;
    for (int y = -2; y < 2; ++y) {
      for (int x = -2; x < 2; ++x) {
        differences += (bit(x, y) ^ bit(x + 1, y)) + (bit(x, y) ^ bit(x, y + 1));
        const double gx = bit(x + 1, y) + bit(x + 1, y + 1) - bit(x, y) - bit(x, y + 1);
        const double gy = bit(x, y + 1) + bit(x + 1, y + 1) - bit(x, y) - bit(x + 1, y);
        xx += gx * gx;
        xy += gx * gy;
        yy += gy * gy;
      }
    }
    const bool is_texture = differences >= 0.3 * 32 && std::hypot(xx - yy, 2.0 * xy) < 0.5 * (xx + yy);
    if (!is_texture) {
      // Sums of whole gradients, exactly: xx - yy = 4 sum ge.
      const auto ge = static_cast<int32_t>(std::lround((xx - yy) / 4.0));
      const EdgeDirection& edge =
          directions_.data()[EdgePatternOf(ge, static_cast<int32_t>(std::lround(xy)))];
      AddSample(hull, edge.normal, crossings * edge.length_per_crossing, tail, to);
      return;
    }
    AddTexture(space, crossings, tail, hull, to);
  }

  void AddTexture(const RaySpace& space, double crossings, double tail, const LightSamples& hull,
                  BoundarySamples* to) const {
    AddSample(hull, {1.0, 0.0}, crossings * 0.25 * (scale_.x + scale_.y), tail, to);
    TurnTexture(space, to->size() - 1, to);
  }

  static void TurnTexture(const RaySpace& space, size_t i, BoundarySamples* samples) {
    const glm::dvec3 ray = samples->Ray(i);
    glm::dvec3 b1(1, 0, 0);
    glm::dvec3 b2(0, 1, 0);
    if (!space.is_directional()) {
      const glm::dvec3 helper = std::abs(ray.x) < std::abs(ray.z) ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 0, 1);
      b1 = glm::normalize(glm::cross(helper, ray));
      b2 = glm::normalize(glm::cross(ray, b1));
    }
    const glm::dvec2 a1(glm::dot(b1, samples->RayDx1(i)), glm::dot(b2, samples->RayDx1(i)));
    const glm::dvec2 a2(glm::dot(b1, samples->RayDx2(i)), glm::dot(b2, samples->RayDx2(i)));
    const double angle = static_cast<double>(i) * std::numbers::pi * std::numbers::phi;
    const glm::dvec2 m(std::cos(angle), std::sin(angle));
    const glm::dvec2 across(glm::dot(m, a1), glm::dot(m, a2));
    const double edges = 2.0;
    const double c =
        0.5 * std::numbers::pi * edges * samples->length[i] / (glm::length(a1) + glm::length(a2));
    if (!(glm::length(across) > 0.0) || !std::isfinite(c * glm::length(across))) return;
    samples->n1[i] = across.x / glm::length(across);
    samples->n2[i] = across.y / glm::length(across);
    samples->length[i] = c * glm::length(across);
  }

  const Camera& camera_;
  const DepthView& depth_;
  const std::optional<BitsView>& bits_;
  const uint32_t lights_;
  const glm::dvec2 scale_;
  const EdgeDirections directions_;
  bool perspective_ = true;
  std::vector<float> inverse_distances_;
};

}  // namespace

std::vector<LightSamples> SamplePlainly(const Camera& camera, const DepthView& depth,
                                        const std::optional<BitsView>& bits,
                                        std::span<const RaySpace> ray_spaces, MapSize screen) {
  const uint32_t lights = ~uint32_t{0} >> (32 - ray_spaces.size());
  const PlainSampler sampler(camera, depth, bits, lights, screen);
  std::vector<LightSamples> samples;
  for (size_t i = 0; i < ray_spaces.size(); ++i) {
    if (bits) samples.push_back(sampler.Boundary(ray_spaces[i], uint32_t{1} << i));
    if (!bits || samples[i].source == SampleSource::kNone) {
      samples.resize(i);
      samples.push_back(sampler.AllVisible(ray_spaces[i]));
    }
  }
  return samples;
}

}  // namespace shadowfit::testing
