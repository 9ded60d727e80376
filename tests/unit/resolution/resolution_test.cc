#include "core/resolution/resolution.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <glm/gtc/matrix_transform.hpp>
#include <limits>
#include <numbers>
#include <random>
#include <vector>

#include "core/resolution/light_maps.h"
#include "random.h"

namespace shadowfit {
namespace {

using ::testing::HasSubstr;
using ::testing::StartsWith;

glm::dmat4 Perspective(double tan_x, double tan_y, double near, double far, ClipDepth convention) {
  glm::dmat4 m(0.0);
  m[0][0] = 1.0 / tan_x;
  m[1][1] = 1.0 / tan_y;
  m[2][3] = -1.0;
  const double near_ndc = NearNdc(convention);
  const double far_ndc = FarNdc(convention);
  // ndc * distance = a * -distance + b at near and far.
  m[2][2] = (near_ndc * near - far_ndc * far) / (far - near);
  m[3][2] = near_ndc * near + m[2][2] * near;
  return m;
}

glm::dmat4 Orthographic(double half_x, double half_y, double near, double far, ClipDepth convention) {
  glm::dmat4 m(1.0);
  m[0][0] = 1.0 / half_x;
  m[1][1] = 1.0 / half_y;
  m[2][2] = -(FarNdc(convention) - NearNdc(convention)) / (far - near);
  m[3][2] = NearNdc(convention) + m[2][2] * near;
  return m;
}

glm::dmat4 RandomView(Random& random, glm::dvec3* eye, glm::dvec3* forward) {
  *eye = random.Vector(10.0);
  *forward = random.Direction();
  glm::dvec3 up = random.Direction();
  while (std::abs(glm::dot(up, *forward)) > 0.95) up = random.Direction();
  return glm::lookAt(*eye, *eye + *forward, up);
}

struct Frame {
  CameraMatrices camera;
  glm::dvec3 eye{0.0};
  glm::dvec3 forward{0.0, 0.0, -1.0};
  std::vector<float> pixels;
  DepthView depth;
};

float WindowDepth(const CameraMatrices& camera, const glm::dvec3& ws) {
  const glm::dvec4 clip = camera.clip_from_view * camera.view_from_world * glm::dvec4(ws, 1.0);
  const double ndc = clip.z / clip.w;
  return static_cast<float>(camera.clip_depth == ClipDepth::kNegativeOneToOne ? 0.5 * ndc + 0.5 : ndc);
}

/// Depth of a few spheres before a plane, or noise, with background, NaN and infinities sprinkled in.
Frame RandomFrame(Random& random, int max_width = 190, int max_height = 60) {
  Frame frame;
  frame.camera.clip_depth = static_cast<ClipDepth>(random.Int(0, 2));
  frame.camera.view_from_world = RandomView(random, &frame.eye, &frame.forward);
  const double near = random.In(0.05, 1.0);
  const double far = near * random.In(20.0, 2000.0);
  if (random.Int(0, 4) == 0) {
    frame.camera.clip_from_view =
        Orthographic(random.In(1, 10), random.In(1, 10), near, far, frame.camera.clip_depth);
  } else {
    frame.camera.clip_from_view =
        Perspective(random.In(0.2, 1.5), random.In(0.2, 1.5), near, far, frame.camera.clip_depth);
  }
  const bool tiny = random.Int(0, 9) == 0;
  const int width = random.Int(1, tiny ? 3 : max_width);
  const int height = random.Int(1, tiny ? 3 : max_height);
  frame.pixels.resize(static_cast<size_t>(width * height));
  const Camera camera = Camera::Create(frame.camera).value();
  const bool noise = random.Int(0, 5) == 0;
  const double broken = random.Int(0, 2) == 0 ? random.In(0.0, 0.3) : 0.0;
  const double plane = random.In(near * 1.5, near * 15.0);
  const glm::dvec3 normal = glm::normalize(-frame.forward + 0.6 * random.Direction());
  const float background = static_cast<float>(BackgroundWindowDepth(frame.camera.clip_depth));
  struct Sphere {
    glm::dvec3 centre;
    double radius;
  };
  std::vector<Sphere> spheres;
  for (int i = random.Int(0, 4); i > 0; --i) {
    const double distance = random.In(0.3, 1.0) * plane;
    spheres.push_back({frame.eye + distance * (frame.forward + 0.4 * random.Direction()), 0.2 * distance});
  }
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const auto index = static_cast<size_t>(y * width + x);
      if (random.In(0.0, 1.0) < broken) {
        const float kinds[] = {background, kNan, kInf, -kInf, -0.5F, 1.5F};
        frame.pixels[index] = kinds[random.Int(0, 5)];
        continue;
      }
      if (noise) {
        frame.pixels[index] = static_cast<float>(random.In(0.0, 1.0));
        continue;
      }
      const double ndc_x = -1.0 + (2.0 * x + 1.0) / width;
      const double ndc_y = -1.0 + (2.0 * y + 1.0) / height;
      const glm::dvec4 a = camera.WsFromNdc({ndc_x, ndc_y, NearNdc(frame.camera.clip_depth)});
      const glm::dvec4 b = camera.WsFromNdc({ndc_x, ndc_y, 0.5});
      const glm::dvec3 origin = glm::dvec3(a) / a.w;
      const glm::dvec3 direction = glm::normalize(glm::dvec3(b) / b.w - origin);
      double t = glm::dot(frame.eye + plane * frame.forward - origin, normal) / glm::dot(direction, normal);
      if (t <= 0.0) t = kInf;
      for (const Sphere& sphere : spheres) {
        const glm::dvec3 to = sphere.centre - origin;
        const double along = glm::dot(to, direction);
        const double inside = sphere.radius * sphere.radius - glm::dot(to, to) + along * along;
        if (inside > 0.0 && along - std::sqrt(inside) > 0.0) t = std::min(t, along - std::sqrt(inside));
      }
      frame.pixels[index] = std::isfinite(t) ? WindowDepth(frame.camera, origin + t * direction) : background;
    }
  }
  frame.depth = random.Int(0, 1) == 0 ? BottomFirst(frame.pixels.data(), width, height)
                                      : TopFirst(frame.pixels.data(), width, height);
  return frame;
}

