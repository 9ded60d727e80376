#include "core/frame/frame_sampler.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

namespace shadowfit {
namespace {

// Relative change of view distance beyond a pixel's linear prediction that counts as a depth discontinuity.
// On planes the prediction is exact; smooth surfaces stay far below this at any useful resolution.
constexpr float kDiscontinuity = 0.01f;

// Under an orthographic camera, where view distance has no scale of its own: the same in pixel widths.
constexpr double kOrthographicDiscontinuityPixels = 8.0;

// Cosine between normal and light below which a surface counts as grazing: its bits flip with the
// tessellation, not with a caster's edge.
constexpr double kGrazingCosine = 0.02;

// Pixels to stand in for a shadow boundary where there is none; more would add time and no information.
constexpr size_t kMostFallbackSamples = 2048;

constexpr uint8_t kVisible = 1;

/// The four neighbours of a pixel in screen space.
struct Step {
  int dx;
  int dy;
};
constexpr std::array<Step, 4> kNeighbours = {{{-1, 0}, {1, 0}, {0, -1}, {0, 1}}};

/// A pixel's surface in world space; derivatives are per low-resolution pixel.
struct Surface {
  glm::dvec3 ws_position;
  glm::dvec3 ws_dx1;
  glm::dvec3 ws_dx2;
  glm::dvec3 ws_normal;  ///< Towards the viewer, unit length.
  bool reliable;         ///< Whether the derivatives follow the surface; otherwise they face the viewer.
};

enum class Facing : uint8_t { kUnknown, kAway, kGrazing, kTowards };

}  // namespace

struct FrameSampler::Workspace {
  // Per frame.
  const Camera* camera = nullptr;
  DepthView depth;
  int width = 0;
  int height = 0;
  double pixels_per_sample_x = 1.0;  ///< Final-screen pixels per low-resolution pixel.
  double pixels_per_sample_y = 1.0;
  bool perspective = true;
  float orthographic_tolerance = 0.0f;

  // Per pixel. `inverse_distance` is the homogeneous coordinate of the unprojected point, proportional to the
  // reciprocal of view distance and so affine on planes; NDC depth for an orthographic camera.
  std::vector<uint8_t> visible;
  std::vector<float> inverse_distance;
  std::vector<uint8_t> smooth_x;  ///< 1 where the pixel and both neighbours along x lie on one surface.
  std::vector<uint8_t> smooth_y;  ///< The same along y.
  std::vector<int32_t> active_of_pixel;

  // Per active pixel: one that some light needs.
  std::vector<int32_t> active_pixels;
  std::vector<uint32_t> active_bits;  ///< The pixel's shadow bits.
  std::vector<uint32_t>
      active_differing;  ///< Lights whose bit differs from a neighbour's on the same surface.
  std::vector<uint32_t>
      active_rim;  ///< Lights whose shadow reaches the screen border or a discontinuity here.
  std::vector<Surface> surfaces;

  // Per light.
  std::vector<Facing> facing;
  std::vector<double> cosine;

  int Index(int x, int y) const { return y * width + x; }
  bool Inside(int x, int y) const { return x >= 0 && y >= 0 && x < width && y < height; }
  bool Visible(int x, int y) const { return Inside(x, y) && visible[static_cast<size_t>(Index(x, y))] != 0; }
  float Inverse(int x, int y) const { return inverse_distance[static_cast<size_t>(Index(x, y))]; }

