#include "core/fit/metric.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/fit/frobenius_moments.h"
#include "core/frame/frame_sampler.h"
#include "core/math/shadow_projection.h"
#include "tests/support/analytic_scene.h"

namespace shadowfit {
namespace {

using testing::Uniform;

/// One configuration: a light, a camera, a plane that both see, and a random valid matrix.
struct Configuration {
  RaySpace ray_space;
  Camera camera;
  glm::dvec3 ws_normal;
  double plane_distance;
  glm::dmat3 texel_from_ray;

  /// The plane's point at continuous screen coordinates (pixels of a 100x100 screen).
  glm::dvec3 PointAt(double x1, double x2) const {
    const glm::dvec2 ndc(x1 / 50.0 - 1.0, x2 / 50.0 - 1.0);
    const glm::dvec4 a = camera.WsFromNdc({ndc, NearNdc(camera.clip_depth())});
    const glm::dvec4 b = camera.WsFromNdc({ndc, FarNdc(camera.clip_depth())});
    const glm::dvec3 origin = glm::dvec3(a) / a.w;
    const glm::dvec3 direction = glm::dvec3(b) / b.w - origin;
    const double t = (plane_distance - glm::dot(ws_normal, origin)) / glm::dot(ws_normal, direction);
    return origin + t * direction;
  }
  glm::dvec2 TexelAt(double x1, double x2) const {
    const glm::dvec3 h = texel_from_ray * ray_space.RayFromPoint(PointAt(x1, x2));
    return glm::dvec2(h) / h.z;
  }
  BoundarySamples Samples() const {
    // Unprojection's derivatives, as the sampler forms them: along the plane.
    BoundarySamples samples;
    for (const glm::dvec2 x : {glm::dvec2(31.5, 22.5), glm::dvec2(60.5, 40.5), glm::dvec2(48.5, 30.5)}) {
      const double step = 1e-4;
      const auto derivative = [&](const glm::dvec2& d) {
        // Fourth-order central difference.
        const auto at = [&](double k) { return PointAt(x.x + k * step * d.x, x.y + k * step * d.y); };
        return (8.0 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12.0 * step);
      };
      samples.Add(ray_space.RayFromPoint(PointAt(x.x, x.y)), ray_space.RayFromVector(derivative({1, 0})),
                  ray_space.RayFromVector(derivative({0, 1})), 0.0, {0.6, 0.8}, 1.0);
    }
    return samples;
  }
};

Configuration RandomConfiguration(std::mt19937& random, int kind) {
  for (;;) {
    Configuration c{*RaySpace::Create(PointLight{}),
                    *Camera::Create(testing::WalkThroughCamera(random, static_cast<ClipDepth>(random() % 3))),
                    {},
                    0.0,
                    {}};
    c.ws_normal = glm::normalize(glm::dvec3(Uniform(random, -0.3, 0.3), Uniform(random, -0.3, 0.3), 1.0));
    c.plane_distance = Uniform(random, -0.2, 0.2);
    glm::dvec3 from = testing::UniformDirection(random);
    from.z = std::abs(from.z) + 0.3;
    const glm::dvec3 position = 8.0 * from;
    if (kind == 0) c.ray_space = *RaySpace::Create(PointLight{position});
    if (kind == 1) c.ray_space = *RaySpace::Create(SpotLight{position, -from, 0.9});
    if (kind == 2) c.ray_space = *RaySpace::Create(DirectionalLight{-from});
    for (int column = 0; column < 3; ++column) {
      for (int row = 0; row < 3; ++row) c.texel_from_ray[column][row] = Uniform(random, -1, 1);
    }
    const BoundarySamples samples = c.Samples();
    bool good = true;
    for (size_t i = 0; i < samples.size(); ++i) {
      const glm::dvec3 r = samples.Ray(i);
      const double w = (c.texel_from_ray * r).z;
      if (w < 0.0)
        c.texel_from_ray = -c.texel_from_ray;  // Both signs mean the same map; only w > 0 is valid.
    }
    for (size_t i = 0; i < samples.size(); ++i) {
      good = good && (c.texel_from_ray * samples.Ray(i)).z > 0.15 * glm::length(samples.Ray(i)) &&
             std::isfinite(glm::length(samples.RayDx1(i))) && glm::length(samples.RayDx1(i)) < 1.0 &&
             glm::length(samples.RayDx2(i)) < 1.0;
      // Differences tell nothing beside a pole: det J far enough from zero.
      const glm::dmat2 j =
          TexelJacobian(c.texel_from_ray, samples.Ray(i), samples.RayDx1(i), samples.RayDx2(i));
      good = good && std::abs(glm::determinant(j)) > 0.05 * (glm::dot(j[0], j[0]) + glm::dot(j[1], j[1]));
    }
    if (good) return c;
  }
}

class MetricByKind : public ::testing::TestWithParam<int> {};

TEST_P(MetricByKind, JacobianAgreesWithCentralDifferences) {
  std::mt19937 random(7 + static_cast<uint32_t>(GetParam()));
  for (int trial = 0; trial < 334; ++trial) {
    const Configuration c = RandomConfiguration(random, GetParam());
    const BoundarySamples samples = c.Samples();
    const glm::dmat2 jacobian =
        TexelJacobian(c.texel_from_ray, samples.Ray(0), samples.RayDx1(0), samples.RayDx2(0));
    const double step = 1e-3;
    for (int j = 0; j < 2; ++j) {
      const glm::dvec2 d(j == 0 ? step : 0.0, j == 1 ? step : 0.0);
      const glm::dvec2 numeric =
          (8.0 * (c.TexelAt(31.5 + d.x, 22.5 + d.y) - c.TexelAt(31.5 - d.x, 22.5 - d.y)) -
           (c.TexelAt(31.5 + 2 * d.x, 22.5 + 2 * d.y) - c.TexelAt(31.5 - 2 * d.x, 22.5 - 2 * d.y))) /
          (12.0 * step);
      EXPECT_LT(glm::length(jacobian[j] - numeric), 1e-6 * glm::length(numeric)) << "trial " << trial;
    }
  }
}

TEST_P(MetricByKind, MomentsAgreeWithTheSumAndItsCentralDifferences) {
  std::mt19937 random(70 + static_cast<uint32_t>(GetParam()));
  for (int trial = 0; trial < 334; ++trial) {
    const Configuration c = RandomConfiguration(random, GetParam());
    const BoundarySamples samples = c.Samples();
    const FrobeniusMoments moments(samples, glm::dmat3(1.0));
    const double value = FrobeniusMetric(samples, c.texel_from_ray);
    EXPECT_NEAR(moments.Value(c.texel_from_ray), value, 1e-9 * value) << "trial " << trial;
    const glm::dvec3 gradient = moments.AxisGradient(c.texel_from_ray);
    glm::dvec3 numeric(0.0);
    for (int k = 0; k < 3; ++k) {
      const auto at = [&](double offset) {
        glm::dmat3 moved = c.texel_from_ray;
        moved[k][2] += offset;
        return FrobeniusMetric(samples, moved);
      };
      const double e = 1e-4;
      numeric[k] =
          (45.0 * (at(e) - at(-e)) - 9.0 * (at(2 * e) - at(-2 * e)) + (at(3 * e) - at(-3 * e))) / (60.0 * e);
    }
    EXPECT_LT(glm::length(gradient - numeric), 1e-6 * glm::length(numeric)) << "trial " << trial;
  }
}

INSTANTIATE_TEST_SUITE_P(LightKinds, MetricByKind, ::testing::Values(0, 1, 2));

TEST(Metrics, AddUpWhatTheirDefinitionsGiveForEachSample) {
  // Any number of samples, so that the last vector of them is only partly filled; some behind the axis plane,
  // some without area.
  std::mt19937 random(73);
  const auto vector = [&random](double size) {
    return size * glm::dvec3(Uniform(random, -1, 1), Uniform(random, -1, 1), Uniform(random, -1, 1));
  };
  for (int count = 0; count < 40; ++count) {
    const glm::dmat3 texel_from_ray(glm::dvec3(100, 3, 0.1), glm::dvec3(-5, 90, -0.2), glm::dvec3(50, 40, 1));
    BoundarySamples samples;
    double frobenius = 0.0;
    double edge = 0.0;
    for (int i = 0; i < count; ++i) {
      const glm::dvec3 r = vector(0.5) + glm::dvec3(0, 0, i % 5 == 0 ? -1 : 1);
      const glm::dvec3 dr1 = vector(0.03);
      const glm::dvec3 dr2 = i % 7 == 0 ? dr1 : vector(0.03);
      const double angle = Uniform(random, 0, 6);
      const glm::dvec2 n(std::cos(angle), std::sin(angle));
      const double length = Uniform(random, 0.5, 1.5);
      const double tail = i % 3 == 0 ? Uniform(random, 0, 1) : 0.0;
      samples.Add(r, dr1, dr2, 0.0, n, length, tail);
      const double w = (texel_from_ray * r).z;
      const glm::dmat2 jacobian = TexelJacobian(texel_from_ray, r, dr1, dr2);
      if (!(w > 0.0) || i % 7 == 0) continue;
      const glm::dmat2 inverse = glm::inverse(jacobian);
      frobenius += glm::dot(inverse[0], inverse[0]) + glm::dot(inverse[1], inverse[1]);
      const glm::dvec2 across = glm::abs(n * inverse);
      const double s = std::max(across.x, across.y);
      const double t = std::min(across.x, across.y);
      const double y = s / 4.0 + t * t / (12.0 * s);
      const double pixels = length * ((1.0 - tail) * y * kEdgeLimit / (y + kEdgeLimit) +
                                      tail * y * kUnseenEdgeLimit / (y + kUnseenEdgeLimit));
      edge += pixels;
      const auto sample = static_cast<size_t>(i);
      EXPECT_NEAR(EdgeDisplacement(samples, sample, texel_from_ray), y, 1e-9 * y);
      EXPECT_NEAR(EdgeMetricOfSample(samples, sample, texel_from_ray), pixels, 1e-9 * pixels);
    }
    EXPECT_NEAR(FrobeniusMetric(samples, texel_from_ray), frobenius, 1e-9 * frobenius) << count;
    EXPECT_NEAR(EdgeMetric(samples, texel_from_ray), edge, 1e-9 * edge) << count;
  }
}

TEST(EdgeMetric, IsKnownEdgeByEdgeWithItsSlopesAlongATexelsSides) {
  std::mt19937 random(14);
  for (int trial = 0; trial < 300; ++trial) {
    const Configuration c = RandomConfiguration(random, trial % 3);
    const BoundarySamples samples = c.Samples();
    const ShadowProjection map{c.texel_from_ray, {320, 200}};
    EdgesOnMap edges;
    AppendEdges(samples, map, &edges);
    AppendEdges(samples, map, &edges);
    ASSERT_EQ(edges.x.size(), 2 * samples.size());
    // A texel is wider by e^step where the map has as many fewer texels to the same width.
    const double step = 1e-4;
    const auto pixels_with = [&](size_t i, double width, double height) {
      glm::dmat3 resized(1.0);
      resized[0][0] = std::exp(-width);
      resized[1][1] = std::exp(-height);
      return EdgeMetricOfSample(samples, i, resized * c.texel_from_ray);
    };
    for (size_t k = 0; k < edges.x.size(); ++k) {
      const size_t i = k % samples.size();
      const glm::dvec3 u = map.TexelFromRay(samples.Ray(i));
      EXPECT_NEAR(edges.x[k], u.x / 320.0, 1e-5 * (1.0 + std::abs(u.x)));
      EXPECT_NEAR(edges.y[k], u.y / 200.0, 1e-5 * (1.0 + std::abs(u.y)));
      const double pixels = EdgeMetricOfSample(samples, i, c.texel_from_ray);
      EXPECT_NEAR(edges.pixels[k], pixels, 1e-6 * pixels);
      const double per_width = (pixels_with(i, step, 0) - pixels_with(i, -step, 0)) / (2.0 * step);
      const double per_height = (pixels_with(i, 0, step) - pixels_with(i, 0, -step)) / (2.0 * step);
      EXPECT_NEAR(edges.per_width[k], per_width, 1e-4 * pixels);
      EXPECT_NEAR(edges.per_height[k], per_height, 1e-4 * pixels);
    }
  }
}

TEST(EdgeMetric, OfSeveralMapsIsThatOfTheFirstThatHoldsEachSample) {
  std::mt19937 random(74);
  const auto vector = [&random](double size) {
    return size * glm::dvec3(Uniform(random, -1, 1), Uniform(random, -1, 1), Uniform(random, -1, 1));
  };
  int by_second = 0;
  int by_none = 0;
  for (int count = 0; count < 40; ++count) {
    // Overlapping maps of parts of what the samples span, and the light's other side beyond them.
    std::vector<ShadowProjection> maps(3);
    for (ShadowProjection& map : maps) {
      map.size = {static_cast<int>(Uniform(random, 20, 60)), static_cast<int>(Uniform(random, 20, 60))};
      map.texel_from_ray = {glm::dvec3(60, 3, 0.1) + vector(5.0), glm::dvec3(-5, 50, -0.2) + vector(5.0),
                            glm::dvec3(30, 20, 1) + glm::dvec3(20, 20, 0) * vector(1.0)};
    }
    BoundarySamples samples;
    double sum = 0.0;
    for (int i = 0; i < count; ++i) {
      samples.Add(vector(0.7) + glm::dvec3(0, 0, i % 9 == 0 ? -1 : 1), vector(0.03), vector(0.03), 0.0,
                  {0.6, 0.8}, Uniform(random, 0.5, 1.5));
      const auto sample = static_cast<size_t>(i);
      const auto map = std::find_if(maps.begin(), maps.end(),
                                    [&](const ShadowProjection& m) { return m.Holds(samples.Ray(sample)); });
      by_second += map == maps.begin() + 1 ? 1 : 0;
      by_none += map == maps.end() ? 1 : 0;
      if (map != maps.end()) sum += EdgeMetricOfSample(samples, sample, map->texel_from_ray);
    }
    EXPECT_NEAR(EdgeMetricOfHeld(samples, maps), sum, 1e-9 * sum) << count;
    EXPECT_EQ(EdgeMetricOfHeld(samples, {}), 0.0);
  }
  EXPECT_GT(by_second, 20);
  EXPECT_GT(by_none, 20);
}

TEST(EdgeMetric, DisplacementEqualsTheMonteCarloAreaBetweenAnEdgeAndItsSteppedImage) {
  // Texel grids at random affine positions over a straight edge: a pixel is wrong where its texel's centre
  // lies on the other side of the edge.
  std::mt19937 random(3);
  for (int trial = 0; trial < 5; ++trial) {
    const double angle = Uniform(random, 0.0, 6.28);
    const glm::dmat2 pixel_from_texel(glm::dvec2(Uniform(random, 3, 9), Uniform(random, -2, 2)),
                                      glm::dvec2(Uniform(random, -2, 2), Uniform(random, 3, 9)));
    const glm::dmat2 texel_from_pixel = glm::inverse(pixel_from_texel);
    const glm::dvec2 n(std::cos(angle), std::sin(angle));
    const glm::dvec2 t(-n.y, n.x);
    // The light's rays are a plane here: r = (x1, x2, 1).
    BoundarySamples samples;
    samples.Add({0, 0, 1}, {1, 0, 0}, {0, 1, 0}, 0.0, n, 1.0);
    const glm::dmat3 texel_from_ray(glm::dvec3(texel_from_pixel[0], 0), glm::dvec3(texel_from_pixel[1], 0),
                                    {0, 0, 1});
    const double predicted = EdgeDisplacement(samples, 0, texel_from_ray);

    const double reach = 25.0;  // Pixels to either side of the edge that could be wrong.
    int wrong = 0;
    const int shots = 400000;
    for (int i = 0; i < shots; ++i) {
      const glm::dvec2 x = t * Uniform(random, -500, 500) + n * Uniform(random, -reach, reach);
      const glm::dvec2 u = texel_from_pixel * x;
      const glm::dvec2 centre = pixel_from_texel * (glm::floor(u) + 0.5);
      wrong += (glm::dot(n, x) > 0.0) != (glm::dot(n, centre) > 0.0) ? 1 : 0;
    }
    EXPECT_NEAR(2.0 * reach * wrong / shots, predicted, 0.03 * predicted);
  }
}

TEST(FrobeniusMedian, IsTheMiddleOfTheSamplesBadness) {
  BoundarySamples samples;
  for (const double stretch : {1.0, 2.0, 5.0})
    samples.Add({0, 0, 1}, {stretch, 0, 0}, {0, stretch, 0}, 0.0, {1, 0}, 1.0);
  std::vector<double> scratch;
  // J = stretch * I, so ||J^-1||^2 = 2 / stretch^2.
  EXPECT_DOUBLE_EQ(FrobeniusMedian(samples, glm::dmat3(1.0), &scratch), 0.5);
  EXPECT_EQ(FrobeniusMedian(BoundarySamples{}, glm::dmat3(1.0), &scratch), 0.0);
}

}  // namespace
}  // namespace shadowfit