/// All kinds of lights, with and without a matrix of their own.
ResolutionLight RandomLight(Random& random, const Frame& frame, int kind) {
  const auto convention = static_cast<ClipDepth>(random.Int(0, 2));
  const glm::dvec3 near_camera = frame.eye + 3.0 * frame.forward + random.Vector(6.0);
  ResolutionLight light;
  const glm::dvec3 direction = random.Direction();
  glm::dvec3 up = random.Direction();
  while (std::abs(glm::dot(up, direction)) > 0.95) up = random.Direction();
  const glm::dmat4 view = glm::lookAt(near_camera, near_camera + direction, up);
  switch (kind) {
    case 0:
      light.light = PointLight{near_camera};
      break;
    case 1:
      light.light = SpotLight{near_camera, direction, random.In(0.1, 1.4)};
      break;
    case 2:
      light.light = DirectionalLight{direction};
      break;
    case 3:
      light.light = PointLight{near_camera};
      light.clip_from_world =
          Perspective(random.In(0.3, 2.0), random.In(0.3, 2.0), 0.1, 100.0, convention) * view;
      break;
    case 4:
      light.light =
          SpotLight{near_camera, glm::normalize(direction + 0.3 * random.Direction()), random.In(0.2, 1.4)};
      light.clip_from_world =
          Perspective(random.In(0.3, 2.0), random.In(0.3, 2.0), 0.1, 100.0, convention) * view;
      break;
    case 5:
      light.light = DirectionalLight{direction};
      light.clip_from_world =
          Orthographic(random.In(1, 20), random.In(1, 20), -50.0, 50.0, convention) * view;
      break;
    default: {
      // A directional light's warp: w grows across the picture.
      light.light = DirectionalLight{direction};
      glm::dmat4 warp(1.0);
      warp[0][3] = random.In(-0.5, 0.5);
      warp[1][3] = random.In(-0.5, 0.5);
      light.clip_from_world =
          warp * Orthographic(random.In(5, 20), random.In(5, 20), -50.0, 50.0, convention) * view;
    }
  }
  return light;
}

/// What the estimator must find, computed pixel by pixel in double precision.
struct Expected {
  int64_t pixels = 0;
  glm::dvec2 low{kInf};
  glm::dvec2 high{-kInf};
  glm::dvec2 smallest{kInf};
  std::vector<glm::dvec2> boxes;
};

class BruteForce {
 public:
  explicit BruteForce(const ResolutionRequest& request)
      : request_(request), camera_(Camera::Create(request.camera).value()) {}