  void Begin(const Camera& frame_camera, const DepthView& frame_depth, MapSize screen);
  void FindVisible(FrameExtent* extent);
  float Tolerance(int x, int y) const {
    return perspective ? kDiscontinuity * Inverse(x, y) : orthographic_tolerance;
  }
  /// Magnitude of the second difference of inverse distance at (x,y) along (dx,dy), over the tolerance there:
  /// above 1 is a discontinuity. Huge where a neighbour is not visible.
  float Bend(int x, int y, int dx, int dy) const;
  void FindSmooth();
  /// True where the surface goes on from (x,y) to its visible neighbour: either side predicts the other.
  bool Continuous(int x, int y, Step step) const;
  void FindActive(const std::optional<BitsView>& bits, uint32_t all_lights);
  void AddAllVisible(size_t stride);
  void UnprojectActive();
  /// Derivative of NDC depth along an axis; false where neither side can be trusted.
  bool DepthDerivative(int x, int y, int dx, int dy, double* derivative) const;
  Surface Unproject(int x, int y) const;
  void JudgeFacing(const RaySpace& ray_space);
  void AddHull(const RaySpace& ray_space, const Surface& surface, LightSamples* samples) const;
  void AddBoundary(const RaySpace& ray_space, const Surface& surface, const glm::dvec2& normal, double length,
                   BoundarySamples* samples) const;
  glm::dvec2 EdgeNormal(const std::optional<BitsView>& bits, int x, int y, uint32_t light_bit) const;
  void SampleBoundary(const std::optional<BitsView>& bits, const RaySpace& ray_space, uint32_t light_bit,
                      LightSamples* samples);
  void SampleAllVisible(const RaySpace& ray_space, LightSamples* samples);
};

void FrameSampler::Workspace::Begin(const Camera& frame_camera, const DepthView& frame_depth,
                                    MapSize screen) {
  camera = &frame_camera;
  depth = frame_depth;
  width = frame_depth.width;
  height = frame_depth.height;
  pixels_per_sample_x = static_cast<double>(screen.width) / width;
  pixels_per_sample_y = static_cast<double>(screen.height) / height;
  const glm::dmat4 w_from_ndc = glm::transpose(frame_camera.world_from_clip());
  const glm::dvec4 w_row = w_from_ndc[3];
  perspective = std::abs(w_row.x) + std::abs(w_row.y) + std::abs(w_row.z) > 1e-12 * std::abs(w_row.w);
  if (!perspective) {
    const glm::dmat4& m = frame_camera.world_from_clip();
    const double pixel_width = glm::length(glm::dvec3(m[0])) * 2.0 / width;
    orthographic_tolerance =
        static_cast<float>(kOrthographicDiscontinuityPixels * pixel_width / glm::length(glm::dvec3(m[2])));
  }
  const size_t pixels = static_cast<size_t>(width) * static_cast<size_t>(height);
  visible.assign(pixels, 0);
  inverse_distance.resize(pixels);
  smooth_x.resize(pixels);
  smooth_y.resize(pixels);
  active_of_pixel.assign(pixels, -1);
  active_pixels.clear();
  active_bits.clear();
  active_differing.clear();
  active_rim.clear();
}

void FrameSampler::Workspace::FindVisible(FrameExtent* extent) {
  const glm::dvec4 w_row = glm::transpose(camera->world_from_clip())[3];
  const ClipDepth convention = camera->clip_depth();
  const bool reversed = convention == ClipDepth::kReversedZeroToOne;
  const auto ndc_scale =
      static_cast<float>(NdcFromWindowDepth(convention, 1.0) - NdcFromWindowDepth(convention, 0.0));
  const auto ndc_offset = static_cast<float>(NdcFromWindowDepth(convention, 0.0));
  float smallest = 2.0f;
  float largest = -1.0f;
  int count = 0;
  for (int y = 0; y < height; ++y) {
    const float* row = depth.Row(y);
    uint8_t* visible_row = visible.data() + Index(0, y);
    float* inverse_row = inverse_distance.data() + Index(0, y);
    const double ndc_y = (y + 0.5) * 2.0 / height - 1.0;
    // In double until the last step: inverse distance is the small difference of numbers near one.
    const double row_constant = w_row.y * ndc_y + w_row.z * ndc_offset + w_row.w;
    const double x_scale = w_row.x * 2.0 / width;
    const double x_constant = row_constant + w_row.x * (1.0 / width - 1.0);
    const double z_scale = w_row.z * ndc_scale;
    for (int x = 0; x < width; ++x) {
      const float d = row[x];
      // Comparisons are false for NaN, and false at the far plane: both are background.
      const bool on_surface = reversed ? (d > 0.0f && d <= 1.0f) : (d >= 0.0f && d < 1.0f);
      const double inverse = perspective ? x_constant + x_scale * x + z_scale * static_cast<double>(d)
                                         : static_cast<double>(d) * ndc_scale;
      const bool seen = on_surface && (!perspective || inverse > 0.0);
      visible_row[x] = seen ? kVisible : 0;
      inverse_row[x] = static_cast<float>(inverse);
      if (seen) {
        ++count;
        smallest = std::min(smallest, d);
        largest = std::max(largest, d);
      }
    }
  }
  extent->visible_pixels = count;
  extent->nearest_ndc_depth = NdcFromWindowDepth(convention, reversed ? largest : smallest);
  extent->farthest_ndc_depth = NdcFromWindowDepth(convention, reversed ? smallest : largest);
}

float FrameSampler::Workspace::Bend(int x, int y, int dx, int dy) const {
  if (!Visible(x - dx, y - dy) || !Visible(x + dx, y + dy) || !Visible(x, y)) return 1e30f;
  const float second = Inverse(x - dx, y - dy) - 2.0f * Inverse(x, y) + Inverse(x + dx, y + dy);
  return std::abs(second) / Tolerance(x, y);
}

void FrameSampler::Workspace::FindSmooth() {
  // Bend() <= 1 for all pixels at once, row by row and without branches.
  std::fill(smooth_x.begin(), smooth_x.end(), 0);
  std::fill(smooth_y.begin(), smooth_y.end(), 0);
  const float relative = perspective ? kDiscontinuity : 0.0f;
  const float absolute = perspective ? 0.0f : orthographic_tolerance;
  const auto mark = [&](int y, int first_x, int last_x, int step, uint8_t* smooth) {
    const float* inverse = inverse_distance.data() + Index(0, y);
    const uint8_t* seen = visible.data() + Index(0, y);
    uint8_t* out = smooth + Index(0, y);
    for (int x = first_x; x <= last_x; ++x) {
      const float second = std::abs(inverse[x - step] - 2.0f * inverse[x] + inverse[x + step]);
      const int small = second <= relative * inverse[x] + absolute ? 1 : 0;
      out[x] = static_cast<uint8_t>(small & seen[x - step] & seen[x] & seen[x + step]);
    }
  };
  for (int y = 0; y < height; ++y) {
    mark(y, 1, width - 2, 1, smooth_x.data());
    if (y > 0 && y + 1 < height) mark(y, 0, width - 1, width, smooth_y.data());
  }
}

bool FrameSampler::Workspace::Continuous(int x, int y, Step step) const {
  const std::vector<uint8_t>& smooth = step.dx != 0 ? smooth_x : smooth_y;
  return (smooth[static_cast<size_t>(Index(x, y))] | smooth[static_cast<size_t>(Index(x + step.dx, y + step.dy))]) != 0;
}

void FrameSampler::Workspace::FindActive(const std::optional<BitsView>& bits, uint32_t all_lights) {
  for (int y = 0; y < height; ++y) {
    const uint32_t* row = bits->Row(y);
    for (int x = 0; x < width; ++x) {
      if (visible[static_cast<size_t>(Index(x, y))] == 0) continue;
      const uint32_t here = row[x] & all_lights;
      const bool inner = x > 0 && y > 0 && x + 1 < width && y + 1 < height;
      uint32_t differing = 0;
      uint32_t rim = 0;
      // Most pixels are inside a lit or a shadowed region, and settled by these few operations.
      if (inner) {
        const uint32_t any_difference = (here ^ row[x - 1]) | (here ^ row[x + 1]) |
                                        (here ^ bits->At(x, y - 1)) | (here ^ bits->At(x, y + 1));
        const auto i = static_cast<size_t>(Index(x, y));
        // smooth_x here means visible and continuous to both sides along x, and so along y.
        const bool surrounded = (smooth_x[i] & smooth_y[i]) != 0;
        if ((here == 0 || surrounded) && (any_difference & all_lights) == 0) continue;
      }
      for (const Step& step : kNeighbours) {
        const int nx = x + step.dx;
        const int ny = y + step.dy;
        if (!Visible(nx, ny) || !Continuous(x, y, step)) {
          rim |= here;
        } else {
          differing |= (here ^ bits->At(nx, ny)) & all_lights;
        }
      }
      if ((differing | rim) == 0) continue;
      active_of_pixel[static_cast<size_t>(Index(x, y))] = static_cast<int32_t>(active_pixels.size());
      active_pixels.push_back(Index(x, y));
      active_bits.push_back(here);
      active_differing.push_back(differing);
      active_rim.push_back(rim);
    }
  }
}

void FrameSampler::Workspace::AddAllVisible(size_t stride) {
  // Every stride-th visible pixel, row by row, and every visible pixel at the rim of a surface or of the
  // screen: the latter make the hull.
  size_t seen = 0;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      if (visible[static_cast<size_t>(Index(x, y))] == 0) continue;
      const bool chosen = seen++ % stride == 0;
      bool rim = false;
      for (const Step& step : kNeighbours) rim = rim || !Visible(x + step.dx, y + step.dy);
      int32_t& slot = active_of_pixel[static_cast<size_t>(Index(x, y))];
      if ((!chosen && !rim) || slot >= 0) continue;
      slot = static_cast<int32_t>(active_pixels.size());
      active_pixels.push_back(Index(x, y));
      active_bits.push_back(0);
      active_differing.push_back(0);
      active_rim.push_back(0);
    }
  }
}

