#include "core/fit/map_partition.h"

#include <gtest/gtest.h>

#include <numeric>
#include <vector>

#include "core/fit/frame_optimizer.h"
#include "core/fit/prediction.h"
#include "core/frame/frame_sampler.h"
#include "tests/support/analytic_scene.h"

namespace shadowfit {
namespace {

using testing::Uniform;

/// What a camera in the middle sees of a room's surface, everywhere in shadow: rays in all directions around
/// a light inside.
LightSamples AllAround(std::mt19937& random, int count) {
  LightSamples samples;
  samples.source = SampleSource::kShadowBoundary;
  for (int i = 0; i < count; ++i) {
    const glm::dvec3 ray = Uniform(random, 2.0, 5.0) * testing::UniformDirection(random);
    const glm::dvec3 across = 0.05 * glm::normalize(glm::cross(ray, testing::UniformDirection(random)));
    const glm::dvec3 other = 0.05 * glm::normalize(glm::cross(ray, across));
    samples.hull_rays.push_back(ray);
    samples.hull_along_ray.push_back(1.0);
    samples.hull_in_shadow.push_back(1);
    samples.hull_rays_dx1.push_back(across);
    samples.hull_rays_dx2.push_back(other);
    const double angle = Uniform(random, 0.0, 6.283);
    samples.boundary.Add(ray, across, other, 1.0, {std::cos(angle), std::sin(angle)}, 1.0);
  }
  return samples;
}

struct Problem {
  Light light = PointLight{{0, 0, 0}};
  RaySpace ray_space = *RaySpace::Create(light);
  LightSamples samples;
  LightProblem problem;

  explicit Problem(LightSamples from) : samples(std::move(from)) {
    problem.light = &light;
    problem.ray_space = &ray_space;
    problem.samples = &samples;
    problem.map_size = {512, 512};
    problem.ws_scene_bounds.Add({-5, -5, -5});
    problem.ws_scene_bounds.Add({5, 5, 5});
  }
};

double Texels(const MapPartition& partition) {
  double texels = 0.0;
  for (const SingleMapFit& map : partition.maps) texels += map.projection.size.texels();
  return texels;
}

bool Holds(const MapPartition& partition, const glm::dvec3& ray) {
  for (const SingleMapFit& map : partition.maps) {
    if (map.projection.Holds(ray, 1e-6 * map.projection.size.width)) return true;
  }
  return false;
}

TEST(MapPartition, HoldsEveryRayAroundALightInsideARoom) {
  std::mt19937 random(1);
  for (int trial = 0; trial < 20; ++trial) {
    const Problem room(AllAround(random, 400));
    const MapPartition partition = PartitionMaps(room.problem, DefaultOptions{});
    EXPECT_GT(partition.maps.size(), 2u);
    EXPECT_LE(partition.maps.size(), static_cast<size_t>(kMostMaps));
    EXPECT_LE(Texels(partition), room.problem.map_size.texels());
    for (const SingleMapFit& map : partition.maps) EXPECT_TRUE(map.complete);
    for (const glm::dvec3& ray : room.samples.hull_rays) EXPECT_TRUE(Holds(partition, ray));
  }
}

TEST(MapPartition, NeverExceedsWhatIsAllowed) {
  std::mt19937 random(2);
  const Problem room(AllAround(random, 400));
  DefaultOptions options;
  options.divide_where_needed = false;
  const MapPartition one = PartitionMaps(room.problem, options);
  EXPECT_EQ(one.maps.size(), 1u);
  EXPECT_FALSE(one.maps[0].complete);
  options.divide_where_needed = true;
  options.most_maps = 3;
  EXPECT_EQ(PartitionMaps(room.problem, options).maps.size(), 3u);
}

TEST(MapPartition, TwoMapsArePredictedNoWorseThanOne) {
  std::mt19937 random(3);
  FrameOptimizer optimizer;
  FrameSummary one;
  FrameSummary two;
  double sum_one = 0.0;
  double sum_two = 0.0;
  int divided = 0;
  for (int trial = 0; trial < 30; ++trial) {
    testing::OwnedFrame frame = testing::Draw(
        testing::RandomSpheres(random, 8), testing::WalkThroughCamera(random, ClipDepth::kNegativeOneToOne),
        64, 64, {testing::RandomLight(random, 0)});
    Options options;
    ASSERT_TRUE(optimizer.Optimize(frame.request, options, Cancellation(), &one).ok());
    options.standard.most_maps = 2;
    ASSERT_TRUE(optimizer.Optimize(frame.request, options, Cancellation(), &two).ok());
    if (!one.lights[0].further_maps.empty()) continue;  // One map does not hold it anyway.
    divided += two.lights[0].further_maps.empty() ? 0 : 1;
    const double pixels_one = one.lights[0].predicted_misclassified_pixels;
    const double pixels_two = two.lights[0].predicted_misclassified_pixels;
    EXPECT_LE(pixels_two, pixels_one) << "trial " << trial;
    sum_one += pixels_one;
    sum_two += pixels_two;
  }
  EXPECT_GT(divided, 5);
  EXPECT_LT(sum_two, 0.9 * sum_one);
}

TEST(MapPartition, SharesTexelsWhereTheyGainMost) {
  // Two far clusters of edges, one nine times as long: by (c_k)^(2/3), but for the clusters' own shapes.
  std::mt19937 random(4);
  LightSamples samples;
  samples.source = SampleSource::kShadowBoundary;
  for (int i = 0; i < 600; ++i) {
    const bool long_edges = i < 300;
    const glm::dvec3 ray((long_edges ? -4.0 : 4.0) + Uniform(random, -0.3, 0.3), Uniform(random, -0.3, 0.3),
                         5.0);
    const glm::dvec3 dx(0.01, 0, 0);
    const glm::dvec3 dy(0, 0.01, 0);
    samples.hull_rays.push_back(ray);
    samples.hull_along_ray.push_back(1.0);
    samples.hull_in_shadow.push_back(1);
    samples.hull_rays_dx1.push_back(dx);
    samples.hull_rays_dx2.push_back(dy);
    const double angle = Uniform(random, 0.0, 6.283);
    samples.boundary.Add(ray, dx, dy, 1.0, {std::cos(angle), std::sin(angle)}, long_edges ? 0.09 : 0.01);
  }
  const Problem clusters(samples);
  DefaultOptions options;
  options.most_maps = 2;
  const MapPartition partition = PartitionMaps(clusters.problem, options);
  ASSERT_EQ(partition.maps.size(), 2u);
  double texels[2] = {0.0, 0.0};
  for (const SingleMapFit& map : partition.maps) {
    texels[map.projection.Holds({-4.0, 0.0, 5.0}) ? 0 : 1] = map.projection.size.texels();
  }
  EXPECT_NEAR(texels[0] / texels[1], std::cbrt(81.0), 0.25 * std::cbrt(81.0));
}

}  // namespace
}  // namespace shadowfit