  Expected Estimate(const ResolutionLight& light, const resolution::LightMap& map) const {
    const RaySpace ray_space = RaySpace::Create(light.light).value();
    const DepthView& depth = request_.depth;
    Expected expected;
    for (int y = 0; y < depth.height; ++y) {
      for (int x = 0; x < depth.width; ++x) {
        if (!IsSample(x, y)) continue;
        const glm::dvec4 centre = World(x + 0.5, y + 0.5, Depth(x, y));
        const glm::dvec3 p = Picture(light, ray_space, map, centre);
        if (!(p.z > 0.0)) continue;
        if (map.bounded && (std::abs(p.x) > p.z || std::abs(p.y) > p.z)) continue;
        if (!ray_space.Illuminates(glm::dvec3(centre) / centre.w)) continue;
        glm::dvec2 low(kInf);
        glm::dvec2 high(-kInf);
        bool in_front = true;
        for (int corner = 0; corner < 4; ++corner) {
          const int cx = x + (corner & 1);
          const int cy = y + (corner >> 1);
          const glm::dvec3 q = Picture(light, ray_space, map, World(cx, cy, CornerDepth(cx, cy)));
          in_front = in_front && q.z > 0.0;
          low = glm::min(low, glm::dvec2(q) / q.z);
          high = glm::max(high, glm::dvec2(q) / q.z);
        }
        if (!in_front) continue;
        ++expected.pixels;
        expected.low = glm::min(expected.low, glm::min(low, glm::dvec2(p) / p.z));
        expected.high = glm::max(expected.high, glm::max(high, glm::dvec2(p) / p.z));
        expected.smallest = glm::min(expected.smallest, high - low);
        expected.boxes.push_back(high - low);
      }
    }
    if (map.bounded) {
      expected.low = glm::max(expected.low, glm::dvec2(-1.0));
      expected.high = glm::min(expected.high, glm::dvec2(1.0));
    }
    return expected;
  }

 private:
  bool Inside(int x, int y) const {
    return x >= 0 && y >= 0 && x < request_.depth.width && y < request_.depth.height;
  }
  bool IsSample(int x, int y) const {
    const double z = request_.depth.At(x, y);
    return z >= 0.0 && z <= 1.0 && z != BackgroundWindowDepth(request_.camera.clip_depth);
  }
  /// Of pixels, and of those just beyond the border; NaN where there is no sample.
  double Depth(int x, int y) const {
    if (Inside(x, y)) return IsSample(x, y) ? request_.depth.At(x, y) : kNan;
    const int w = request_.depth.width;
    const int h = request_.depth.height;
    double near;
    double next;
    if (y < 0 || y >= h) {
      if (h < 2) return kNan;
      near = Depth(x, y < 0 ? 0 : h - 1);
      next = Depth(x, y < 0 ? 1 : h - 2);
    } else {
      if (w < 2) return kNan;
      near = Depth(x < 0 ? 0 : w - 1, y);
      next = Depth(x < 0 ? 1 : w - 2, y);
    }
    const double z = 2.0 * near - next;
    return std::isnan(z) ? z : std::clamp(z, 0.0, 1.0);
  }
  double CornerDepth(int x, int y) const {
    double sum = 0.0;
    int count = 0;
    for (int k = 0; k < 4; ++k) {
      const double z = Depth(x - (k & 1), y - (k >> 1));
      if (std::isnan(z)) continue;
      sum += z;
      ++count;
    }
    return sum / count;
  }
  /// Homogeneous, with w > 0 before the camera.
  glm::dvec4 World(double x, double y, double window_depth) const {
    return camera_.WsFromNdc({-1.0 + 2.0 * x / request_.depth.width, -1.0 + 2.0 * y / request_.depth.height,
                              NdcFromWindowDepth(request_.camera.clip_depth, window_depth)});
  }
  static glm::dvec3 Picture(const ResolutionLight& light, const RaySpace& ray_space,
                            const resolution::LightMap& map, const glm::dvec4& ws) {
    if (light.clip_from_world) {
      const glm::dvec4 clip = *light.clip_from_world * ws;
      return {clip.x, clip.y, clip.w};
    }
    return map.picture_from_ray * (ray_space.linear() * glm::dvec3(ws) + ray_space.offset() * ws.w);
  }

  const ResolutionRequest& request_;
  Camera camera_;
};

int ExpectedSize(double extent, double smallest, int max_size) {
  if (!(extent > 0.0)) return 1;
  const double texels = std::ceil(extent / smallest - kTexelTolerance);
  return texels >= max_size ? max_size : std::max(1, static_cast<int>(texels));
}

ResolutionSummary Estimate(const ResolutionRequest& request, const ResolutionOptions& options = {}) {
  ResolutionEstimator estimator;
  ResolutionSummary summary;
  const absl::Status status = estimator.Estimate(request, options, Cancellation(), &summary);
  EXPECT_TRUE(status.ok()) << status;
  return summary;
}