bool FrameSampler::Workspace::DepthDerivative(int x, int y, int dx, int dy, double* derivative) const {
  const auto ndc = [&](int px, int py) {
    return NdcFromWindowDepth(camera->clip_depth(), static_cast<double>(depth.At(px, py)));
  };
  if (Bend(x, y, dx, dy) <= 1.0f) {
    *derivative = 0.5 * (ndc(x + dx, y + dy) - ndc(x - dx, y - dy));
    return true;
  }
  const float forward = Visible(x + dx, y + dy) ? Bend(x + dx, y + dy, dx, dy) : 1e30f;
  const float backward = Visible(x - dx, y - dy) ? Bend(x - dx, y - dy, dx, dy) : 1e30f;
  // A camera of extreme entries makes bends NaN: those fail every comparison, and never choose a side that
  // may lie outside.
  const bool use_forward = forward <= 1.0f && !(backward < forward);
  if (!use_forward && !(backward <= 1.0f)) return false;
  *derivative = use_forward ? ndc(x + dx, y + dy) - ndc(x, y) : ndc(x, y) - ndc(x - dx, y - dy);
  return true;
}

Surface FrameSampler::Workspace::Unproject(int x, int y) const {
  const glm::dvec3 ndc((x + 0.5) * 2.0 / width - 1.0, (y + 0.5) * 2.0 / height - 1.0,
                       NdcFromWindowDepth(camera->clip_depth(), static_cast<double>(depth.At(x, y))));
  const glm::dmat4& world_from_clip = camera->world_from_clip();
  const glm::dvec4 point = camera->WsFromNdc(ndc);
  Surface surface;
  surface.ws_position = glm::dvec3(point) / point.w;
  double dz1 = 0.0;
  double dz2 = 0.0;
  const bool known1 = DepthDerivative(x, y, 1, 0, &dz1);
  const bool known2 = DepthDerivative(x, y, 0, 1, &dz2);
  surface.reliable = known1 && known2;
  if (!surface.reliable) dz1 = dz2 = 0.0;
  // X = p / p.w, so dX = (dp - X dp.w) / p.w.
  const auto derivative = [&](const glm::dvec3& ndc_step) {
    const glm::dvec4 dp = world_from_clip * glm::dvec4(ndc_step, 0.0);
    return (glm::dvec3(dp) - surface.ws_position * dp.w) / point.w;
  };
  surface.ws_dx1 = derivative({2.0 / width, 0.0, dz1});
  surface.ws_dx2 = derivative({0.0, 2.0 / height, dz2});
  const glm::dvec3 towards_viewer = camera->TowardsViewer(surface.ws_position);
  const glm::dvec3 normal = glm::cross(surface.ws_dx1, surface.ws_dx2);
  const double length = glm::length(normal);
  if (length > 0.0 && std::isfinite(length)) {
    surface.ws_normal = normal * (glm::dot(normal, towards_viewer) < 0.0 ? -1.0 / length : 1.0 / length);
  } else {
    surface.reliable = false;
    surface.ws_normal = glm::dvec3(0.0);
  }
  return surface;
}

