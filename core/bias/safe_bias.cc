#include "core/bias/safe_bias.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <tuple>
#include <utility>
#include <vector>

#include "absl/strings/str_format.h"

namespace shadowfit {
namespace {

/// One sample's demand: constant + slope * steepness >= need.
struct Demand {
  double steepness;  ///< Some measure of slope.
  double need;       ///< Less rounding.
};

absl::Status Check(size_t points, size_t normals, const ShadowProjection& projection, const DepthRange& range,
                   const BiasOptions& options) {
  if (points != normals) {
    return absl::InvalidArgumentError(absl::StrFormat("ws_normals: %d for %d points", normals, points));
  }
  if (options.pcf_radius < 0 || options.pcf_radius > kMaxPcfRadius) {
    return absl::InvalidArgumentError(
        absl::StrFormat("pcf_radius: %d is outside 0 to %d", options.pcf_radius, kMaxPcfRadius));
  }
  if (options.screen.width < 1 || options.screen.height < 1) {
    return absl::InvalidArgumentError(absl::StrFormat("screen: size %dx%d, both must be positive",
                                                      options.screen.width, options.screen.height));
  }
  if (projection.size.width < 1 || projection.size.height < 1) {
    return absl::InvalidArgumentError(absl::StrFormat("projection.size: %dx%d, both must be positive",
                                                      projection.size.width, projection.size.height));
  }
  const double volume = std::abs(glm::determinant(projection.texel_from_ray));
  if (!(volume > 0.0) || !std::isfinite(volume)) {
    return absl::InvalidArgumentError("projection.texel_from_ray: not finite or singular");
  }
  const double span = range.far_q_over_w - range.near_q_over_w;
  if (!std::isfinite(span) || span == 0.0 || !std::isfinite(range.q_origin)) {
    return absl::InvalidArgumentError(absl::StrFormat("depth_range: %g to %g from %g, not finite or empty",
                                                      range.near_q_over_w, range.far_q_over_w,
                                                      range.q_origin));
  }
  return absl::OkStatus();
}

/// The line constant + slope * steepness that lies on or above all demands, has neither term negative, and is
/// lowest at `steepness`. For a given slope the constant is max(need - slope * steepness of each demand), so
/// the line's height there is a convex, piecewise linear function of the slope; its least value is found by
/// cutting planes: where the pieces known on either side of it meet, the true piece replaces one of them.
/// Each step takes one look at all demands and a handful suffice.
std::pair<double, double> LowestLineAbove(const std::vector<Demand>& demands, double steepness) {
  // The demand that decides at a slope; without any, that the constant is not negative.
  const auto deciding = [&](double slope) {
    Demand most{0.0, 0.0};
    for (const Demand& demand : demands) {
      if (demand.need - slope * demand.steepness > most.need - slope * most.steepness) most = demand;
    }
    return most;
  };
  Demand falling = deciding(0.0);
  if (falling.steepness <= steepness) return {falling.need, 0.0};
  Demand rising{0.0, 0.0};
  for (;;) {
    const double slope = (falling.need - rising.need) / (falling.steepness - rising.steepness);
    const Demand next = deciding(slope);
    const double constant = std::max(0.0, next.need - slope * next.steepness);
    // Each piece comes up once; rounding alone could bring one back.
    const double known = rising.need - slope * rising.steepness;
    if (!(constant > known + 1e-12 * std::abs(next.need))) return {constant, slope};
    (next.steepness > steepness ? falling : rising) = next;
  }
}

/// Tells where a visible plane ends, by what the camera sees.
class PlaneEnds {
 public:
  PlaneEnds(const Camera& camera, const DepthView& depth) : camera_(camera), depth_(depth) {
    // Plane equations transform by the inverse transpose.
    clip_plane_from_ws_plane_ = glm::transpose(camera.world_from_clip());
    window_scale_ =
        1.0 / (NdcFromWindowDepth(camera.clip_depth(), 1.0) - NdcFromWindowDepth(camera.clip_depth(), 0.0));
    window_offset_ = -NdcFromWindowDepth(camera.clip_depth(), 0.0) * window_scale_;
    farther_ = BackgroundWindowDepth(camera.clip_depth()) > 0.5 ? 1.0 : -1.0;
  }

  bool known() const { return depth_.bottom_row != nullptr; }

