#include "core/reference/truth_scene.h"

#include <gmock/gmock.h>

#include <algorithm>
#include <numbers>
#include <random>

#include "test_scenes.h"

namespace shadowfit {
namespace {

constexpr double kInfinity = 1e300;

/// A second implementation of everything that the ray tracer does, triangle by triangle in double.
struct BruteForce {
  struct Triangle {
    glm::dvec3 a, b, c;
    glm::vec2 uv[3];
    const Material* material;
  };
  struct Hit {
    double t = kInfinity;
    size_t triangle = 0;
  };

  explicit BruteForce(const Scene& source) : scene(source) {
    for (const Instance& instance : source.instances) {
      const Mesh& mesh = source.meshes[size_t(instance.mesh)];
      for (const glm::uvec3& t : mesh.triangles) {
        const auto vertex = [&](int corner) {
          return glm::dvec3(instance.world_from_object * glm::vec4(mesh.positions[t[corner]], 1.0f));
        };
        Triangle& triangle = triangles.emplace_back();
        triangle = {vertex(0), vertex(1), vertex(2), {}, &source.materials[size_t(mesh.material)]};
        for (int corner = 0; corner < 3 && !mesh.uvs.empty(); ++corner) {
          triangle.uv[corner] = mesh.uvs[t[corner]];
        }
      }
    }
  }

  /// Distance to the triangle, or infinity. `margin` receives how far, in barycentric units or in texels of
  /// the alpha texture, the ray is from being judged otherwise.
  double Intersect(const Triangle& t, const glm::dvec3& origin, const glm::dvec3& direction,
                   double* margin) const {
    const glm::dvec3 e1 = t.b - t.a;
    const glm::dvec3 e2 = t.c - t.a;
    const glm::dvec3 p = glm::cross(direction, e2);
    const double det = glm::dot(e1, p);
    if (det == 0.0) return kInfinity;
    const glm::dvec3 s = origin - t.a;
    const double u = glm::dot(s, p) / det;
    const glm::dvec3 q = glm::cross(s, e1);
    const double v = glm::dot(direction, q) / det;
    const double inside = std::min({u, v, 1.0 - u - v});
    const double distance = glm::dot(e2, q) / det;
    if (distance > 0.0) *margin = std::min(*margin, std::abs(inside));
    if (inside < 0.0) return kInfinity;
    if (t.material->alpha_texture >= 0) {
      const AlphaTexture& texture = scene.alpha_textures[size_t(t.material->alpha_texture)];
      const glm::vec2 uv = float(1.0 - u - v) * t.uv[0] + float(u) * t.uv[1] + float(v) * t.uv[2];
      const glm::vec2 texel = uv * glm::vec2(texture.width, texture.height);
      const glm::vec2 off = glm::abs(texel - glm::round(texel));
      *margin = std::min(*margin, double(std::min(off.x, off.y)));
      if (texture.AlphaAt(uv) < t.material->alpha_cutoff) return kInfinity;
    }
    return distance;
  }

  Hit FirstHit(const glm::dvec3& origin, const glm::dvec3& direction, double* margin) const {
    Hit hit;
    for (size_t i = 0; i < triangles.size(); ++i) {
      const double t = Intersect(triangles[i], origin, direction, margin);
      if (t > 0.0 && t < hit.t) hit = {t, i};
    }
    return hit;
  }

  glm::vec3 Transmittance(const glm::dvec3& point, size_t own, const glm::dvec3& direction, double t_max,
                          double* margin) const {
    glm::vec3 transmittance(1.0f);
    for (size_t i = 0; i < triangles.size(); ++i) {
      if (i == own) continue;
      const double t = Intersect(triangles[i], point, direction, margin);
      if (std::abs(t) < kInfinity) *margin = std::min({*margin, std::abs(t), std::abs(t - t_max)});
      if (t > 0.0 && t < t_max) transmittance *= triangles[i].material->transmittance;
    }
    return transmittance;
  }

  bool Blocked(const glm::dvec3& point, size_t own, const glm::dvec3& direction, double t_max,
               double* margin) const {
    for (size_t i = 0; i < triangles.size(); ++i) {
      if (i == own) continue;
      const glm::vec3& through = triangles[i].material->transmittance;
      if (through.r + through.g + through.b >= 1.5f) continue;
      const double t = Intersect(triangles[i], point, direction, margin);
      if (std::abs(t) < kInfinity) *margin = std::min({*margin, std::abs(t), std::abs(t - t_max)});
      if (t > 0.0 && t < t_max) return true;
    }
    return false;
  }