TEST(ResolutionTest, EqualsBruteForceToTheTexelOnAThousandRandomFrames) {
  Random random(7);
  ResolutionEstimator estimator;
  int maps_with_pixels = 0;
  int unlimited = 0;
  for (int trial = 0; trial < 1000; ++trial) {
    // Most are small; some are of several tiles in both directions.
    const Frame frame = trial % 50 == 0 ? RandomFrame(random, 700, 100) : RandomFrame(random);
    ResolutionRequest request{.camera = frame.camera, .depth = frame.depth, .screen = {}, .lights = {}};
    for (int k = 0; k < 2; ++k) {
      request.lights.push_back(RandomLight(random, frame, (2 * trial + k) % 7));
      request.lights.back().id = static_cast<uint32_t>(k);
    }
    ResolutionOptions options;
    options.max_size = trial % 3 == 0 ? kMaxResolution : random.Int(1, 5000);
    ResolutionSummary summary;
    ASSERT_TRUE(estimator.Estimate(request, options, Cancellation(), &summary).ok());
    const Camera camera = Camera::Create(frame.camera).value();
    const BruteForce brute_force(request);
    for (size_t l = 0; l < request.lights.size(); ++l) {
      const ResolutionLight& light = request.lights[l];
      const RaySpace ray_space = RaySpace::Create(light.light).value();
      const auto maps =
          resolution::MapsOfLight(light.light, ray_space, camera, light.clip_from_world).value();
      ASSERT_EQ(summary.lights[l].maps.size(), maps.size());
      for (size_t m = 0; m < maps.size(); ++m) {
        const Expected expected = brute_force.Estimate(light, maps[m]);
        const MapEstimate& found = summary.lights[l].maps[m];
        SCOPED_TRACE(testing::Message()
                     << "trial " << trial << " light " << l << " map " << m << " pixels " << expected.pixels);
        EXPECT_LE(found.recommended.width, options.max_size);
        EXPECT_LE(found.recommended.height, options.max_size);
        EXPECT_TRUE(std::isfinite(found.needed.x) && std::isfinite(found.needed.y));
        if (expected.pixels == 0) {
          EXPECT_EQ(found.recommended, (MapSize{1, 1}));
          continue;
        }
        ++maps_with_pixels;
        const glm::dvec2 extent = expected.high - expected.low;
        const MapSize size{ExpectedSize(extent.x, expected.smallest.x, options.max_size),
                           ExpectedSize(extent.y, expected.smallest.y, options.max_size)};
        EXPECT_EQ(found.recommended.width, size.width);
        EXPECT_EQ(found.recommended.height, size.height);
        unlimited += size.width < options.max_size && size.height < options.max_size;
        for (int axis = 0; axis < 2; ++axis) {
          EXPECT_NEAR(found.crop_min[axis], expected.low[axis], 1e-9 * (1.0 + extent[axis]));
          EXPECT_NEAR(found.crop_max[axis], expected.high[axis], 1e-9 * (1.0 + extent[axis]));
          // What is needed is told beyond the limit, too, if less exactly.
          const double needed = extent[axis] / expected.smallest[axis];
          if (!(extent[axis] > 0.0) || needed > 1e7) continue;
          EXPECT_LE(found.needed[axis], needed * (1.0 + 1e-8));
          EXPECT_GE(found.needed[axis] * (1.0 + kNeedTolerance) + kTexelTolerance, needed);
        }
        EXPECT_NEAR(static_cast<double>(found.pixels), static_cast<double>(expected.pixels),
                    2.0 + 0.01 * static_cast<double>(expected.pixels));
      }
    }
  }
  // The comparison is worth its name only where there is something to compare.
  EXPECT_GT(maps_with_pixels, 1000);
  EXPECT_GT(unlimited, 300);
}

TEST(ResolutionTest, CameraAndLightTheSameFrustumNeedTheCamerasResolution) {
  Random random(11);
  for (int trial = 0; trial < 20; ++trial) {
    const int width = random.Int(2, 700);
    const int height = random.Int(2, 500);
    Frame frame;
    frame.camera.clip_depth = static_cast<ClipDepth>(trial % 3);
    frame.camera.view_from_world = RandomView(random, &frame.eye, &frame.forward);
    const double tan_x = random.In(0.3, 0.9);
    frame.camera.clip_from_view =
        Perspective(tan_x, tan_x * height / width, 0.1, 50.0, frame.camera.clip_depth);
    frame.pixels.resize(static_cast<size_t>(width * height));
    for (float& z : frame.pixels) z = static_cast<float>(random.In(0.1, 0.9));
    frame.depth = BottomFirst(frame.pixels.data(), width, height);

    ResolutionRequest request{.camera = frame.camera, .depth = frame.depth, .screen = {}, .lights = {}};
    const double half_angle = std::atan(std::max(tan_x, tan_x * height / width));
    const SpotLight spot{frame.eye, frame.forward, half_angle};
    // By the light's own frustum, turned by any roll; and by the camera's matrix.
    request.lights.push_back({.id = 0, .light = spot, .clip_from_world = {}});
    request.lights.push_back({.id = 1,
                              .light = PointLight{frame.eye},
                              .clip_from_world = frame.camera.clip_from_view * frame.camera.view_from_world});
    request.lights.push_back({.id = 2, .light = PointLight{frame.eye}, .clip_from_world = {}});
    ResolutionSummary summary = Estimate(request);
    for (const LightEstimate& light : summary.lights) {
      if (light.id == 2 && tan_x * height / width > 1.0) continue;  // Two faces share such a picture.
      EXPECT_EQ(light.recommended, (MapSize{width, height}))
          << "light " << light.id << ": " << light.recommended.width << "x" << light.recommended.height
          << " for " << width << "x" << height;
    }

    frame.camera.clip_from_view =
        Orthographic(3.0 * tan_x, 3.0 * tan_x * height / width, 0.1, 50.0, frame.camera.clip_depth);
    request.camera = frame.camera;
    request.lights = {{.id = 3, .light = DirectionalLight{frame.forward}, .clip_from_world = {}}};
    summary = Estimate(request);
    EXPECT_EQ(summary.lights[0].recommended, (MapSize{width, height}));
  }
}