void FrameSampler::Workspace::UnprojectActive() {
  surfaces.clear();
  surfaces.reserve(active_pixels.size());
  for (const int32_t pixel : active_pixels) surfaces.push_back(Unproject(pixel % width, pixel / width));
}

void FrameSampler::Workspace::JudgeFacing(const RaySpace& ray_space) {
  facing.resize(surfaces.size());
  cosine.resize(surfaces.size());
  for (size_t i = 0; i < surfaces.size(); ++i) {
    const Surface& surface = surfaces[i];
    cosine[i] = 0.0;
    if (!ray_space.Illuminates(surface.ws_position)) {
      facing[i] = Facing::kAway;
    } else if (!surface.reliable) {
      facing[i] = Facing::kUnknown;
    } else {
      const glm::dvec3 to_light = ray_space.TowardsLight(surface.ws_position);
      cosine[i] = glm::dot(surface.ws_normal, to_light) / glm::length(to_light);
      facing[i] = cosine[i] > kGrazingCosine ? Facing::kTowards
                  : cosine[i] > 0.0          ? Facing::kGrazing
                                             : Facing::kAway;
    }
  }
}

void FrameSampler::Workspace::AddHull(const RaySpace& ray_space, const Surface& surface,
                                      LightSamples* samples) const {
  const glm::dvec3 ray = ray_space.RayFromPoint(surface.ws_position);
  samples->hull_rays.push_back(ray);
  samples->hull_along_ray.push_back(ray_space.AlongRay(surface.ws_position));
  const glm::dvec3 dx1 = ray_space.RayFromVector(surface.ws_dx1);
  const glm::dvec3 dx2 = ray_space.RayFromVector(surface.ws_dx2);
  samples->hull_footprint_rays.push_back(ray + dx1 + dx2);
  samples->hull_footprint_rays.push_back(ray + dx1 - dx2);
  samples->hull_footprint_rays.push_back(ray - dx1 + dx2);
  samples->hull_footprint_rays.push_back(ray - dx1 - dx2);
}

