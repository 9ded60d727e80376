#include "core/fit/dividing_lines.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "core/fit/sample_parts.h"
#include "core/fit/texel_shares.h"
#include "tests/support/analytic_scene.h"

namespace shadowfit {
namespace {

using testing::Uniform;

void AddSample(const glm::dvec2& texel, LightSamples* samples) {
  const glm::dvec3 ray(texel, 1.0);
  samples->hull_rays.push_back(ray);
  samples->hull_along_ray.push_back(1.0);
  samples->hull_in_shadow.push_back(1);
  samples->hull_rays_dx1.push_back({1, 0, 0});
  samples->hull_rays_dx2.push_back({0, 1, 0});
  samples->boundary.Add(ray, {1, 0, 0}, {0, 1, 0}, 1.0, {1, 0}, 2.0);
}

/// Two round clusters of samples, far apart, in a map whose texels are the rays themselves.
LightSamples TwoClusters(std::mt19937& random, const glm::dvec2& one, const glm::dvec2& other) {
  LightSamples samples;
  samples.source = SampleSource::kShadowBoundary;
  for (int i = 0; i < 300; ++i) {
    const glm::dvec2 off(testing::UniformDirection(random));
    AddSample((i % 3 == 0 ? one : other) + 10.0 * off, &samples);
  }
  return samples;
}

bool Separates(const DividingLine& line, const glm::dvec2& one, const glm::dvec2& other) {
  const double at_one = glm::dot(line.Normal(), one) - line.offset;
  const double at_other = glm::dot(line.Normal(), other) - line.offset;
  return std::min(at_one, at_other) < -8.0 && std::max(at_one, at_other) > 8.0;
}

TEST(DividingLines, FindTheGapBetweenTwoClusters) {
  std::mt19937 random(1);
  for (int trial = 0; trial < 50; ++trial) {
    const double angle = Uniform(random, 0.0, 6.283);
    const glm::dvec2 middle(Uniform(random, 0.0, 300.0), Uniform(random, 0.0, 300.0));
    const glm::dvec2 away = 60.0 * glm::dvec2(std::cos(angle), std::sin(angle));
    const LightSamples samples = TwoClusters(random, middle - away, middle + away);
    const DividingLines lines(samples, glm::dmat3(1.0));
    const std::vector<DividingLine> promising = lines.Promising();
    const auto separating = std::count_if(promising.begin(), promising.end(), [&](const DividingLine& line) {
      return Separates(line, middle - away, middle + away);
    });
    // Lines of most directions fit through the gap: all but those nearly along the line of centres.
    EXPECT_GE(separating, static_cast<long>(promising.size()) / 2) << "trial " << trial;
  }
}

TEST(DividingLines, NoneForAHandfulOfSamples) {
  LightSamples samples;
  for (int i = 0; i < 7; ++i) AddSample({i, i * i}, &samples);
  EXPECT_TRUE(DividingLines(samples, glm::dmat3(1.0)).Promising().empty());
}

TEST(DividingLines, EqualSamplesAreHarmless) {
  LightSamples samples;
  for (int i = 0; i < 50; ++i) AddSample({3, 4}, &samples);
  for (const DividingLine& line : DividingLines(samples, glm::dmat3(1.0)).Promising()) {
    EXPECT_TRUE(std::isfinite(line.offset));
  }
}

TEST(DividingLines, NeighboursTurnAndMove) {
  std::mt19937 random(2);
  const LightSamples samples = TwoClusters(random, {0, 0}, {100, 0});
  const DividingLines lines(samples, glm::dmat3(1.0));
  const DividingLine line{0.3, 40.0};
  const auto near = lines.Near(line, 0.5);
  EXPECT_LT(near[0].angle, line.angle);
  EXPECT_GT(near[1].angle, line.angle);
  EXPECT_LT(near[2].offset, line.offset);
  EXPECT_GT(near[3].offset, line.offset);
  const auto nearer = lines.Near(line, 0.25);
  EXPECT_NEAR(nearer[1].angle - line.angle, 0.5 * (near[1].angle - line.angle), 1e-12);
  EXPECT_NEAR(nearer[3].offset - line.offset, 0.5 * (near[3].offset - line.offset), 1e-9);
}

TEST(DividingLines, CovectorsDivideRaysAsLinesDivideTexels) {
  std::mt19937 random(3);
  const LightSamples samples = TwoClusters(random, {0, 0}, {100, 0});
  const glm::dmat3 texel_from_ray(glm::dvec3(2, 0.3, 0.001), {-0.2, 3, 0.002}, {5, -7, 1});
  const DividingLines lines(samples, texel_from_ray);
  for (const DividingLine& line : lines.Promising()) {
    for (const glm::dvec3& ray : samples.hull_rays) {
      const glm::dvec3 u = texel_from_ray * ray;
      const double side = glm::dot(line.Normal(), glm::dvec2(u) / u.z) - line.offset;
      if (std::abs(side) < 1e-6) continue;
      EXPECT_EQ(glm::dot(lines.Covector(line), ray) > 0.0, side > 0.0);
    }
  }
}

TEST(SampleParts, PlanesAndCubeFacesLoseNothing) {
  std::mt19937 random(4);
  LightSamples samples = TwoClusters(random, {0, 0}, {100, 0});
  samples.rough_boundary = samples.boundary;
  samples.narrow_share = 0.25;
  const glm::dvec3 covector(1, 0, -30);
  const std::vector<LightSamples> halves = DivideByPlane(samples, covector);
  ASSERT_EQ(halves.size(), 2u);
  for (size_t side = 0; side < 2; ++side) {
    EXPECT_EQ(halves[side].narrow_share, 0.25);
    EXPECT_EQ(halves[side].source, samples.source);
    EXPECT_EQ(halves[side].boundary.size(), side == 0 ? 100u : 200u);
    for (const glm::dvec3& ray : halves[side].hull_rays) EXPECT_EQ(glm::dot(covector, ray) > 0.0, side == 1);
  }
  size_t boundary = 0;
  size_t rough = 0;
  size_t hull = 0;
  for (const LightSamples& face : DivideByCubeFaces(samples)) {
    boundary += face.boundary.size();
    rough += face.rough_boundary.size();
    hull += face.hull_rays.size();
    ASSERT_EQ(face.hull_in_shadow.size(), face.hull_rays.size());
  }
  EXPECT_EQ(boundary, samples.boundary.size());
  EXPECT_EQ(rough, samples.rough_boundary.size());
  EXPECT_EQ(hull, samples.hull_rays.size());
}

TEST(TexelShares, AreLeastInSum) {
  std::mt19937 random(6);
  for (int trial = 0; trial < 100; ++trial) {
    std::vector<double> costs;
    for (int k = 0; k < 4; ++k) costs.push_back(Uniform(random, 1.0, 8.0));
    const std::vector<double> shares = SharesOfTexels(costs);
    const auto total = [&](const std::vector<double>& with) {
      double sum = 0.0;
      for (size_t k = 0; k < costs.size(); ++k) sum += costs[k] / std::sqrt(with[k]);
      return sum;
    };
    EXPECT_NEAR(total(shares), CostAtBestShares(costs), 1e-9 * total(shares));
    std::vector<double> other = shares;
    other[0] += 0.01;
    other[1] -= 0.01;
    EXPECT_GT(total(other), total(shares));
  }
}

TEST(TexelShares, NoMapIsLeftWithAHandful) {
  for (const std::vector<double>& costs : {std::vector{1e60, 1e-9, 0.0}, {0.0, 0.0, 0.0}, {5.0, 5.0, 1e-3}}) {
    const std::vector<double> shares = SharesOfTexels(costs);
    double sum = 0.0;
    for (const double share : shares) {
      EXPECT_GT(share, 0.7 * kLeastShare / static_cast<double>(costs.size()));
      sum += share;
    }
    EXPECT_NEAR(sum, 1.0, 1e-12);
  }
}

}  // namespace
}  // namespace shadowfit