TEST(ResolutionTest, CroppedProjectionMapsTheCropToTheMap) {
  Random random(3);
  for (int trial = 0; trial < 50; ++trial) {
    const Frame frame = RandomFrame(random);
    ResolutionRequest request{.camera = frame.camera, .depth = frame.depth, .screen = {}, .lights = {}};
    request.lights.push_back(RandomLight(random, frame, trial % 7));
    const ResolutionSummary summary = Estimate(request);
    const Camera camera = Camera::Create(frame.camera).value();
    const RaySpace ray_space = RaySpace::Create(request.lights[0].light).value();
    for (const MapEstimate& map : summary.lights[0].maps) {
      if (map.pixels == 0) continue;
      // Every visible pixel inside the volume lands on the map and within its depths.
      int outside = 0;
      int64_t inside = 0;
      for (int y = 0; y < frame.depth.height; ++y) {
        for (int x = 0; x < frame.depth.width; ++x) {
          const float z = frame.depth.At(x, y);
          if (!(z >= 0.0F && z <= 1.0F) || z == BackgroundWindowDepth(frame.camera.clip_depth)) continue;
          const glm::dvec4 ws = camera.WsFromNdc({-1.0 + (2.0 * x + 1.0) / frame.depth.width,
                                                  -1.0 + (2.0 * y + 1.0) / frame.depth.height,
                                                  NdcFromWindowDepth(frame.camera.clip_depth, z)});
          const glm::dvec3 point = glm::dvec3(ws) / ws.w;
          const glm::dvec3 texel = map.projection.TexelFromRay(ray_space.RayFromPoint(point));
          if (!ray_space.Illuminates(point) || texel.z <= 0.0) continue;
          const bool on_map = texel.x >= -1e-6 && texel.x <= map.recommended.width + 1e-6 &&
                              texel.y >= -1e-6 && texel.y <= map.recommended.height + 1e-6;
          if (!on_map) {
            ++outside;
            continue;
          }
          ++inside;
          const glm::dvec4 clip = map.clip_from_world * glm::dvec4(point, 1.0);
          EXPECT_NEAR((clip.x / clip.w + 1.0) / 2.0 * map.recommended.width, texel.x, 1e-6 * (1.0 + texel.x));
          const double along = ray_space.AlongRay(point) / texel.z;
          const auto [low, high] = std::minmax(map.depth_range.near_q_over_w, map.depth_range.far_q_over_w);
          EXPECT_GE(along, low);
          // A point light's near plane keeps its distance; nearer receivers are clamped to it.
          if (ray_space.is_directional()) {
            EXPECT_LE(along, high);
          }
        }
      }
      EXPECT_GE(inside, map.pixels - 2);
      // An unbounded map holds everything that the light reaches.
      if (std::holds_alternative<DirectionalLight>(request.lights[0].light) &&
          !request.lights[0].clip_from_world) {
        EXPECT_EQ(outside, 0);
      }
    }
  }
}

TEST(ResolutionTest, PercentileAndHistogramAgreeWithTheBoxes) {
  Random random(5);
  int checked = 0;
  for (int trial = 0; trial < 60; ++trial) {
    const Frame frame = RandomFrame(random);
    ResolutionRequest request{.camera = frame.camera, .depth = frame.depth, .screen = {}, .lights = {}};
    request.lights.push_back(RandomLight(random, frame, 1 + trial % 2));
    const Camera camera = Camera::Create(frame.camera).value();
    const RaySpace ray_space = RaySpace::Create(request.lights[0].light).value();
    const auto maps = resolution::MapsOfLight(request.lights[0].light, ray_space, camera, {}).value();
    const Expected expected = BruteForce(request).Estimate(request.lights[0], maps[0]);
    if (expected.pixels < 50) continue;
    ++checked;
    double previous = 0.0;
    for (const double percentile : {50.0, 90.0, 99.0, 100.0}) {
      ResolutionOptions options{.max_size = kMaxResolution, .percentile = percentile, .histogram = true};
      const MapEstimate map = Estimate(request, options).lights[0].maps[0];
      EXPECT_GE(map.needed.x, previous);
      previous = map.needed.x;
      const glm::dvec2 extent = expected.high - expected.low;
      int64_t satisfied = 0;
      int64_t satisfied_by_less = 0;
      for (const glm::dvec2& box : expected.boxes) {
        satisfied += box.x * map.needed.x >= extent.x * (1.0 - 1e-5);
        satisfied_by_less += box.x * map.needed.x * 0.968 >= extent.x;
      }
      const double share = percentile / 100.0 * static_cast<double>(expected.pixels);
      EXPECT_GE(static_cast<double>(satisfied), share - 2.0);
      if (percentile < 100.0 && map.needed.x > 1.0) {
        EXPECT_LE(static_cast<double>(satisfied_by_less), share + 2.0);
      }
      int64_t total = 0;
      double texels = 0.0;
      for (const ResolutionBin& bin : map.histogram_x) {
        EXPECT_GT(bin.texels, texels);
        texels = bin.texels;
        total += bin.pixels;
      }
      EXPECT_NEAR(static_cast<double>(total), static_cast<double>(map.pixels), 2.0);
    }
  }
  EXPECT_GT(checked, 20);
}