void FrameSampler::Workspace::AddBoundary(const RaySpace& ray_space, const Surface& surface,
                                          const glm::dvec2& normal, double length,
                                          BoundarySamples* samples) const {
  // From low-resolution to final-screen pixels: lengths along the edge stretch with it, its normal with the
  // inverse.
  const glm::dvec2 scale(pixels_per_sample_x, pixels_per_sample_y);
  const double stretch = glm::length(glm::dvec2(-normal.y, normal.x) * scale);
  samples->Add(ray_space.RayFromPoint(surface.ws_position), ray_space.RayFromVector(surface.ws_dx1) / scale.x,
               ray_space.RayFromVector(surface.ws_dx2) / scale.y, ray_space.AlongRay(surface.ws_position),
               glm::normalize(normal / scale), length * stretch);
}

/// The direction across the shadow edge: the dominant eigenvector of the structure tensor, the sum of g g^T
/// over the four 2x2 quads of bits around the pixel, with g a quad's bit gradient.
glm::dvec2 FrameSampler::Workspace::EdgeNormal(const std::optional<BitsView>& bits, int x, int y,
                                               uint32_t light_bit) const {
  const int here = (bits->At(x, y) & light_bit) != 0 ? 1 : 0;
  int value[3][3];
  for (int dy = -1; dy <= 1; ++dy) {
    for (int dx = -1; dx <= 1; ++dx) {
      value[dy + 1][dx + 1] =
          Visible(x + dx, y + dy) ? ((bits->At(x + dx, y + dy) & light_bit) != 0 ? 1 : 0) : here;
    }
  }
  double xx = 0.0;
  double xy = 0.0;
  double yy = 0.0;
  for (int qy = 0; qy < 2; ++qy) {
    for (int qx = 0; qx < 2; ++qx) {
      const int v00 = value[qy][qx];
      const int v10 = value[qy][qx + 1];
      const int v01 = value[qy + 1][qx];
      const int v11 = value[qy + 1][qx + 1];
      const double gx = 0.5 * (v10 + v11 - v00 - v01);
      const double gy = 0.5 * (v01 + v11 - v00 - v10);
      xx += gx * gx;
      xy += gx * gy;
      yy += gy * gy;
    }
  }
  const double angle = 0.5 * std::atan2(2.0 * xy, xx - yy);
  return {std::cos(angle), std::sin(angle)};
}

