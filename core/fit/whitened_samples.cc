#include "core/fit/whitened_samples.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/fit/edge_kernels.h"
#include "core/fit/metric.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/fit/whitened_samples.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/fit/boundary_lanes-inl.h"
#include "core/frame/packing_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

/// Appends every stride-th of the samples from `first` on, with stride times its length, to element `next`
/// and those behind it, where the arrays have room for as many and a vector more. Returns one past the last
/// element.
size_t AddSamples(const BoundarySamples& samples, size_t first, size_t stride, size_t next,
                  WhitenedSamples* whitened) {
  const DoubleLanes d;
  const hn::Rebind<float, DoubleLanes> df;
  const glm::dmat3& t = whitened->whitened_from_ray;
  const auto weight = hn::Set(d, static_cast<double>(stride));
  const auto add = [&](const auto& load) {
    const Doubles3 p = Times(t, load(samples.r));
    const Doubles3 dp1 = Times(t, load(samples.dr1));
    const Doubles3 dp2 = Times(t, load(samples.dr2));
    const Doubles n1 = load(samples.n1);
    const Doubles n2 = load(samples.n2);
    const auto across = [&](Doubles along1, Doubles along2) {
      return hn::Sub(hn::Mul(n1, along2), hn::Mul(n2, along1));
    };
    const Doubles3 edge = Cross(p, {across(dp1.x, dp2.x), across(dp1.y, dp2.y), across(dp1.z, dp2.z)});
    const Doubles length = hn::Mul(weight, load(samples.length));
    const Doubles scale = hn::Div(hn::Mul(length, p.z), Dot(p, Cross(dp1, dp2)));
    const Doubles3 e = Scaled(edge, scale);
    const auto usable = hn::And(hn::And(hn::Gt(p.z, hn::Zero(d)), hn::Gt(length, hn::Zero(d))),
                                hn::And(hn::IsFinite(e.x), hn::And(hn::IsFinite(e.y), hn::IsFinite(e.z))));
    const Packing packed(df, hn::RebindMask(df, Narrow(d, usable)));
    const auto store = [&](Doubles v, std::vector<float>* to) {
      hn::StoreU(packed(hn::DemoteTo(df, v)), df, to->data() + next);
    };
    const Doubles inverse_z = hn::Div(hn::Set(d, 1.0), p.z);
    store(hn::Mul(p.x, inverse_z), &whitened->x);
    store(hn::Mul(p.y, inverse_z), &whitened->y);
    store(e.x, &whitened->e1);
    store(e.y, &whitened->e2);
    store(e.z, &whitened->e3);
    const Doubles inverse_length = hn::Div(hn::Set(d, 1.0), length);
    store(hn::Mul(hn::Set(d, 1.0 / samples.limit), inverse_length), &whitened->inverse_limit);
    store(hn::Mul(hn::Set(d, 1.0 / kUnseenEdgeLimit), inverse_length), &whitened->inverse_tail_limit);
    store(load(samples.tail), &whitened->tail);
    next += hn::CountTrue(d, usable);
  };
  if (stride == 1) {
    ForBoundaryLanes(samples.size(), add);
  } else {
    ForSomeBoundaryLanes(first, stride, samples.size(), add);
  }
  return next;
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {
namespace {

HWY_EXPORT(AddSamples);

constexpr size_t kMostDoubles = 8;  // Lanes of a vector.

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

std::array<std::vector<float>*, 8> Arrays(WhitenedSamples* samples) {
  return {&samples->x,
          &samples->y,
          &samples->e1,
          &samples->e2,
          &samples->e3,
          &samples->inverse_limit,
          &samples->inverse_tail_limit,
          &samples->tail};
}

/// Of every stride-th sample.
WhitenedSamples WhitenEvery(size_t stride, const LightProblem& problem, const RayHull& hull) {
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

  const size_t most = (problem.samples->EdgeSamples() + stride - 1) / stride;
  for (std::vector<float>* lane : Arrays(&whitened)) lane->resize(most + kMostDoubles);
  const auto add = HWY_DYNAMIC_DISPATCH(AddSamples);
  size_t count = 0;
  size_t first = 0;
  for (const BoundarySamples* samples : problem.samples->Boundaries()) {
    count = add(*samples, first, stride, count, &whitened);
    // The steps go on from one list to the next.
    first = (first + stride - samples->size() % stride) % stride;
  }
  for (std::vector<float>* lane : Arrays(&whitened)) {
    lane->resize(count);
    lane->resize(PaddedToEdgeLanes(count), 0.0f);
  }
  return whitened;
}

}  // namespace

WhitenedSamples Whiten(const LightProblem& problem, const RayHull& hull) {
  return WhitenEvery(1, problem, hull);
}

std::optional<TexelGrid> GridOf(const glm::dmat3& texel_from_whitened) {
  const glm::dmat3 rows = glm::transpose(texel_from_whitened);
  if (!(rows[2].z > 0.0)) return std::nullopt;
  const glm::dvec3 axis = rows[2] / rows[2].z;
  // h_k = (a_k, 0) + t_k axis, times the axis row's z.
  const auto across = [&](const glm::dvec3& row) {
    return (glm::dvec2(row) - row.z * glm::dvec2(axis)) / rows[2].z;
  };
  const glm::dmat2 plane_from_texel =
      glm::inverse(glm::transpose(glm::dmat2(across(rows[0]), across(rows[1]))));
  return TexelGrid{glm::dvec2(axis), plane_from_texel[0], plane_from_texel[1]};
}

WhitenedSamples TangentAt(const WhitenedSamples& samples, const TexelGrid& map, double* metric) {
  WhitenedSamples tangent = samples;
  const float sum =
      WeighByTangent(samples.x.data(), samples.y.data(),
                     {samples.inverse_limit.data(), samples.inverse_tail_limit.data(), samples.tail.data()},
                     samples.x.size(), Rounded(map.axis).data(), Rounded(map.step1).data(),
                     Rounded(map.step2).data(), tangent.e1.data(), tangent.e2.data(), tangent.e3.data());
  if (metric != nullptr) *metric = static_cast<double>(sum);
  return tangent;
}

WhitenedSamples WhitenSome(const LightProblem& problem, const RayHull& hull, int most) {
  const size_t count = problem.samples->EdgeSamples();
  const auto limit = static_cast<size_t>(most);
  return WhitenEvery(std::max<size_t>(1, (count + limit - 1) / limit), problem, hull);
}

}  // namespace shadowfit
#endif