TEST(ResolutionTest, ALargerScreenNeedsMoreTexels) {
  Random random(2);
  Frame frame = RandomFrame(random);
  ResolutionRequest request{.camera = frame.camera, .depth = frame.depth, .screen = {}, .lights = {}};
  request.lights.push_back({.id = 0, .light = DirectionalLight{random.Direction()}, .clip_from_world = {}});
  const ResolutionOptions options{.max_size = kMaxResolution};
  const glm::dvec2 own = Estimate(request, options).lights[0].maps[0].needed;
  request.screen = {2 * frame.depth.width, 2 * frame.depth.height};
  const glm::dvec2 doubled = Estimate(request, options).lights[0].maps[0].needed;
  EXPECT_NEAR(doubled.x, 2.0 * own.x, 0.05);
  EXPECT_NEAR(doubled.y, 2.0 * own.y, 0.05);
}

TEST(ResolutionTest, RoundsUpAndStaysBelowTheLimit) {
  EXPECT_EQ(RoundedSize(100.0, SizeRounding::kExact, 4096), 100);
  EXPECT_EQ(RoundedSize(100.0 + 1e-9, SizeRounding::kExact, 4096), 100);
  EXPECT_EQ(RoundedSize(100.1, SizeRounding::kExact, 4096), 101);
  EXPECT_EQ(RoundedSize(100.1, SizeRounding::kMultipleOf8, 4096), 104);
  EXPECT_EQ(RoundedSize(100.1, SizeRounding::kPowerOfTwo, 4096), 128);
  EXPECT_EQ(RoundedSize(0.0, SizeRounding::kExact, 4096), 1);
  EXPECT_EQ(RoundedSize(0.0, SizeRounding::kMultipleOf8, 4096), 8);
  for (const double needed : {0.5, 7.0, 99.0, 100.0, 4000.0, 1e12}) {
    for (const int limit : {8, 100, 1000, 4096, 65536}) {
      EXPECT_LE(RoundedSize(needed, SizeRounding::kExact, limit), limit);
      const int eights = RoundedSize(needed, SizeRounding::kMultipleOf8, limit);
      EXPECT_LE(eights, limit);
      EXPECT_EQ(eights % 8, 0);
      const int power = RoundedSize(needed, SizeRounding::kPowerOfTwo, limit);
      EXPECT_LE(power, limit);
      EXPECT_EQ(power & (power - 1), 0);
    }
  }
}

TEST(ResolutionTest, AnyDepthGivesAFiniteAnswer) {
  Random random(19);
  ResolutionEstimator estimator;
  for (int trial = 0; trial < 300; ++trial) {
    Frame frame = RandomFrame(random);
    for (float& z : frame.pixels) {
      const float kinds[] = {kNan,  kInf,  -kInf, 0.0F, 1.0F, std::numeric_limits<float>::denorm_min(),
                             -0.0F, 1e30F, z};
      z = kinds[random.Int(0, 8)];
    }
    ResolutionRequest request{.camera = frame.camera, .depth = frame.depth, .screen = {}, .lights = {}};
    for (int kind = 0; kind < 7; ++kind) {
      request.lights.push_back(RandomLight(random, frame, kind));
      request.lights.back().id = static_cast<uint32_t>(kind);
    }
    // A light in the eye, and one whose ray runs along the view.
    request.lights.push_back({.id = 7, .light = PointLight{frame.eye}, .clip_from_world = {}});
    request.lights.push_back({.id = 8, .light = DirectionalLight{frame.forward}, .clip_from_world = {}});
    ResolutionSummary summary;
    ASSERT_TRUE(estimator.Estimate(request, {.histogram = true}, Cancellation(), &summary).ok());
    for (const LightEstimate& light : summary.lights) {
      for (const MapEstimate& map : light.maps) {
        EXPECT_GE(map.recommended.width, 1);
        EXPECT_LE(map.recommended.width, 4096);
        for (int axis = 0; axis < 2; ++axis) {
          EXPECT_TRUE(std::isfinite(map.needed[axis]));
          EXPECT_TRUE(std::isfinite(map.crop_min[axis]));
          EXPECT_TRUE(std::isfinite(map.crop_max[axis]));
          EXPECT_TRUE(std::isfinite(map.smallest_patch[axis]));
        }
        for (int column = 0; column < 3; ++column) {
          for (int row = 0; row < 3; ++row)
            EXPECT_TRUE(std::isfinite(map.projection.texel_from_ray[column][row]));
        }
        EXPECT_TRUE(std::isfinite(map.depth_range.near_q_over_w));
        EXPECT_TRUE(std::isfinite(map.depth_range.far_q_over_w));
      }
    }
  }
}

