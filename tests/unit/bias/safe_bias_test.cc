#include "core/bias/safe_bias.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include "core/bias/surface_samples.h"
#include "core/reference/artefacts.h"
#include "core/resolution/resolution.h"
#include "test_scenes.h"

namespace shadowfit {
namespace {

using ::testing::StartsWith;

/// A floor and two tilted walls: planes in several directions.
Scene PlanarScene() {
  Scene scene = SceneOf({}, {});
  AddQuad(&scene, {-6, -6, 0}, {12, 0, 0}, {0, 12, 0});
  AddQuad(&scene, {-3, 2, 0}, {4, 0, 0}, {0, 1, 3});
  AddQuad(&scene, {2, -1, 0}, {0, 2, 0}, {1, 0, 2});
  return scene;
}

struct View {
  Camera camera;
  VisibleSurface surface;
};

View MakeView(const TruthScene& scene, int size = 300) {
  const Camera camera = Camera::Create(LookAt({-2, -7, 4}, {0, 0, 0.5})).value();
  return {camera, scene.RenderSurface(camera, size, size)};
}

/// A light with the tight map that the estimator crops for it, at a size of one's own choice.
struct LitView {
  RaySpace ray_space;
  ShadowProjection projection;
  DepthRange range;
  ShadowMask truth;
};

LitView LightView(const TruthScene& scene, const View& view, const Light& light, int map_size) {
  ResolutionRequest request;
  request.camera = LookAt({-2, -7, 4}, {0, 0, 0.5});
  request.depth = view.surface.Depth();
  request.lights.push_back({.id = 0, .light = light, .clip_from_world = {}});
  ResolutionSummary summary;
  EXPECT_TRUE(ResolutionEstimator().Estimate(request, {}, Cancellation(), &summary).ok());
  const MapEstimate& map = summary.lights[0].maps[0];
  LitView lit{RaySpace::Create(light).value(), map.projection, map.depth_range, {}};
  // The estimator's crop, on a map of another size.
  glm::dmat3 rows = glm::transpose(lit.projection.texel_from_ray);
  rows[0] *= double(map_size) / lit.projection.size.width;
  rows[1] *= double(map_size) / lit.projection.size.height;
  lit.projection = {glm::transpose(rows), {map_size, map_size}};
  lit.truth = scene.TrueShadow(view.surface, lit.ray_space);
  return lit;
}

std::vector<Light> Lights() {
  return {SpotLight{{3, -4, 7}, {-0.4, 0.6, -1.0}, 0.7}, DirectionalLight{{0.5, 0.7, -1.0}},
          DirectionalLight{{0.9, 0.3, -0.25}}};
}

TEST(ReceiverProjectorTest, SlopeIsTheDerivativeOfDepthOnThePlane) {
  std::mt19937 engine(3);
  std::uniform_real_distribution<double> in(-1.0, 1.0);
  for (int trial = 0; trial < 300; ++trial) {
    Light light = DirectionalLight{{in(engine), in(engine), in(engine)-2.0}};
    if (trial % 2 == 0) light = SpotLight{{in(engine), in(engine), 8.0}, {0.1, 0.1, -1.0}, 0.9};
    const RaySpace ray_space = RaySpace::Create(light).value();
    ShadowProjection projection = CenteredMap(64, ray_space.is_directional() ? 9.0 : 1.5);
    if (ray_space.is_directional()) {
      // A warp: w varies over the map.
      glm::dmat3 rows = glm::transpose(projection.texel_from_ray);
      rows[2] = glm::normalize(glm::dvec3(0.02 * in(engine), 0.02 * in(engine), 1.0));
      projection.texel_from_ray = glm::transpose(rows);
    }
    const DepthRange range{ray_space.is_directional() ? in(engine) : 0.0, 1.0 / 3.0, 1.0 / 20.0};
    const ReceiverProjector projector(ray_space, projection, range);
    const glm::dvec3 point(in(engine), in(engine), in(engine));
    const glm::dvec3 normal = glm::normalize(glm::dvec3(in(engine), in(engine), 2.0));
    const auto at = projector.Project(point, normal);
    ASSERT_TRUE(at.has_value());
    const glm::dvec3 tangent = glm::normalize(glm::cross(normal, glm::dvec3(in(engine), 1.0, in(engine))));
    const double step = 1e-4;
    const auto moved = projector.Project(point + step * tangent, normal);
    ASSERT_TRUE(moved.has_value());
    const glm::dvec2 texels = moved->texel - at->texel;
    EXPECT_NEAR(moved->depth - at->depth, glm::dot(at->slope, texels), 1e-9);
    // Towards the light by the detachment of a bias, depth falls by just that bias.
    const double bias = 1e-3;
    const double detachment = projector.WsDetachment(*at, point, bias);
    const glm::dvec3 caster = point + detachment * glm::normalize(ray_space.TowardsLight(point));
    const double w = glm::dot(projection.Axis(), ray_space.RayFromPoint(caster));
    const double caster_depth = WindowDepth(range, ray_space.AlongRay(caster), w);
    EXPECT_NEAR(std::abs(at->depth - caster_depth), bias, 1e-9);
  }
}

TEST(StoredDepthTest, RoundsAndClamps) {
  EXPECT_EQ(StoredDepth(DepthFormat::kUnorm16, -1.0), 0.0);
  EXPECT_EQ(StoredDepth(DepthFormat::kUnorm24, 2.0), 1.0);
  std::mt19937 engine(4);
  std::uniform_real_distribution<double> in(0.0, 1.0);
  for (const DepthFormat format : {DepthFormat::kUnorm16, DepthFormat::kUnorm24, DepthFormat::kFloat32}) {
    for (int i = 0; i < 1000; ++i) {
      const double depth = in(engine);
      EXPECT_LE(std::abs(StoredDepth(format, depth) - depth), DepthRounding(format));
      EXPECT_EQ(StoredDepth(format, StoredDepth(format, depth)), StoredDepth(format, depth));
    }
  }
}

TEST(SafeBiasTest, LeavesNoAcneOnPlanes) {
  const TruthScene scene = TruthScene::Create(PlanarScene()).value();
  const View view = MakeView(scene);
  int acne_without = 0;
  for (const Light& light : Lights()) {
    for (const int map_size : {64, 300}) {
      const LitView lit = LightView(scene, view, light, map_size);
      const StandardMap map = RenderStandardMap(scene, lit.ray_space, lit.projection, lit.range).value();
      for (const DepthFormat format : {DepthFormat::kUnorm16, DepthFormat::kUnorm24, DepthFormat::kFloat32}) {
        for (const int pcf_radius : {0, 2}) {
          // Planes without end ask for no less.
          const BiasOptions options{format, pcf_radius, {300, 300}};
          const SafeBias endless = FindSafeBias(view.camera, view.surface.ws_point, view.surface.ws_normal,
                                                lit.ray_space, lit.projection, lit.range, options)
                                       .value();
          const SafeBias bias =
              FindSafeBias(view.camera, view.surface.ws_point, view.surface.ws_normal, lit.ray_space,
                           lit.projection, lit.range, options, view.surface.Depth())
                  .value();
          EXPECT_LE(bias.clamp, endless.clamp);
          EXPECT_GE(bias.clamp, 0.5 * endless.clamp);
          ASSERT_GT(bias.samples, 1000);
          const ShadowMask ideal =
              ShadowWithoutDepthErrors(map, pcf_radius, view.surface, lit.truth, lit.ray_space);
          const auto count = [&](BiasKind kind, double constant, double slope) {
            StandardTest test{format, kind, constant, slope, pcf_radius};
            test.clamp = bias.clamp;
            return CountArtefacts(lit.truth, ideal,
                                  ShadowFromStandardMap(map, test, view.surface, lit.truth, lit.ray_space));
          };
          EXPECT_EQ(count(BiasKind::kSlopeScaled, bias.constant, bias.slope).acne, 0);
          EXPECT_EQ(count(BiasKind::kConstant, bias.clamp, 0.0).acne, 0);
          EXPECT_EQ(count(BiasKind::kReceiverPlane, bias.receiver_plane_constant, 0.0).acne, 0);
          // A tenth less would not do: the promise is not bought with slack. (A filter's majority hides some
          // acne.)
          if (pcf_radius == 0) {
            EXPECT_GT(count(BiasKind::kConstant, 0.9 * bias.clamp, 0.0).acne, 0);
          }
          // Following the slope costs no more than a constant.
          EXPECT_LE(bias.ws_mean_detachment, bias.ws_mean_detachment_of_constant * (1.0 + 1e-9));
          acne_without += count(BiasKind::kConstant, 0.0, 0.0).acne;
        }
      }
    }
  }
  EXPECT_GT(acne_without, 100000);
}

TEST(SafeBiasTest, DetachesNoMoreThanTheBestConstantSetByHand) {
  const TruthScene scene = TruthScene::Create(PlanarScene()).value();
  const View view = MakeView(scene);
  for (const Light& light : Lights()) {
    const LitView lit = LightView(scene, view, light, 200);
    const StandardMap map = RenderStandardMap(scene, lit.ray_space, lit.projection, lit.range).value();
    const SafeBias bias =
        FindSafeBias(view.camera, view.surface.ws_point, view.surface.ws_normal, lit.ray_space,
                     lit.projection, lit.range, {DepthFormat::kUnorm24, 0, {300, 300}}, view.surface.Depth())
            .value();
    const ShadowMask ideal = ShadowWithoutDepthErrors(map, 0, view.surface, lit.truth, lit.ray_space);
    const auto count = [&](double constant, double slope) {
      StandardTest test{DepthFormat::kUnorm24, BiasKind::kSlopeScaled, constant, slope, 0};
      if (slope > 0.0) test.clamp = bias.clamp;
      return CountArtefacts(lit.truth, ideal,
                            ShadowFromStandardMap(map, test, view.surface, lit.truth, lit.ray_space));
    };
    const ArtefactCounts safe = count(bias.constant, bias.slope);
    int best = std::numeric_limits<int>::max();
    for (int i = 1; i <= 50; ++i) {
      const ArtefactCounts by_hand = count(bias.clamp * 1.5 * i / 50.0, 0.0);
      if (by_hand.acne <= safe.acne) best = std::min(best, by_hand.peter_panning);
    }
    EXPECT_LE(safe.peter_panning, best);
  }
}

TEST(SafeBiasTest, PredictsTheGapBesideACaster) {
  // A wall on a floor: its shadow begins where the bias lets it.
  Scene quads = SceneOf({}, {});
  AddQuad(&quads, {-6, -6, 0}, {12, 0, 0}, {0, 12, 0});
  AddQuad(&quads, {0, -3, 0}, {0, 6, 0}, {0, 0, 2});
  const TruthScene scene = TruthScene::Create(quads).value();
  const DirectionalLight light{{1.0, 0.0, -1.0}};
  const RaySpace ray_space = RaySpace::Create(light).value();
  const ShadowProjection projection = CenteredMap(4096, 8.0);
  const DepthRange range{0.0, -10.0, 10.0};
  const ReceiverProjector projector(ray_space, projection, range);
  const double bias = 0.02;
  const glm::dvec3 up(0, 0, 1);
  const StandardMap map = RenderStandardMap(scene, ray_space, projection, range).value();
  // Walk away from the wall until the shadow begins.
  VisibleSurface surface;
  surface.width = 2000;
  surface.height = 1;
  for (int i = 0; i < surface.width; ++i) {
    surface.primitive.push_back(0);
    surface.ws_point.push_back({0.0005 * (i + 0.5), 0.1, 0.0});
    surface.ws_normal.push_back(up);
  }
  const ShadowMask truth(surface.size(), PixelLight::kShadowed);
  const ShadowMask shown = ShadowFromStandardMap(
      map, {DepthFormat::kFloat32, BiasKind::kConstant, bias, 0.0, 0}, surface, truth, ray_space);
  double gap = 0.0;
  for (size_t i = 0; i < surface.size(); ++i) {
    if (shown[i] == PixelLight::kLit) gap = surface.ws_point[i].x;
  }
  const auto receiver = projector.Project({0.1, 0.1, 0.0}, up);
  ASSERT_TRUE(receiver.has_value());
  const double detachment = projector.WsDetachment(*receiver, {0.1, 0.1, 0.0}, bias);
  EXPECT_NEAR(gap, detachment * std::sqrt(0.5), 0.01);
  EXPECT_GT(gap, 0.1);
}

TEST(SafeBiasTest, DepthBufferGivesTheSamePlanesAsTheRays) {
  const TruthScene scene = TruthScene::Create(PlanarScene()).value();
  const View view = MakeView(scene);
  const SurfaceSamples samples = SamplesFromDepth(view.camera, view.surface.Depth());
  ASSERT_GT(samples.ws_point.size(), 10000U);
  for (const size_t limit : {size_t{1}, size_t{100}, size_t{5000}}) {
    const size_t count = SamplesFromDepth(view.camera, view.surface.Depth(), limit).ws_point.size();
    EXPECT_LE(count, limit);
    EXPECT_GE(count, limit / 8);
  }
  for (const Light& light : Lights()) {
    const LitView lit = LightView(scene, view, light, 300);
    const BiasOptions options{DepthFormat::kUnorm16, 0, {300, 300}};
    const SafeBias by_rays = FindSafeBias(view.camera, view.surface.ws_point, view.surface.ws_normal,
                                          lit.ray_space, lit.projection, lit.range, options)
                                 .value();
    const SafeBias by_depth = FindSafeBias(view.camera, samples.ws_point, samples.ws_normal, lit.ray_space,
                                           lit.projection, lit.range, options)
                                  .value();
    EXPECT_NEAR(by_depth.ws_mean_detachment, by_rays.ws_mean_detachment, 0.2 * by_rays.ws_mean_detachment);
    EXPECT_GE(by_depth.samples, by_rays.samples * 9 / 10);
  }
}

TEST(SafeBiasTest, NothingVisibleNeedsRoundingAlone) {
  const Camera camera = Camera::Create(CameraMatrices{}).value();
  const RaySpace ray_space = RaySpace::Create(DirectionalLight{}).value();
  const SafeBias bias = FindSafeBias(camera, {}, {}, ray_space, CenteredMap(8, 1.0), {}, {}).value();
  EXPECT_EQ(bias.samples, 0);
  EXPECT_EQ(bias.constant, DepthRounding(DepthFormat::kFloat32));
  EXPECT_EQ(bias.slope, 0.0);
  EXPECT_EQ(bias.ws_mean_detachment, 0.0);
}

TEST(SafeBiasTest, BadInputIsNamed) {
  const Camera camera = Camera::Create(CameraMatrices{}).value();
  const RaySpace ray_space = RaySpace::Create(DirectionalLight{}).value();
  const ShadowProjection map = CenteredMap(8, 1.0);
  const std::vector<glm::dvec3> one(1);
  const auto message = [&](std::span<const glm::dvec3> normals, const ShadowProjection& projection,
                           const DepthRange& range, const BiasOptions& options) {
    const absl::Status status =
        FindSafeBias(camera, one, normals, ray_space, projection, range, options).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
    return std::string(status.message());
  };
  EXPECT_THAT(message({}, map, {}, {}), StartsWith("ws_normals: 0 for 1"));
  EXPECT_THAT(message(one, map, {}, {.pcf_radius = -1}), StartsWith("pcf_radius: -1"));
  EXPECT_THAT(message(one, map, {}, {.pcf_radius = 17}), StartsWith("pcf_radius: 17"));
  EXPECT_THAT(message(one, map, {}, {.screen = {0, 1}}), StartsWith("screen: size 0x1"));
  EXPECT_THAT(message(one, map, {0.0, 1.0, 1.0}, {}), StartsWith("depth_range: 1 to 1"));
  EXPECT_THAT(message(one, map, {0.0, std::nan(""), 1.0}, {}), StartsWith("depth_range: nan"));
  ShadowProjection bad = map;
  bad.size.width = 0;
  EXPECT_THAT(message(one, bad, {}, {}), StartsWith("projection.size: 0x8"));
  bad = map;
  bad.texel_from_ray = glm::dmat3(0.0);
  EXPECT_THAT(message(one, bad, {}, {}), StartsWith("projection.texel_from_ray"));
  // Not finite, but well formed: takes no part.
  const std::vector<glm::dvec3> nowhere(1, glm::dvec3(std::nan("")));
  EXPECT_EQ(FindSafeBias(camera, nowhere, nowhere, ray_space, map, {}, {}).value().samples, 0);
}

}  // namespace
}  // namespace shadowfit