  Scene scene;
  std::vector<Triangle> triangles;
};

/// Random triangles in a box, opaque, cutout and semi-transparent, some of them in a moved instance.
Scene RandomScene(unsigned seed) {
  std::mt19937 generator(seed);
  const auto uniform = [&](float low, float high) {
    return low + (high - low) * (float(generator()) / 4294967296.0f);
  };
  Scene scene;
  AlphaTexture texture{.width = 5, .height = 3, .alpha = {}};
  for (int i = 0; i < 15; ++i) texture.alpha.push_back(uint8_t(generator() % 2 == 0 ? 20 : 200));
  scene.alpha_textures.push_back(texture);
  scene.materials.resize(4);
  scene.materials[1].alpha_texture = 0;
  scene.materials[2].transmittance = {0.9f, 0.8f, 0.7f};
  scene.materials[3].transmittance = {0.2f, 0.0f, 0.4f};
  for (int material = 0; material < 4; ++material) {
    Mesh& mesh = scene.meshes.emplace_back();
    mesh.material = material;
    for (uint32_t i = 0; i < 12; ++i) {
      const glm::vec3 center(uniform(-2, 2), uniform(-2, 2), uniform(-1, 1));
      for (int corner = 0; corner < 3; ++corner) {
        mesh.positions.push_back(center + glm::vec3(uniform(-1, 1), uniform(-1, 1), uniform(-1, 1)));
        mesh.uvs.emplace_back(uniform(-2, 2), uniform(-2, 2));
      }
      mesh.triangles.emplace_back(3 * i, 3 * i + 1, 3 * i + 2);
    }
    scene.instances.push_back({.mesh = material});
  }
  glm::mat4x3 moved(1.0f);
  moved[0] = {0.0f, 2.0f, 0.0f};
  moved[1] = {-1.0f, 0.0f, 0.3f};
  moved[3] = {0.5f, -0.25f, -0.75f};
  scene.instances.push_back({.mesh = 1, .world_from_object = moved});
  Mesh& floor = scene.meshes.emplace_back();
  floor.positions = {{-6, -6, -2}, {6, -6, -2}, {6, 6, -2}, {-6, 6, -2}};
  floor.triangles = {{0, 1, 2}, {0, 2, 3}};
  scene.instances.push_back({.mesh = 4});
  return scene;
}

const Light kLights[] = {PointLight{{1.0, 2.0, 6.0}}, PointLight{{0.1, 0.2, 0.3}},
                         SpotLight{{-3.0, 2.0, 5.0}, {0.5, -0.3, -1.0}, 0.4},
                         DirectionalLight{{0.3, -0.5, -1.0}}, DirectionalLight{{1.0, 0.2, -0.05}}};

/// Rays that pass an edge, an alpha texel's border or a triangle's plane by less than this are not compared:
/// float and double may differ there.
constexpr double kMargin = 1e-4;

TEST(TruthSceneTest, SurfaceAndShadowsEqualBruteForce) {
  int compared = 0;
  int shadowed = 0;
  for (unsigned seed = 0; seed < 6; ++seed) {
    const Scene scene = RandomScene(seed);
    const BruteForce brute(scene);
    const auto truth = TruthScene::Create(scene);
    ASSERT_TRUE(truth.ok()) << truth.status();
    ASSERT_EQ(truth->TriangleCount(), brute.triangles.size());
    const Camera camera = *Camera::Create(LookAt({5.0, -4.0, 3.0}, {0.0, 0.0, -0.5}));
    const VisibleSurface surface = truth->RenderSurface(camera, 40, 40);

    std::vector<double> margins(surface.size(), kInfinity);
    std::vector<size_t> hits(surface.size());
    for (int y = 0; y < 40; ++y) {
      for (int x = 0; x < 40; ++x) {
        const size_t i = size_t(40 * y + x);
        const glm::dvec4 far = camera.WsFromNdc({(x + 0.5) / 20.0 - 1.0, (y + 0.5) / 20.0 - 1.0, 1.0});
        const glm::dvec3 eye(camera.ws_eye());
        const glm::dvec3 direction = glm::normalize(glm::dvec3(far) / far.w - eye);
        const BruteForce::Hit hit = brute.FirstHit(eye, direction, &margins[i]);
        if (margins[i] < kMargin) continue;
        ASSERT_EQ(surface.primitive[i] == kNoPrimitive, hit.t == kInfinity);
        if (hit.t == kInfinity) {
          EXPECT_EQ(surface.depth[i], 1.0f);
          continue;
        }
        hits[i] = hit.triangle;
        EXPECT_LT(glm::length(surface.ws_point[i] - (eye + hit.t * direction)), 1e-9 * hit.t);
        const BruteForce::Triangle& t = brute.triangles[hit.triangle];
        const glm::dvec3 normal = glm::normalize(glm::cross(t.b - t.a, t.c - t.a));
        EXPECT_NEAR(std::abs(glm::dot(normal, surface.ws_normal[i])), 1.0, 1e-12);
        EXPECT_LT(glm::dot(surface.ws_normal[i], direction), 0.0);
        const glm::dvec4 clip = camera.clip_from_world() * glm::dvec4(surface.ws_point[i], 1.0);
        EXPECT_NEAR(surface.depth[i], 0.5 + 0.5 * clip.z / clip.w, 1e-7);
      }
    }

    for (const Light& light : kLights) {
      const RaySpace ray_space = *RaySpace::Create(light);
      const ShadowMask mask = truth->TrueShadow(surface, ray_space);
      const std::vector<glm::vec3> transmittance = truth->TrueTransmittance(surface, ray_space);
      for (size_t i = 0; i < surface.size(); ++i) {
        if (margins[i] < kMargin) continue;
        const glm::dvec3& point = surface.ws_point[i];
        const glm::dvec3 towards_light = ray_space.TowardsLight(point);
        if (surface.primitive[i] == kNoPrimitive || glm::dot(surface.ws_normal[i], towards_light) <= 0.0 ||
            !ray_space.Illuminates(point)) {
          EXPECT_EQ(mask[i], PixelLight::kNotConcerned);
          EXPECT_EQ(transmittance[i], glm::vec3(1.0f));
          continue;
        }
        double margin = kInfinity;
        const double t_max = ray_space.is_directional() ? 1e3 : 1.0;
        const bool blocked = brute.Blocked(point, hits[i], towards_light, t_max, &margin);
        if (margin >= kMargin) {
          EXPECT_EQ(mask[i], blocked ? PixelLight::kShadowed : PixelLight::kLit);
          ++compared;
          shadowed += blocked ? 1 : 0;
        }
        margin = kInfinity;
        const glm::vec3 expected = brute.Transmittance(point, hits[i], towards_light, t_max, &margin);
        if (margin >= kMargin) {
          for (int channel = 0; channel < 3; ++channel) {
            EXPECT_NEAR(transmittance[i][channel], expected[channel], 1e-6);
          }
        }
      }
    }
  }
  EXPECT_GT(compared, 15000);
  EXPECT_GT(shadowed, compared / 10);
  EXPECT_LT(shadowed, compared * 9 / 10);
}

TEST(TruthSceneTest, CasterMapEqualsBruteForce) {
  int compared = 0;
  for (unsigned seed = 0; seed < 4; ++seed) {
    const Scene scene = RandomScene(seed);
    const BruteForce brute(scene);
    const auto truth = TruthScene::Create(scene);
    ASSERT_TRUE(truth.ok());
    for (const Light& light : kLights) {
      const RaySpace ray_space = *RaySpace::Create(light);
      // A skewed, perspective map around the scene's centre.
      ShadowProjection projection;
      const glm::dvec3 r = ray_space.RayFromPoint(glm::dvec3(0.2, -0.1, -1.0));
      const glm::dvec3 axis = glm::normalize(r + glm::dvec3(0.05, -0.02, 0.1));
      const glm::dvec3 b1 = glm::normalize(glm::cross(axis, glm::dvec3(0.3, 1.0, 0.2)));
      const glm::dvec3 b2 = glm::cross(axis, b1);
      projection.texel_from_ray = glm::transpose(
          glm::dmat3(30.0 * b1 + 4.0 * b2 + 12.0 * axis, 22.0 * b2 - 3.0 * b1 + 15.0 * axis, axis));
      projection.size = {24, 31};
      const auto map = truth->RenderCasters(ray_space, projection);
      ASSERT_TRUE(map.ok()) << map.status();
      for (int y = 0; y < 31; ++y) {
        for (int x = 0; x < 24; ++x) {
          const RaySpace::WsRay ray = map->TexelRay(ray_space, x, y);
          const double start = ray_space.is_directional() ? -1e3 : 0.0;
          double margin = kInfinity;
          double nearest = kInfinity;
          for (const BruteForce::Triangle& triangle : brute.triangles) {
            const glm::vec3& through = triangle.material->transmittance;
            if (through.r + through.g + through.b >= 1.5f) continue;
            const double t =
                brute.Intersect(triangle, ray.origin + start * ray.direction, ray.direction, &margin);
            if (t > 0.0 && t < kInfinity) nearest = std::min(nearest, t + start);
          }
          if (margin < kMargin) continue;
          const size_t texel = size_t(24 * y + x);
          ASSERT_EQ(map->primitive[texel] == kNoPrimitive, nearest == kInfinity);
          if (nearest < kInfinity) {
            EXPECT_NEAR(map->along_ray[texel], nearest, 1e-9 * (1.0 + std::abs(nearest)));
            ++compared;
          }
        }
      }
    }
  }
  EXPECT_GT(compared, 1500);
}

TEST(TruthSceneTest, DepthOfAPlaneIsAnalyticInEveryClipConvention) {
  Scene scene = SceneOf({}, {});
  AddQuad(&scene, {-50, -50, 0}, {100, 0, 0}, {0, 100, 0});
  const auto truth = TruthScene::Create(scene);
  ASSERT_TRUE(truth.ok()) << truth.status();
  const double near = 0.25;
  const double far = 40.0;
  for (const ClipDepth convention :
       {ClipDepth::kNegativeOneToOne, ClipDepth::kZeroToOne, ClipDepth::kReversedZeroToOne}) {
    CameraMatrices matrices = LookAt({1, 2, 1.7}, {4, 6, 0.5}, 1.0, near, far);
    matrices.clip_depth = convention;
    if (convention == ClipDepth::kZeroToOne) {
      matrices.clip_from_view = glm::perspectiveRH_ZO(1.0, 1.0, near, far);
    } else if (convention == ClipDepth::kReversedZeroToOne) {
      // Reversed, with the far plane at infinity.
      const double f = 1.0 / std::tan(0.5);
      matrices.clip_from_view = glm::dmat4(f, 0, 0, 0, 0, f, 0, 0, 0, 0, 0, -1, 0, 0, near, 0);
    }
    const Camera camera = *Camera::Create(matrices);
    const VisibleSurface surface = truth->RenderSurface(camera, 33, 21);
    int seen = 0;
    for (int y = 0; y < 21; ++y) {
      for (int x = 0; x < 33; ++x) {
        const size_t i = size_t(33 * y + x);
        // The view ray in world space, by hand: tan(fov / 2) times NDC in both axes.
        const double tangent = std::tan(0.5);
        const glm::dvec3 view_direction(tangent * (2 * (x + 0.5) / 33 - 1),
                                        tangent * (2 * (y + 0.5) / 21 - 1), -1.0);
        const glm::dvec3 direction = glm::transpose(glm::dmat3(matrices.view_from_world)) * view_direction;
        const double view_depth = -1.7 / direction.z;
        const glm::dvec3 point = glm::dvec3(1, 2, 1.7) + view_depth * direction;
        const bool in_range = direction.z < 0.0 && std::abs(point.x) < 50 && std::abs(point.y) < 50 &&
                              (convention == ClipDepth::kReversedZeroToOne || view_depth < far);
        ASSERT_EQ(surface.primitive[i] != kNoPrimitive, in_range) << x << " " << y;
        if (!in_range) {
          EXPECT_EQ(surface.depth[i], float(BackgroundWindowDepth(convention)));
          continue;
        }
        ++seen;
        const double zero_to_one = far / (far - near) * (1.0 - near / view_depth);
        const double expected = convention == ClipDepth::kReversedZeroToOne ? near / view_depth : zero_to_one;
        EXPECT_NEAR(surface.depth[i], expected, 1e-6);
        EXPECT_LT(glm::length(surface.ws_point[i] - point), 1e-9);
        EXPECT_NEAR(surface.ws_normal[i].z, 1.0, 1e-12);
      }
    }
    EXPECT_GT(seen, 300);
  }
}

TEST(TruthSceneTest, EmptySceneSeesNothing) {
  const auto truth = TruthScene::Create(Scene{});
  ASSERT_TRUE(truth.ok()) << truth.status();
  const Camera camera = *Camera::Create(LookAt({1, 2, 1.7}, {4, 6, 0.5}));
  const VisibleSurface surface = truth->RenderSurface(camera, 8, 8);
  EXPECT_THAT(surface.primitive, testing::Each(kNoPrimitive));
  EXPECT_THAT(surface.depth, testing::Each(1.0f));
  const RaySpace ray_space = *RaySpace::Create(PointLight{{0, 0, 5}});
  EXPECT_THAT(truth->TrueShadow(surface, ray_space), testing::Each(PixelLight::kNotConcerned));
  const auto map = truth->RenderCasters(ray_space, CenteredMap(4, 1.0));
  ASSERT_TRUE(map.ok());
  EXPECT_THAT(map->primitive, testing::Each(kNoPrimitive));
}

TEST(TruthSceneTest, RefusesBadInputByName) {
  Scene scene = SceneOf({{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, {{0, 1, 7}});
  EXPECT_EQ(TruthScene::Create(scene).status().code(), absl::StatusCode::kInvalidArgument);
  const auto truth = TruthScene::Create(Scene{});
  const RaySpace ray_space = *RaySpace::Create(PointLight{{0, 0, 5}});
  ShadowProjection projection = CenteredMap(4, 1.0);
  projection.size.height = 0;
  EXPECT_THAT(truth->RenderCasters(ray_space, projection).status().message(),
              testing::HasSubstr("projection.size: 4x0"));
  projection = CenteredMap(4, 1.0);
  projection.texel_from_ray[1] = glm::dvec3(0.0);
  EXPECT_THAT(truth->RenderCasters(ray_space, projection).status().message(),
              testing::HasSubstr("texel_from_ray"));
}

/// A finely faceted closed sphere, seen and lit from all around: whatever faces the light must be lit.
TEST(TruthSceneTest, ConvexBodyNeverShadowsItself) {
  for (const double radius : {0.01, 1.0, 300.0}) {
    for (const glm::vec3 center : {glm::vec3(0.0f), glm::vec3(500.0f, -300.0f, 100.0f)}) {
      Scene scene = SceneOf({}, {});
      Mesh& mesh = scene.meshes[0];
      constexpr uint32_t kRings = 40;
      constexpr uint32_t kSegments = 64;
      for (uint32_t i = 0; i <= kRings; ++i) {
        for (uint32_t j = 0; j < kSegments; ++j) {
          const double theta = std::numbers::pi * i / kRings;
          const double phi = 2.0 * std::numbers::pi * j / kSegments;
          mesh.positions.push_back(
              center + glm::vec3(radius * glm::dvec3(std::sin(theta) * std::cos(phi),
                                                     std::sin(theta) * std::sin(phi), std::cos(theta))));
          if (i == kRings) continue;
          const uint32_t a = i * kSegments + j;
          const uint32_t b = i * kSegments + (j + 1) % kSegments;
          mesh.triangles.emplace_back(a, a + kSegments, b + kSegments);
          mesh.triangles.emplace_back(a, b + kSegments, b);
        }
      }
      const auto truth = TruthScene::Create(scene);
      ASSERT_TRUE(truth.ok());
      const glm::dvec3 middle(center);
      const Camera camera = *Camera::Create(
          LookAt(middle + radius * glm::dvec3(2, 2, 1), middle, 0.8, 0.1 * radius, 10.0 * radius));
      const VisibleSurface surface = truth->RenderSurface(camera, 200, 200);
      for (const glm::dvec3 offset : {glm::dvec3(3, 1, 2), glm::dvec3(1, -4, 0.3), glm::dvec3(400, 300, 5)}) {
        const RaySpace ray_space = *RaySpace::Create(PointLight{middle + radius * offset});
        const ShadowMask mask = truth->TrueShadow(surface, ray_space);
        // Far from the origin a facet of the small sphere is only a few float steps wide and no longer
        // convex.
        const bool representable = radius > 1e-3 * glm::length(middle);
        if (representable) {
          EXPECT_EQ(std::ranges::count(mask, PixelLight::kShadowed), 0) << radius;
        }
        EXPECT_GT(std::ranges::count(mask, PixelLight::kLit), 1000);
      }
    }
  }
}

}  // namespace
}  // namespace shadowfit