TEST(ResolutionTest, LooksAtFewPixelsOfASmoothPicture) {
  // A floor to the horizon, below a ball.
  constexpr int kWidth = 800;
  constexpr int kHeight = 400;
  CameraMatrices camera;
  camera.view_from_world = glm::lookAt(glm::dvec3(0, 2, 0), glm::dvec3(0, 1.5, -5), glm::dvec3(0, 1, 0));
  camera.clip_from_view = Perspective(0.8, 0.4, 0.1, 100.0, camera.clip_depth);
  const Camera eye = Camera::Create(camera).value();
  std::vector<float> pixels;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const glm::dvec4 far =
          eye.WsFromNdc({-1.0 + (2.0 * x + 1.0) / kWidth, -1.0 + (2.0 * y + 1.0) / kHeight, 1});
      const glm::dvec3 direction = glm::normalize(glm::dvec3(far) / far.w - glm::dvec3(0, 2, 0));
      double t = direction.y < -1e-3 ? -2.0 / direction.y : kInf;
      const double along = glm::dot(glm::dvec3(0.5, -1.0, -6.0), direction);
      const double inside = along * along - 37.25 + 1.0;
      if (inside > 0.0) t = std::min(t, along - std::sqrt(inside));
      pixels.push_back(t < 90.0 ? WindowDepth(camera, glm::dvec3(0, 2, 0) + t * direction) : 1.0F);
    }
  }
  ResolutionRequest request{
      .camera = camera, .depth = BottomFirst(pixels.data(), kWidth, kHeight), .screen = {}, .lights = {}};
  request.lights.push_back({.id = 0, .light = DirectionalLight{{0.3, -1.0, 0.2}}, .clip_from_world = {}});
  request.lights.push_back(
      {.id = 1, .light = SpotLight{{2, 6, -3}, {-0.3, -1.0, -0.3}, 0.5}, .clip_from_world = {}});
  const ResolutionSummary summary = Estimate(request, {.max_size = kMaxResolution});
  EXPECT_LT(summary.visited_share, 0.15);
  for (size_t l = 0; l < request.lights.size(); ++l) {
    const RaySpace ray_space = RaySpace::Create(request.lights[l].light).value();
    const auto maps = resolution::MapsOfLight(request.lights[l].light, ray_space, eye, {}).value();
    const Expected expected = BruteForce(request).Estimate(request.lights[l], maps[0]);
    const MapEstimate& found = summary.lights[l].maps[0];
    EXPECT_EQ(found.recommended.width,
              ExpectedSize(expected.high.x - expected.low.x, expected.smallest.x, kMaxResolution));
    EXPECT_EQ(found.recommended.height,
              ExpectedSize(expected.high.y - expected.low.y, expected.smallest.y, kMaxResolution));
    EXPECT_NEAR(static_cast<double>(found.pixels), static_cast<double>(expected.pixels), 10.0);
  }
  const ResolutionSummary all = Estimate(request, {.percentile = 99.0});
  EXPECT_GT(all.visited_share, summary.visited_share);
}

TEST(ResolutionTest, BackgroundAloneNeedsTheSmallestMap) {
  const std::vector<float> pixels(64, 1.0F);
  ResolutionRequest request{
      .camera = {}, .depth = BottomFirst(pixels.data(), 8, 8), .screen = {}, .lights = {}};
  request.lights.push_back({.id = 4, .light = DirectionalLight{}, .clip_from_world = {}});
  const ResolutionSummary summary = Estimate(request);
  EXPECT_EQ(summary.lights[0].recommended, (MapSize{1, 1}));
  EXPECT_EQ(summary.lights[0].maps[0].pixels, 0);
}

