#include "core/bias/depth_test.h"

#include <algorithm>
#include <cmath>

namespace shadowfit {
namespace {

/// Steps of the stored numbers between 0 and 1.
double UnormSteps(DepthFormat format) { return format == DepthFormat::kUnorm16 ? 65535.0 : 16777215.0; }

}  // namespace

double StoredDepth(DepthFormat format, double depth) {
  const double clamped = std::clamp(depth, 0.0, 1.0);
  if (format == DepthFormat::kFloat32) return static_cast<float>(clamped);
  return std::round(clamped * UnormSteps(format)) / UnormSteps(format);
}

double DepthRounding(DepthFormat format) {
  // A receiver's depth comes out of a matrix product and a division in float32: a few roundings of numbers up
  // to 1.
  constexpr double kReceiver = 0x1p-22;
  if (format == DepthFormat::kFloat32) return kReceiver + 0x1p-25;
  return kReceiver + 0.5 / UnormSteps(format);
}

ReceiverProjector::ReceiverProjector(const RaySpace& ray_space, const ShadowProjection& projection,
                                     const DepthRange& range)
    : ray_space_(ray_space),
      projection_(projection),
      range_(range),
      ray_from_texel_(glm::inverse(projection.texel_from_ray)) {}

std::optional<ReceiverDepth> ReceiverProjector::Project(const glm::dvec3& ws_point,
                                                        const glm::dvec3& ws_normal) const {
  const glm::dvec3 r = ray_space_.RayFromPoint(ws_point);
  const glm::dvec3 u = projection_.TexelFromRay(r);
  const MapSize size = projection_.size;
  if (!(u.z > 0.0 && u.x >= 0.0 && u.x < size.width && u.y >= 0.0 && u.y < size.height)) return std::nullopt;
  if (!(glm::dot(ws_normal, ray_space_.TowardsLight(ws_point)) > 0.0)) return std::nullopt;
  if (!ray_space_.Illuminates(ws_point)) return std::nullopt;

  // Let rho = ray_from_texel (u, v, 1). As h3 . rho = 1, ray coordinates along it are w rho.
  //
  // Point light: X = L + R^T r, and the plane n.X = n.P reads m.r = c with m = R n, c = n.(P - L). Along rho,
  // w (m.rho) = c, so that q/w = 1/w = (m . rho) / c.
  //
  // Directional light: X = a1 r1 + a2 r2 + q d with r = (r1, r2, 1) = w rho, so that rho.z = 1/w, and the
  // plane reads m1 r1 + m2 r2 + (n.d) q = n.P; times rho.z: q/w = ((n.P) rho.z - m1 rho.x - m2 rho.y) /
  // (n.d), less q_origin rho.z for the range's origin.
  //
  // Either is affine in (u, v), as rho is.
  const glm::dvec3 m = ray_space_.RayFromVector(ws_normal);
  glm::dvec3 gradient;
  if (ray_space_.is_directional()) {
    const double along = glm::dot(ws_normal, ray_space_.ws_direction());
    gradient =
        glm::dvec3(-m.x, -m.y, glm::dot(ws_normal, ws_point)) / along - glm::dvec3(0.0, 0.0, range_.q_origin);
  } else {
    gradient = m * (1.0 - range_.q_origin) / glm::dot(m, r);
  }
  const double span = range_.far_q_over_w - range_.near_q_over_w;
  ReceiverDepth receiver;
  receiver.texel = glm::dvec2(u);
  receiver.depth = WindowDepth(range_, ray_space_.AlongRay(ws_point), u.z);
  receiver.slope = {glm::dot(gradient, ray_from_texel_[0]) / span,
                    glm::dot(gradient, ray_from_texel_[1]) / span};
  // Along a ray, a directional light's w is constant, and a point light's is proportional to distance.
  receiver.ws_distance = ray_space_.is_directional()
                             ? std::abs(span) * u.z
                             : std::abs(span) * u.z * glm::length(ray_space_.TowardsLight(ws_point));
  return receiver;
}

double ReceiverProjector::WsDetachment(const ReceiverDepth& receiver, const glm::dvec3& ws_point,
                                       double bias) const {
  if (!(bias > 0.0)) return 0.0;
  if (ray_space_.is_directional()) return bias * receiver.ws_distance;
  // 1/w grows by bias * |span|: the caster's w is that much smaller, and its distance with it.
  const double distance = glm::length(ray_space_.TowardsLight(ws_point));
  const double growth = bias * receiver.ws_distance / distance;  // Of 1/w, relative.
  return distance * growth / (1.0 + growth);
}

}  // namespace shadowfit
