#include "core/fit/whitened_samples.h"

#include <algorithm>
#include <cmath>

#include "core/fit/edge_kernels.h"

namespace shadowfit {
namespace {

/// Area, centroid and central second moments of a polygon; of its vertices where it has no area.
struct Moments {
  glm::dvec2 mean{0.0};
  double xx = 0.0;
  double xy = 0.0;
  double yy = 0.0;
};

Moments MomentsOf(const std::vector<glm::dvec2>& polygon) {
  Moments moments;
  const size_t n = polygon.size();
  const glm::dvec2 origin = polygon[0];
  double area = 0.0;
  glm::dvec2 first(0.0);
  double xx = 0.0;
  double xy = 0.0;
  double yy = 0.0;
  // Green's theorem over triangles (origin, a, b).
  for (size_t i = 1; i + 1 < n; ++i) {
    const glm::dvec2 a = polygon[i] - origin;
    const glm::dvec2 b = polygon[i + 1] - origin;
    const double cross = a.x * b.y - a.y * b.x;
    area += cross / 2.0;
    first += (a + b) * (cross / 6.0);
    xx += cross / 12.0 * (a.x * a.x + a.x * b.x + b.x * b.x);
    yy += cross / 12.0 * (a.y * a.y + a.y * b.y + b.y * b.y);
    xy += cross / 24.0 * (2.0 * a.x * a.y + a.x * b.y + b.x * a.y + 2.0 * b.x * b.y);
  }
  if (area > 0.0) {
    const glm::dvec2 mean = first / area;
    moments.mean = origin + mean;
    moments.xx = xx / area - mean.x * mean.x;
    moments.yy = yy / area - mean.y * mean.y;
    moments.xy = xy / area - mean.x * mean.y;
  }
  if (!(moments.xx > 0.0) || !(moments.yy > 0.0)) {
    moments = {};
    for (const glm::dvec2& p : polygon) moments.mean += p / static_cast<double>(n);
    for (const glm::dvec2& p : polygon) {
      const glm::dvec2 d = p - moments.mean;
      moments.xx += d.x * d.x / static_cast<double>(n);
      moments.yy += d.y * d.y / static_cast<double>(n);
      moments.xy += d.x * d.y / static_cast<double>(n);
    }
  }
  return moments;
}

/// The inverse square root of a symmetric 2x2 matrix whose eigenvalues are kept above a thousandth of the
/// larger and above what doubles resolve.
glm::dmat2 InverseSquareRoot(const Moments& m) {
  const double angle = 0.5 * std::atan2(2.0 * m.xy, m.xx - m.yy);
  const glm::dvec2 major(std::cos(angle), std::sin(angle));
  const glm::dvec2 minor(-major.y, major.x);
  const double half_trace = 0.5 * (m.xx + m.yy);
  const double radius = std::sqrt(0.25 * (m.xx - m.yy) * (m.xx - m.yy) + m.xy * m.xy);
  const double large = std::max(half_trace + radius, 1e-14);
  const double small = std::max(half_trace - radius, 1e-6 * large);
  return glm::outerProduct(major, major) / std::sqrt(large) +
         glm::outerProduct(minor, minor) / std::sqrt(small);
}

/// `most_pixels`: expected misclassified pixels above which a sample counts no more. They are estimated at
/// the axis (0, 0, 1), where the hull is about as wide as a square of unit second moments, sqrt(12), and a
/// texel `texel` of that; the mean of s/4 + t^2/(12 s) over directions is 0.29 times the covector's length.
void AddSamples(const BoundarySamples& samples, double weight, double texel, double most_pixels,
                WhitenedSamples* whitened) {
  const glm::dmat3& t = whitened->whitened_from_ray;
  const double most_length = most_pixels / (0.29 * std::sqrt(12.0) * texel);
  for (size_t i = 0; i < samples.size(); ++i) {
    const glm::dvec3 p = t * samples.Ray(i);
    if (!(p.z > 0.0)) continue;
    const glm::dvec3 dp1 = t * samples.RayDx1(i);
    const glm::dvec3 dp2 = t * samples.RayDx2(i);
    const double det = glm::dot(p, glm::cross(dp1, dp2));
    const glm::dvec3 edge = glm::cross(p, -samples.n2[i] * dp1 + samples.n1[i] * dp2);
    const glm::dvec3 full = edge * (samples.length[i] * p.z / det);
    // The covector at the axis (0, 0, 1) is (E1, E2).
    const double length = std::sqrt(full.x * full.x + full.y * full.y);
    const glm::dvec3 e = full * (length > most_length ? weight * most_length / length : weight);
    if (!std::isfinite(e.x) || !std::isfinite(e.y) || !std::isfinite(e.z)) continue;
    whitened->x.push_back(static_cast<float>(p.x / p.z));
    whitened->y.push_back(static_cast<float>(p.y / p.z));
    whitened->e1.push_back(static_cast<float>(e.x));
    whitened->e2.push_back(static_cast<float>(e.y));
    whitened->e3.push_back(static_cast<float>(e.z));
  }
}

void PadToLanes(WhitenedSamples* samples) {
  for (std::vector<float>* lane : {&samples->x, &samples->y, &samples->e1, &samples->e2, &samples->e3}) {
    lane->resize((lane->size() + kEdgeLanes - 1) / kEdgeLanes * kEdgeLanes, 0.0f);
  }
}

}  // namespace

WhitenedSamples Whiten(const LightProblem& problem, const RayHull& hull, double rough_weight) {
  WhitenedSamples whitened;
  const ImagePlane plane = ImagePlane::About(hull.axis);
  std::vector<glm::dvec2> polygon;
  polygon.reserve(hull.vertices.size());
  for (const glm::dvec3& r : hull.vertices) polygon.push_back(plane.Project(r));
  const Moments moments = MomentsOf(polygon);
  const glm::dmat2 scale = InverseSquareRoot(moments);

  // Rows: scale (b - mean axis^T) and the axis itself.
  const glm::dvec3 c1 = plane.b1 - moments.mean.x * plane.axis;
  const glm::dvec3 c2 = plane.b2 - moments.mean.y * plane.axis;
  const glm::dvec3 row1 = scale[0][0] * c1 + scale[1][0] * c2;
  const glm::dvec3 row2 = scale[0][1] * c1 + scale[1][1] * c2;
  whitened.whitened_from_ray = glm::transpose(glm::dmat3(row1, row2, plane.axis)) * hull.normalized_from_ray;
  for (const glm::dvec2& v : polygon) whitened.hull.push_back(scale * (v - moments.mean));

  const size_t count = problem.samples->boundary.size() + problem.samples->rough_boundary.size();
  for (std::vector<float>* lane : {&whitened.x, &whitened.y, &whitened.e1, &whitened.e2, &whitened.e3}) {
    lane->reserve(count + kEdgeLanes);
  }
  const double texel = 1.0 / std::sqrt(problem.map_size.texels());
  const double most_pixels = problem.samples->pixels_per_sample / 3.0;
  AddSamples(problem.samples->boundary, 1.0, texel, most_pixels, &whitened);
  AddSamples(problem.samples->rough_boundary, rough_weight, texel, most_pixels, &whitened);
  PadToLanes(&whitened);
  return whitened;
}

WhitenedSamples Thin(const WhitenedSamples& samples, int most) {
  const size_t stride = (samples.x.size() + static_cast<size_t>(most) - 1) / static_cast<size_t>(most);
  if (stride <= 1) return samples;
  WhitenedSamples thin;
  thin.whitened_from_ray = samples.whitened_from_ray;
  thin.hull = samples.hull;
  const auto scale = static_cast<float>(stride);
  for (size_t i = 0; i < samples.x.size(); i += stride) {
    thin.x.push_back(samples.x[i]);
    thin.y.push_back(samples.y[i]);
    thin.e1.push_back(samples.e1[i] * scale);
    thin.e2.push_back(samples.e2[i] * scale);
    thin.e3.push_back(samples.e3[i] * scale);
  }
  PadToLanes(&thin);
  return thin;
}

}  // namespace shadowfit