TEST(ResolutionTest, TheAnswerDoesNotDependOnTheNumberOfLightsInTheFrame) {
  Random random(23);
  const Frame frame = RandomFrame(random);
  ResolutionRequest all{.camera = frame.camera, .depth = frame.depth, .screen = {}, .lights = {}};
  for (int k = 0; k < 28; ++k) {
    all.lights.push_back(RandomLight(random, frame, k % 7));
    all.lights.back().id = static_cast<uint32_t>(k);
  }
  const ResolutionSummary together = Estimate(all);
  for (size_t k = 0; k < all.lights.size(); ++k) {
    ResolutionRequest one = all;
    one.lights = {all.lights[k]};
    const ResolutionSummary alone = Estimate(one);
    ASSERT_EQ(alone.lights[0].maps.size(), together.lights[k].maps.size());
    for (size_t m = 0; m < alone.lights[0].maps.size(); ++m) {
      EXPECT_EQ(alone.lights[0].maps[m].needed, together.lights[k].maps[m].needed);
      EXPECT_EQ(alone.lights[0].maps[m].crop_min, together.lights[k].maps[m].crop_min);
    }
  }
}

TEST(ResolutionTest, BadInputIsNamed) {
  const std::vector<float> pixels(4, 0.5F);
  ResolutionRequest good{.camera = {}, .depth = BottomFirst(pixels.data(), 2, 2), .screen = {}, .lights = {}};
  good.lights.push_back({.id = 0, .light = DirectionalLight{}, .clip_from_world = {}});
  const auto message = [](const ResolutionRequest& request, const ResolutionOptions& options) {
    ResolutionSummary summary;
    const absl::Status status = ResolutionEstimator().Estimate(request, options, Cancellation(), &summary);
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << status;
    return std::string(status.message());
  };
  EXPECT_THAT(message(good, {.max_size = 0}), HasSubstr("max_size: 0"));
  EXPECT_THAT(message(good, {.max_size = 7, .rounding = SizeRounding::kMultipleOf8}),
              HasSubstr("[8, 65536]"));
  EXPECT_THAT(message(good, {.max_size = 65537}), HasSubstr("max_size: 65537"));
  EXPECT_THAT(message(good, {.percentile = 0.0}), HasSubstr("percentile: 0"));
  EXPECT_THAT(message(good, {.percentile = 100.5}), HasSubstr("percentile: 100.5"));
  EXPECT_THAT(message(good, {.percentile = std::nan("")}), HasSubstr("percentile: nan"));
  ResolutionRequest bad = good;
  bad.depth.width = 0;
  EXPECT_THAT(message(bad, {}), StartsWith("depth: size 0x2"));
  bad = good;
  bad.depth.bottom_row = nullptr;
  EXPECT_THAT(message(bad, {}), StartsWith("depth: no data"));
  bad = good;
  bad.screen = {0, 5};
  EXPECT_THAT(message(bad, {}), StartsWith("screen: size 0x5"));
  bad = good;
  bad.camera.clip_from_view = glm::dmat4(0.0);
  EXPECT_THAT(message(bad, {}), StartsWith("camera.projection: singular"));
  bad = good;
  bad.camera.view_from_world[1][2] = std::nan("");
  EXPECT_THAT(message(bad, {}), StartsWith("camera.view.m[6]: nan"));
  bad = good;
  bad.lights.push_back({.id = 1, .light = DirectionalLight{glm::dvec3(0.0)}, .clip_from_world = {}});
  EXPECT_THAT(message(bad, {}), StartsWith("lights[1].directional.direction: zero-length"));
  bad = good;
  bad.lights.push_back(bad.lights[0]);
  EXPECT_THAT(message(bad, {}), StartsWith("lights[1].id: 0 is not unique"));
  bad.lights.clear();
  EXPECT_THAT(message(bad, {}), StartsWith("lights: empty"));
  bad = good;
  bad.lights[0].clip_from_world = Perspective(1.0, 1.0, 0.1, 10.0, ClipDepth::kZeroToOne);
  EXPECT_THAT(message(bad, {}), StartsWith("lights[0].previous_world_to_shadow_clip"));
}

TEST(ResolutionTest, StopsWhenAsked) {
  const std::vector<float> pixels(4, 0.5F);
  ResolutionRequest request{
      .camera = {}, .depth = BottomFirst(pixels.data(), 2, 2), .screen = {}, .lights = {}};
  request.lights.push_back({.id = 0, .light = DirectionalLight{}, .clip_from_world = {}});
  Cancellation cancelled;
  cancelled.Cancel();
  ResolutionSummary summary;
  EXPECT_EQ(ResolutionEstimator().Estimate(request, {}, cancelled, &summary).code(),
            absl::StatusCode::kCancelled);
  const Cancellation late(Cancellation::Clock::now() - std::chrono::seconds(1));
  EXPECT_EQ(ResolutionEstimator().Estimate(request, {}, late, &summary).code(),
            absl::StatusCode::kDeadlineExceeded);
}

}  // namespace
}  // namespace shadowfit