  /// The camera sees through the plane at `ws_at`: it is not there.
  bool IsBeyond(const glm::dvec3& ws_at, const glm::dvec3& ws_normal) const {
    const glm::dvec4 clip = camera_.clip_from_world() * glm::dvec4(ws_at, 1.0);
    if (!(clip.w > 0.0)) return false;
    const glm::dvec3 ndc = glm::dvec3(clip) / clip.w;
    const double x = (0.5 * ndc.x + 0.5) * depth_.width - 0.5;
    const double y = (0.5 * ndc.y + 0.5) * depth_.height - 0.5;
    if (!(x >= 0.0 && x < depth_.width - 1 && y >= 0.0 && y < depth_.height - 1)) return false;
    const double z = window_offset_ + window_scale_ * ndc.z;
    if (!(z >= 0.0 && z <= 1.0)) return false;
    // On a plane, NDC depth is affine in NDC x and y. The four pixels around are at most one pixel away; half
    // a pixel more for the normal's own error.
    const glm::dvec4 plane = clip_plane_from_ws_plane_ * glm::dvec4(ws_normal, -glm::dot(ws_normal, ws_at));
    const double slack = std::abs(window_scale_ / plane.z) * 3.0 *
                         (std::abs(plane.x) / depth_.width + std::abs(plane.y) / depth_.height);
    constexpr double kRounding = 4e-7;
    const int column = static_cast<int>(x);
    const int row = static_cast<int>(y);
    for (int i = 0; i < 4; ++i) {
      const double seen = depth_.At(column + (i & 1), row + (i >> 1));
      if (!(seen >= 0.0 && seen <= 1.0)) continue;  // Background.
      if (!((seen - z) * farther_ > slack + kRounding)) return false;
    }
    return true;
  }

 private:
  const Camera& camera_;
  const DepthView depth_;
  glm::dmat4 clip_plane_from_ws_plane_;
  double window_scale_;
  double window_offset_;
  double farther_;
};

/// What a sample needs of a bias: how much nearer to the light its plane comes within `reach` texels, along u
/// and v each, as far as the plane is there.
class NeedFinder {
 public:
  NeedFinder(const RaySpace& ray_space, const ShadowProjection& projection, const PlaneEnds& ends,
             double reach)
      : ray_space_(ray_space),
        ray_from_texel_(glm::inverse(projection.texel_from_ray)),
        ends_(ends),
        reach_(reach) {}

  double Need(const ReceiverDepth& receiver, const glm::dvec3& ws_point, const glm::dvec3& ws_normal) const {
    const double sum = std::abs(receiver.slope.x) + std::abs(receiver.slope.y);
    const double most = reach_ * sum;
    if (!ends_.known() || !(sum > 0.0)) return most;
    // Towards the corner where the plane is nearest to the light, and straight up the slope.
    const glm::dvec2 ways[2] = {-reach_ * glm::sign(receiver.slope),
                                -most / glm::dot(receiver.slope, receiver.slope) * receiver.slope};
    const auto is_there = [&](double share) {
      for (const glm::dvec2& way : ways) {
        if (!IsBeyondEnd(receiver.texel + share * way, ws_point, ws_normal)) return true;
      }
      return false;
    };
    if (is_there(1.0)) return most;
    double beyond = 1.0;
    double within = 0.0;
    for (int i = 0; i < 9 && within == 0.0; ++i) {  // Down to a hundredth of the way.
      const double share = 0.6 * beyond;
      (is_there(share) ? within : beyond) = share;
    }
    for (int i = 0; i < 3; ++i) {
      const double middle = 0.5 * (within + beyond);
      (is_there(middle) ? within : beyond) = middle;
    }
    return beyond * most;
  }

 private:
  bool IsBeyondEnd(const glm::dvec2& texel, const glm::dvec3& ws_point, const glm::dvec3& ws_normal) const {
    const RaySpace::WsRay ray = ray_space_.WorldRay(ray_from_texel_ * glm::dvec3(texel, 1.0));
    const double t = glm::dot(ws_normal, ws_point - ray.origin) / glm::dot(ws_normal, ray.direction);
    return ends_.IsBeyond(ray.origin + t * ray.direction, ws_normal);
  }

