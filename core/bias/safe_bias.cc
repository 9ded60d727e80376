#include "core/bias/safe_bias.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "absl/strings/str_format.h"

namespace shadowfit {
namespace {

/// One sample's demand: constant + slope * steepness >= need.
struct Demand {
  double steepness;  ///< max(|dz/du|, |dz/dv|).
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

}  // namespace

absl::StatusOr<SafeBias> FindSafeBias(const Camera& camera, std::span<const glm::dvec3> ws_points,
                                      std::span<const glm::dvec3> ws_normals, const RaySpace& ray_space,
                                      const ShadowProjection& projection, const DepthRange& range,
                                      const BiasOptions& options) {
  if (absl::Status status = Check(ws_points.size(), ws_normals.size(), projection, range, options);
      !status.ok()) {
    return status;
  }
  const ReceiverProjector projector(ray_space, projection, range);
  const double rounding = DepthRounding(options.format);
  // How far from a receiver, along u and v, a texel centre can be that it is compared with.
  const double reach = 0.5 + options.pcf_radius;

  struct Sample {
    size_t index;
    ReceiverDepth receiver;
  };
  std::vector<Sample> samples;
  std::vector<Demand> demands;
  double weight_sum = 0.0;
  double weighted_steepness = 0.0;
  SafeBias bias;
  for (size_t i = 0; i < ws_points.size(); ++i) {
    const std::optional<ReceiverDepth> receiver = projector.Project(ws_points[i], ws_normals[i]);
    if (!receiver || !std::isfinite(receiver->slope.x) || !std::isfinite(receiver->slope.y)) continue;
    const double need = reach * (std::abs(receiver->slope.x) + std::abs(receiver->slope.y));
    demands.push_back({receiver->MaxSlope(), need});
    bias.constant_alone = std::max(bias.constant_alone, need);
    // Bias is paid in world units. Where it exceeds the whole range of depth nothing can be shadowed anyway;
    // such surfaces, seen edge-on by the light, must not rule the choice.
    if (need < 1.0) {
      weight_sum += receiver->ws_distance;
      weighted_steepness += receiver->ws_distance * receiver->MaxSlope();
    }
    samples.push_back({i, *receiver});
  }
  bias.samples = static_cast<int>(samples.size());
  const auto [constant, slope] =
      LowestLineAbove(demands, weight_sum > 0.0 ? weighted_steepness / weight_sum : 0.0);
  bias.constant = constant + rounding;
  bias.slope = slope * (1.0 + 1e-9);  // So that the demands on the line itself are met after rounding.
  bias.constant_alone += rounding;
  bias.receiver_plane_constant = rounding;
  if (samples.empty()) return bias;

  const glm::dmat4& clip_from_world = camera.clip_from_world();
  const glm::dvec2 half_screen(0.5 * options.screen.width, 0.5 * options.screen.height);
  int on_screen = 0;
  for (const Sample& sample : samples) {
    const glm::dvec3& ws_point = ws_points[sample.index];
    const glm::dvec3& ws_normal = ws_normals[sample.index];
    const double depth_bias = bias.constant + bias.slope * sample.receiver.MaxSlope();
    const double detachment = projector.WsDetachment(sample.receiver, ws_point, depth_bias);
    bias.ws_mean_detachment += detachment;
    bias.ws_worst_detachment = std::max(bias.ws_worst_detachment, detachment);
    bias.ws_mean_detachment_of_constant +=
        projector.WsDetachment(sample.receiver, ws_point, bias.constant_alone);
    // Beside a caster that touches the receiver, a point at distance g meets it after g / sin(angle of
    // incidence) along the ray: the strip is the detachment's part along the surface.
    const glm::dvec3 towards_light = glm::normalize(ray_space.TowardsLight(ws_point));
    const glm::dvec3 along_surface = towards_light - glm::dot(towards_light, ws_normal) * ws_normal;
    const glm::dvec4 from = clip_from_world * glm::dvec4(ws_point, 1.0);
    const glm::dvec4 to = clip_from_world * glm::dvec4(ws_point + detachment * along_surface, 1.0);
    if (!(from.w > 0.0 && to.w > 0.0)) continue;
    const double pixels = glm::length((glm::dvec2(to) / to.w - glm::dvec2(from) / from.w) * half_screen);
    bias.mean_detachment_pixels += pixels;
    bias.worst_detachment_pixels = std::max(bias.worst_detachment_pixels, pixels);
    ++on_screen;
  }
  bias.ws_mean_detachment /= bias.samples;
  bias.ws_mean_detachment_of_constant /= bias.samples;
  if (on_screen > 0) bias.mean_detachment_pixels /= on_screen;
  return bias;
}

}  // namespace shadowfit