void FrameSampler::Workspace::SampleBoundary(const std::optional<BitsView>& bits, const RaySpace& ray_space,
                                             uint32_t light_bit, LightSamples* samples) {
  JudgeFacing(ray_space);
  for (size_t i = 0; i < active_pixels.size(); ++i) {
    if (((active_differing[i] | active_rim[i]) & light_bit) == 0 || facing[i] == Facing::kAway) continue;
    const bool differs = (active_differing[i] & light_bit) != 0;
    if (!differs && facing[i] == Facing::kGrazing) continue;
    AddHull(ray_space, surfaces[i], samples);
    if (facing[i] == Facing::kGrazing) continue;

    const int x = active_pixels[i] % width;
    const int y = active_pixels[i] / width;
    int crossings = 0;
    int rough_crossings = 0;
    for (const Step& step : kNeighbours) {
      const int nx = x + step.dx;
      const int ny = y + step.dy;
      if (!Visible(nx, ny) || ((bits->At(nx, ny) ^ active_bits[i]) & light_bit) == 0) continue;
      const int32_t neighbour = active_of_pixel[static_cast<size_t>(Index(nx, ny))];
      if (neighbour < 0 || facing[i] != Facing::kTowards || !Continuous(x, y, step)) {
        ++rough_crossings;
        continue;
      }
      // A terminator: the light's cosine, carried on at the same rate, reaches zero within a step.
      const auto n = static_cast<size_t>(neighbour);
      if (facing[n] == Facing::kAway || facing[n] == Facing::kGrazing) continue;
      if (facing[n] == Facing::kTowards && 2.0 * cosine[i] - cosine[n] <= 0.0) continue;
      ++crossings;
    }
    if (crossings + rough_crossings == 0) continue;
    // A straight edge of length l crosses l (|n1| + |n2|) pairs of neighbours (Cauchy, Crofton); both pixels
    // of a pair are samples, so each stands for half of it.
    const glm::dvec2 normal = EdgeNormal(bits, x, y, light_bit);
    const double length = 0.5 / (std::abs(normal.x) + std::abs(normal.y));
    if (crossings > 0) AddBoundary(ray_space, surfaces[i], normal, crossings * length, &samples->boundary);
    if (rough_crossings > 0) {
      AddBoundary(ray_space, surfaces[i], normal, rough_crossings * length, &samples->rough_boundary);
    }
  }
}

void FrameSampler::Workspace::SampleAllVisible(const RaySpace& ray_space, LightSamples* samples) {
  JudgeFacing(ray_space);
  for (size_t i = 0; i < active_pixels.size(); ++i) {
    if (facing[i] == Facing::kAway || facing[i] == Facing::kGrazing) continue;
    AddHull(ray_space, surfaces[i], samples);
    if (facing[i] != Facing::kTowards) continue;
    // An edge could run either way.
    AddBoundary(ray_space, surfaces[i], {1.0, 0.0}, 0.5, &samples->boundary);
    AddBoundary(ray_space, surfaces[i], {0.0, 1.0}, 0.5, &samples->boundary);
  }
}

FrameSampler::FrameSampler() : workspace_(std::make_unique<Workspace>()) {}
FrameSampler::~FrameSampler() = default;
FrameSampler::FrameSampler(FrameSampler&&) noexcept = default;
FrameSampler& FrameSampler::operator=(FrameSampler&&) noexcept = default;

void FrameSampler::Sample(const Camera& camera, const DepthView& depth, const std::optional<BitsView>& bits,
                          std::span<const RaySpace> ray_spaces, MapSize screen, FrameExtent* extent,
                          std::vector<LightSamples>* samples) {
  Workspace& work = *workspace_;
  work.Begin(camera, depth, screen);
  work.FindVisible(extent);
  samples->resize(ray_spaces.size());
  for (LightSamples& light : *samples) light.Clear();

  const auto all_lights =
      static_cast<uint32_t>(ray_spaces.size() >= 32 ? ~uint32_t{0} : (uint32_t{1} << ray_spaces.size()) - 1);
  if (bits) {
    work.FindSmooth();
    work.FindActive(bits, all_lights);
    work.UnprojectActive();
    for (size_t i = 0; i < ray_spaces.size(); ++i) {
      work.SampleBoundary(bits, ray_spaces[i], uint32_t{1} << i, &(*samples)[i]);
      if ((*samples)[i].boundary.size() > 0) (*samples)[i].source = SampleSource::kShadowBoundary;
    }
  }
  const bool all_served = std::all_of(samples->begin(), samples->end(), [](const LightSamples& light) {
    return light.source == SampleSource::kShadowBoundary;
  });
  if (!all_served) {
    const size_t stride =
        std::max<size_t>(1, static_cast<size_t>(extent->visible_pixels) / kMostFallbackSamples);
    work.AddAllVisible(stride);
    work.UnprojectActive();
    for (size_t i = 0; i < ray_spaces.size(); ++i) {
      LightSamples& light = (*samples)[i];
      if (light.source == SampleSource::kShadowBoundary) continue;
      light.Clear();
      work.SampleAllVisible(ray_spaces[i], &light);
      if (!light.hull_rays.empty()) light.source = SampleSource::kAllVisible;
    }
  }
}

}  // namespace shadowfit