  const RaySpace& ray_space_;
  const glm::dmat3 ray_from_texel_;
  const PlaneEnds& ends_;
  const double reach_;
};

/// Vertices are float: neighbouring triangles of a flat surface part by less than this share of their
/// coordinates' size. The reference's tolerance, too.
constexpr double kVertexRounding = 1e-5;

struct Sample {
  ReceiverDepth receiver;
  double need = -1.0;  // Negative: takes no part.
};

struct Detachment {
  double ws = 0.0;
  double ws_of_constant = 0.0;
  double pixels = -1.0;  // Negative: not on the screen.
};

constexpr size_t kGrain = 1024;

template <typename Body>
void ForEachSample(size_t count, const Body& body) {
  tbb::parallel_for(tbb::blocked_range<size_t>(0, count, kGrain),
                    [&](const tbb::blocked_range<size_t>& range) {
                      for (size_t i = range.begin(); i != range.end(); ++i) body(i);
                    });
}

}  // namespace

absl::StatusOr<SafeBias> FindSafeBias(const Camera& camera, std::span<const glm::dvec3> ws_points,
                                      std::span<const glm::dvec3> ws_normals, const RaySpace& ray_space,
                                      const ShadowProjection& projection, const DepthRange& range,
                                      const BiasOptions& options, const DepthView& depth) {
  if (absl::Status status = Check(ws_points.size(), ws_normals.size(), projection, range, options);
      !status.ok()) {
    return status;
  }
  const ReceiverProjector projector(ray_space, projection, range);
  const double rounding = DepthRounding(options.format);
  const PlaneEnds ends(camera, depth);
  // How far from a receiver, along u and v, a texel centre can be that it is compared with.
  const NeedFinder needs(ray_space, projection, ends, 0.5 + options.pcf_radius);

  // 1. What each sample needs.
  std::vector<Sample> samples(ws_points.size());
  ForEachSample(samples.size(), [&](size_t i) {
    const std::optional<ReceiverDepth> receiver = projector.Project(ws_points[i], ws_normals[i]);
    if (!receiver || !std::isfinite(receiver->slope.x) || !std::isfinite(receiver->slope.y)) return;
    samples[i] = {*receiver, needs.Need(*receiver, ws_points[i], ws_normals[i])};
  });

  // 2. The line over all needs, by either measure of slope.
  std::vector<Demand> demands;
  std::vector<Demand> caster_demands;
  double weight_sum = 0.0;
  double weighted_steepness = 0.0;
  double weighted_max_slope = 0.0;
  double vertex_rounding = 0.0;
  SafeBias bias;
  for (size_t i = 0; i < samples.size(); ++i) {
    const auto& [receiver, need] = samples[i];
    if (!(need >= 0.0)) continue;
    demands.push_back({receiver.Steepness(), need});
    caster_demands.push_back({receiver.MaxSlope(), need});
    bias.clamp = std::max(bias.clamp, need);
    const glm::dvec3 size = glm::abs(ws_points[i]);
    vertex_rounding = std::max(vertex_rounding,
                               kVertexRounding * std::max({size.x, size.y, size.z}) / receiver.ws_distance);
    // Bias is paid in world units. Where it exceeds the whole range of depth nothing can be shadowed anyway;
    // such surfaces, seen edge-on by the light, must not rule the choice.
    if (need < 1.0) {
      weight_sum += receiver.ws_distance;
      weighted_steepness += receiver.ws_distance * receiver.Steepness();
      weighted_max_slope += receiver.ws_distance * receiver.MaxSlope();
    }
  }
  bias.samples = static_cast<int>(demands.size());
  const double weight = weight_sum > 0.0 ? 1.0 / weight_sum : 0.0;
  // So that the demands on the line itself are met after rounding.
  constexpr double kSlopeRounding = 1.0 + 1e-9;
  std::tie(bias.constant, bias.slope) = LowestLineAbove(demands, weighted_steepness * weight);
  bias.constant += rounding;
  bias.slope *= kSlopeRounding;
  std::tie(bias.polygon_offset_constant, bias.polygon_offset_slope) =
      LowestLineAbove(caster_demands, weighted_max_slope * weight);
  bias.polygon_offset_constant += rounding;
  bias.polygon_offset_slope *= kSlopeRounding;
  bias.clamp += rounding;
  bias.receiver_plane_constant = rounding + vertex_rounding;
  if (demands.empty()) return bias;

  // 3. What it costs.
  const glm::dmat4& clip_from_world = camera.clip_from_world();
  const glm::dvec2 half_screen(0.5 * options.screen.width, 0.5 * options.screen.height);
  std::vector<Detachment> detachments(samples.size());
  ForEachSample(samples.size(), [&](size_t i) {
    const auto& [receiver, need] = samples[i];
    if (!(need >= 0.0)) return;
    const glm::dvec3& ws_point = ws_points[i];
    const glm::dvec3& ws_normal = ws_normals[i];
    Detachment& detachment = detachments[i];
    const double depth_bias = std::min(bias.constant + bias.slope * receiver.Steepness(), bias.clamp);
    detachment.ws = projector.WsDetachment(receiver, ws_point, depth_bias);
    detachment.ws_of_constant = projector.WsDetachment(receiver, ws_point, bias.clamp);
    // Beside a caster that touches the receiver, a point at distance g meets it after g / sin(angle of
    // incidence) along the ray: the strip is the detachment's part along the surface.
    const glm::dvec3 towards_light = glm::normalize(ray_space.TowardsLight(ws_point));
    const glm::dvec3 along_surface = towards_light - glm::dot(towards_light, ws_normal) * ws_normal;
    const glm::dvec4 from = clip_from_world * glm::dvec4(ws_point, 1.0);
    const glm::dvec4 to = clip_from_world * glm::dvec4(ws_point + detachment.ws * along_surface, 1.0);
    if (!(from.w > 0.0 && to.w > 0.0)) return;
    detachment.pixels = glm::length((glm::dvec2(to) / to.w - glm::dvec2(from) / from.w) * half_screen);
  });
  int on_screen = 0;
  for (const Detachment& detachment : detachments) {
    bias.ws_mean_detachment += detachment.ws;
    bias.ws_worst_detachment = std::max(bias.ws_worst_detachment, detachment.ws);
    bias.ws_mean_detachment_of_constant += detachment.ws_of_constant;
    if (detachment.pixels < 0.0) continue;
    bias.mean_detachment_pixels += detachment.pixels;
    bias.worst_detachment_pixels = std::max(bias.worst_detachment_pixels, detachment.pixels);
    ++on_screen;
  }
  bias.ws_mean_detachment /= bias.samples;
  bias.ws_mean_detachment_of_constant /= bias.samples;
  if (on_screen > 0) bias.mean_detachment_pixels /= on_screen;
  return bias;
}

}  // namespace shadowfit
