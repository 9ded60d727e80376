#include "core/reference/truth_scene.h"

#include <embree3/rtcore.h>
#include <tbb/blocked_range2d.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "absl/strings/str_format.h"

namespace shadowfit {
namespace {

/// Rays are traced in square tiles, whose coherence Embree's ray streams turn into packets.
constexpr int kTileSide = 16;
constexpr size_t kTileRays = size_t{kTileSide} * kTileSide;

/// How far above its surface a shadow ray starts, as a share of the coordinates' size: tens of float
/// roundings, which covers those of the vertices, of the point and of the tracer.
constexpr double kRelativeOffset = 4e-6;

/// What a ray asks of the triangles that are not simply opaque.
enum class Question {
  kVisible,        ///< Cutouts have holes.
  kBlocked,        ///< Moreover, casters that let at least half of the light through do not count.
  kTransmittance,  ///< Moreover, semi-transparent casters dim the ray and let it pass.
};

/// A ray went through a semi-transparent triangle. Embree may report one hit several times.
struct Dimming {
  unsigned ray;
  uint32_t primitive;
  friend bool operator==(const Dimming&, const Dimming&) = default;
};

/// Embree hands this back to the filter functions; RTCRay::id is the ray's index in the tile.
struct Query {
  RTCIntersectContext embree;  ///< First: Embree sees a pointer to it.
  Question question;
  const uint32_t* own_primitive;   ///< Triangle that each ray starts from, or null.
  std::vector<Dimming>* dimmings;  ///< For Question::kTransmittance: what each ray passed, in any order.
};

Query MakeQuery(Question question, const uint32_t* own_primitive = nullptr,
                std::vector<Dimming>* dimmings = nullptr) {
  Query query;
  rtcInitIntersectContext(&query.embree);
  query.embree.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  query.question = question;
  query.own_primitive = own_primitive;
  query.dimmings = dimmings;
  return query;
}

/// The part t0 <= t <= t1 of a line inside a box; false where there is none.
bool ClipToBox(const Bounds& box, const glm::dvec3& origin, const glm::dvec3& direction, double* t0,
               double* t1) {
  for (int axis = 0; axis < 3; ++axis) {
    if (direction[axis] == 0.0) {
      if (origin[axis] < box.min[axis] || origin[axis] > box.max[axis]) return false;
      continue;
    }
    double enter = (box.min[axis] - origin[axis]) / direction[axis];
    double leave = (box.max[axis] - origin[axis]) / direction[axis];
    if (enter > leave) std::swap(enter, leave);
    *t0 = std::max(*t0, enter);
    *t1 = std::min(*t1, leave);
  }
  return *t0 <= *t1;
}

/// Rounds a ray to float from t0 on: starting beside the scene keeps distant lights and eyes from costing
/// digits.
RTCRay MakeRay(const glm::dvec3& origin, const glm::dvec3& direction, double t0, double t1, unsigned id) {
  const glm::dvec3 start = origin + t0 * direction;
  RTCRay ray;
  ray.org_x = float(start.x);
  ray.org_y = float(start.y);
  ray.org_z = float(start.z);
  ray.dir_x = float(direction.x);
  ray.dir_y = float(direction.y);
  ray.dir_z = float(direction.z);
  ray.tnear = 0.0f;
  ray.tfar = float(t1 - t0);
  ray.time = 0.0f;
  ray.mask = 0xffffffffu;
  ray.id = id;
  ray.flags = 0;
  return ray;
}

template <typename Work>
void ForEachTile(int width, int height, const Work& work) {
  const auto tiles = [](int size) { return (size + kTileSide - 1) / kTileSide; };
  tbb::parallel_for(tbb::blocked_range2d<int>(0, tiles(height), 0, tiles(width)), [&](const auto& range) {
    for (int row = range.rows().begin(); row != range.rows().end(); ++row) {
      for (int column = range.cols().begin(); column != range.cols().end(); ++column) {
        work(column * kTileSide, row * kTileSide, std::min(width, (column + 1) * kTileSide),
             std::min(height, (row + 1) * kTileSide));
      }
    }
  });
}

}  // namespace

struct TruthScene::Impl {
  /// What a ray must know of a triangle that may let it pass.
  struct Porous {
    int material = 0;
    std::array<glm::vec2, 3> uv{};
  };

  RTCDevice device = nullptr;
  RTCScene scene = nullptr;
  std::vector<Material> materials;
  std::vector<AlphaTexture> alpha_textures;
  std::vector<glm::vec3> ws_positions;  ///< One more than there are: Embree reads 16 bytes a vertex.
  std::vector<glm::uvec3> triangles;    ///< Opaque ones, then porous ones.
  std::vector<Porous> porous;
  size_t opaque_count = 0;
  Bounds ws_bounds;
  Bounds ws_box;  ///< The bounds with room for rounding.

  Impl() = default;
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;
  ~Impl() {
    if (scene != nullptr) rtcReleaseScene(scene);
    if (device != nullptr) rtcReleaseDevice(device);
  }

  void Flatten(const Scene& source);
  absl::Status Build();
  void AttachTriangles(size_t first, size_t count, unsigned geometry_id);

  uint32_t Primitive(unsigned geometry_id, unsigned primitive_id) const {
    return primitive_id + (geometry_id == 0 ? 0u : uint32_t(opaque_count));
  }

  glm::dvec3 Vertex(uint32_t primitive, int corner) const {
    return glm::dvec3(ws_positions[triangles[primitive][corner]]);
  }
  glm::dvec3 Normal(uint32_t primitive) const {
    const glm::dvec3 a = Vertex(primitive, 0);
    const glm::dvec3 normal = glm::cross(Vertex(primitive, 1) - a, Vertex(primitive, 2) - a);
    const double length = glm::length(normal);
    return length > 0.0 ? normal / length : glm::dvec3(0.0);
  }

  /// Where a line meets a triangle's plane, in double; the tracer's own t where the two are nearly parallel.
  double PlaneHit(uint32_t primitive, const glm::dvec3& origin, const glm::dvec3& direction,
                  double traced_t) const {
    const glm::dvec3 normal = Normal(primitive);
    const double t = glm::dot(normal, Vertex(primitive, 0) - origin) / glm::dot(normal, direction);
    const glm::dvec3 extent = glm::abs(ws_bounds.max - ws_bounds.min);
    const double doubt = 1e-4 * std::max({extent.x, extent.y, extent.z}) / glm::length(direction);
    return std::abs(t - traced_t) <= doubt ? t : traced_t;
  }

  bool Passes(uint32_t primitive, glm::vec2 barycentric, unsigned ray_id, const Query& query) const;
  static void FilterOwn(const RTCFilterFunctionNArguments* args);
  static void FilterPorous(const RTCFilterFunctionNArguments* args);

  /// Calls use(i, occluded) for every concerned pixel, after one shadow ray each.
  template <typename Use>
  void TraceShadowRays(const VisibleSurface& surface, const RaySpace& ray_space, Question question,
                       const Use& use) const;
};

void TruthScene::Impl::Flatten(const Scene& source) {
  materials = source.materials;
  alpha_textures = source.alpha_textures;
  std::vector<glm::uvec3> porous_triangles;
  triangles.reserve(source.TriangleCount());
  for (const Instance& instance : source.instances) {
    const Mesh& mesh = source.meshes[size_t(instance.mesh)];
    const Material& material = materials[size_t(mesh.material)];
    const bool is_porous = material.alpha_texture >= 0 || material.transmittance != glm::vec3(0.0f);
    const auto base = uint32_t(ws_positions.size());
    for (const glm::vec3& position : mesh.positions) {
      ws_positions.push_back(instance.world_from_object * glm::vec4(position, 1.0f));
      ws_bounds.Add(glm::dvec3(ws_positions.back()));
    }
    for (const glm::uvec3& triangle : mesh.triangles) {
      if (!is_porous) {
        triangles.push_back(triangle + base);
        continue;
      }
      porous_triangles.push_back(triangle + base);
      Porous& entry = porous.emplace_back();
      entry.material = mesh.material;
      for (int corner = 0; corner < 3 && !mesh.uvs.empty(); ++corner) {
        entry.uv[size_t(corner)] = mesh.uvs[triangle[corner]];
      }
    }
  }
  ws_positions.emplace_back(0.0f);
  opaque_count = triangles.size();
  triangles.insert(triangles.end(), porous_triangles.begin(), porous_triangles.end());
  if (ws_bounds.empty()) return;
  const glm::dvec3 magnitude = glm::max(glm::abs(ws_bounds.min), glm::abs(ws_bounds.max));
  const glm::dvec3 room(1e-5 * std::max({magnitude.x, magnitude.y, magnitude.z}));
  ws_box = {ws_bounds.min - room, ws_bounds.max + room};
}

absl::Status TruthScene::Impl::Build() {
  device = rtcNewDevice(nullptr);
  if (device == nullptr) {
    return absl::InternalError(
        absl::StrFormat("ray tracer: no device, error %d", rtcGetDeviceError(nullptr)));
  }
  scene = rtcNewScene(device);
  // Robust: no ray slips between two triangles that share an edge.
  rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
  AttachTriangles(0, opaque_count, 0);
  AttachTriangles(opaque_count, porous.size(), 1);
  rtcCommitScene(scene);
  switch (const RTCError error = rtcGetDeviceError(device)) {
    case RTC_ERROR_NONE:
      return absl::OkStatus();
    case RTC_ERROR_OUT_OF_MEMORY:
      return absl::ResourceExhaustedError(
          absl::StrFormat("ray tracer: out of memory with %d triangles", triangles.size()));
    default:
      return absl::InternalError(absl::StrFormat("ray tracer: error %d", error));
  }
}

void TruthScene::Impl::AttachTriangles(size_t first, size_t count, unsigned geometry_id) {
  if (count == 0) return;
  RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
  rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, ws_positions.data(), 0,
                             sizeof(glm::vec3), ws_positions.size() - 1);
  rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, triangles.data(),
                             first * sizeof(glm::uvec3), sizeof(glm::uvec3), count);
  rtcSetGeometryUserData(geometry, this);
  if (geometry_id == 0) {
    rtcSetGeometryOccludedFilterFunction(geometry, FilterOwn);
  } else {
    rtcSetGeometryIntersectFilterFunction(geometry, FilterPorous);
    rtcSetGeometryOccludedFilterFunction(geometry, FilterPorous);
  }
  rtcCommitGeometry(geometry);
  rtcAttachGeometryByID(scene, geometry, geometry_id);
  rtcReleaseGeometry(geometry);
}

bool TruthScene::Impl::Passes(uint32_t primitive, glm::vec2 barycentric, unsigned ray_id,
                              const Query& query) const {
  const Porous& triangle = porous[primitive - opaque_count];
  const Material& material = materials[size_t(triangle.material)];
  if (material.alpha_texture >= 0) {
    const glm::vec2 uv = (1.0f - barycentric.x - barycentric.y) * triangle.uv[0] +
                         barycentric.x * triangle.uv[1] + barycentric.y * triangle.uv[2];
    if (alpha_textures[size_t(material.alpha_texture)].AlphaAt(uv) < material.alpha_cutoff) return true;
  }
  const glm::vec3& t = material.transmittance;
  switch (query.question) {
    case Question::kVisible:
      return false;
    case Question::kBlocked:
      return t.r + t.g + t.b >= 1.5f;
    case Question::kTransmittance:
      if (t == glm::vec3(0.0f)) return false;
      query.dimmings->push_back({ray_id, primitive});
      return true;
  }
  return false;
}

void TruthScene::Impl::FilterOwn(const RTCFilterFunctionNArguments* args) {
  const auto& query = *reinterpret_cast<const Query*>(args->context);
  if (query.own_primitive == nullptr) return;
  for (unsigned i = 0; i < args->N; ++i) {
    if (args->valid[i] == 0) continue;
    const uint32_t own = query.own_primitive[RTCRayN_id(args->ray, args->N, i)];
    if (RTCHitN_primID(args->hit, args->N, i) == own) args->valid[i] = 0;
  }
}

void TruthScene::Impl::FilterPorous(const RTCFilterFunctionNArguments* args) {
  const auto& query = *reinterpret_cast<const Query*>(args->context);
  const auto& self = *static_cast<const Impl*>(args->geometryUserPtr);
  for (unsigned i = 0; i < args->N; ++i) {
    if (args->valid[i] == 0) continue;
    const uint32_t primitive = self.Primitive(1, RTCHitN_primID(args->hit, args->N, i));
    const unsigned ray_id = RTCRayN_id(args->ray, args->N, i);
    const glm::vec2 barycentric(RTCHitN_u(args->hit, args->N, i), RTCHitN_v(args->hit, args->N, i));
    const bool own = query.own_primitive != nullptr && query.own_primitive[ray_id] == primitive;
    if (own || self.Passes(primitive, barycentric, ray_id, query)) args->valid[i] = 0;
  }
}

template <typename Use>
void TruthScene::Impl::TraceShadowRays(const VisibleSurface& surface, const RaySpace& ray_space,
                                       Question question, const Use& use) const {
  ForEachTile(surface.width, surface.height, [&](int x0, int y0, int x1, int y1) {
    std::array<RTCRay, kTileRays> rays;
    std::array<uint32_t, kTileRays> own;
    std::array<size_t, kTileRays> pixel;
    std::array<glm::vec3, kTileRays> transmittance;
    std::vector<Dimming> dimmings;
    unsigned count = 0;
    for (int y = y0; y < y1; ++y) {
      for (int x = x0; x < x1; ++x) {
        const size_t i = size_t(y) * size_t(surface.width) + size_t(x);
        if (surface.primitive[i] == kNoPrimitive) continue;
        const glm::dvec3& ws_point = surface.ws_point[i];
        const glm::dvec3& ws_normal = surface.ws_normal[i];
        const glm::dvec3 towards_light = ray_space.TowardsLight(ws_point);
        if (!(glm::dot(ws_normal, towards_light) > 0.0) || !ray_space.Illuminates(ws_point)) continue;

        const glm::dvec3 size = glm::abs(ws_point);
        const glm::dvec3 origin =
            ws_point + ws_normal * (kRelativeOffset * std::max({size.x, size.y, size.z}));
        const double distance = glm::length(towards_light);
        double t0 = 0.0;
        double t1 = ray_space.is_directional() ? std::numeric_limits<double>::infinity() : distance;
        const glm::dvec3 direction = towards_light / distance;
        if (!ClipToBox(ws_box, origin, direction, &t0, &t1)) t1 = t0 = 0.0;
        rays[count] = MakeRay(origin, direction, t0, t1, count);
        own[count] = surface.primitive[i];
        pixel[count] = i;
        transmittance[count] = glm::vec3(1.0f);
        ++count;
      }
    }
    if (count == 0) return;
    Query query = MakeQuery(question, own.data(), &dimmings);
    rtcOccluded1M(scene, &query.embree, rays.data(), count, sizeof(RTCRay));
    // Sorted, so that each triangle counts once and the product is taken in one order.
    std::ranges::sort(dimmings, {}, [](const Dimming& d) { return std::pair(d.ray, d.primitive); });
    dimmings.erase(std::unique(dimmings.begin(), dimmings.end()), dimmings.end());
    for (const Dimming& d : dimmings) {
      transmittance[d.ray] *= materials[size_t(porous[d.primitive - opaque_count].material)].transmittance;
    }
    for (unsigned k = 0; k < count; ++k) use(pixel[k], rays[k].tfar < 0.0f, transmittance[k]);
  });
}

TruthScene::TruthScene(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
TruthScene::~TruthScene() = default;
TruthScene::TruthScene(TruthScene&&) noexcept = default;
TruthScene& TruthScene::operator=(TruthScene&&) noexcept = default;

absl::StatusOr<TruthScene> TruthScene::Create(const Scene& scene) {
  if (absl::Status status = Validate(scene); !status.ok()) return status;
  if (scene.TriangleCount() >= kNoPrimitive) {
    return absl::InvalidArgumentError(
        absl::StrFormat("scene: %d triangles, at most %d", scene.TriangleCount(), kNoPrimitive - 1));
  }
  auto impl = std::make_unique<Impl>();
  impl->Flatten(scene);
  if (absl::Status status = impl->Build(); !status.ok()) return status;
  return TruthScene(std::move(impl));
}

size_t TruthScene::TriangleCount() const { return impl_->triangles.size(); }
const Bounds& TruthScene::ws_bounds() const { return impl_->ws_bounds; }

glm::dvec3 TruthScene::WindingNormal(uint32_t primitive) const { return impl_->Normal(primitive); }

std::optional<TruthScene::Hit> TruthScene::FirstHit(const glm::dvec3& ws_origin,
                                                    const glm::dvec3& ws_direction) const {
  double t0 = 0.0;
  double t1 = std::numeric_limits<double>::infinity();
  if (!ClipToBox(impl_->ws_box, ws_origin, ws_direction, &t0, &t1)) return std::nullopt;
  RTCRayHit ray;
  ray.ray = MakeRay(ws_origin, ws_direction, t0, t1, 0);
  ray.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  Query query = MakeQuery(Question::kVisible);
  rtcIntersect1(impl_->scene, &query.embree, &ray);
  if (ray.hit.geomID == RTC_INVALID_GEOMETRY_ID) return std::nullopt;
  Hit hit;
  hit.primitive = impl_->Primitive(ray.hit.geomID, ray.hit.primID);
  hit.distance = impl_->PlaneHit(hit.primitive, ws_origin, ws_direction, t0 + double(ray.ray.tfar));
  hit.ws_point = ws_origin + hit.distance * ws_direction;
  const glm::dvec3 normal = impl_->Normal(hit.primitive);
  hit.ws_normal = glm::dot(normal, ws_direction) < 0.0 ? normal : -normal;
  return hit;
}

VisibleSurface TruthScene::RenderSurface(const Camera& camera, int width, int height) const {
  VisibleSurface surface;
  surface.width = width;
  surface.height = height;
  const size_t pixels = size_t(width) * size_t(height);
  const auto background = float(BackgroundWindowDepth(camera.clip_depth()));
  surface.depth.assign(pixels, background);
  surface.primitive.assign(pixels, kNoPrimitive);
  surface.ws_point.assign(pixels, glm::dvec3(0.0));
  surface.ws_normal.assign(pixels, glm::dvec3(0.0));

  ForEachTile(width, height, [&](int x0, int y0, int x1, int y1) {
    std::array<RTCRayHit, kTileRays> rays;
    std::array<RaySpace::WsRay, kTileRays> lines;
    std::array<double, kTileRays> starts;
    std::array<size_t, kTileRays> pixel;
    unsigned count = 0;
    for (int y = y0; y < y1; ++y) {
      for (int x = x0; x < x1; ++x) {
        const double ndc_x = 2.0 * (x + 0.5) / width - 1.0;
        const double ndc_y = 2.0 * (y + 0.5) / height - 1.0;
        const glm::dvec4 near = camera.WsFromNdc({ndc_x, ndc_y, NearNdc(camera.clip_depth())});
        const glm::dvec4 far = camera.WsFromNdc({ndc_x, ndc_y, FarNdc(camera.clip_depth())});
        const glm::dvec3 origin = glm::dvec3(near) / near.w;
        // far.w times the way to the far plane: stays finite where that plane is at infinity.
        const glm::dvec3 way = glm::dvec3(far) - far.w * origin;
        const double length = glm::length(way);
        double t0 = 0.0;
        double t1 = far.w > 0.0 ? length / far.w : std::numeric_limits<double>::infinity();
        if (!ClipToBox(impl_->ws_box, origin, way / length, &t0, &t1)) continue;
        lines[count] = {origin, way / length};
        starts[count] = t0;
        pixel[count] = size_t(y) * size_t(width) + size_t(x);
        rays[count].ray = MakeRay(origin, lines[count].direction, t0, t1, count);
        rays[count].hit.geomID = RTC_INVALID_GEOMETRY_ID;
        ++count;
      }
    }
    if (count == 0) return;
    Query query = MakeQuery(Question::kVisible);
    rtcIntersect1M(impl_->scene, &query.embree, rays.data(), count, sizeof(RTCRayHit));
    for (unsigned k = 0; k < count; ++k) {
      if (rays[k].hit.geomID == RTC_INVALID_GEOMETRY_ID) continue;
      const uint32_t primitive = impl_->Primitive(rays[k].hit.geomID, rays[k].hit.primID);
      const glm::dvec3 normal = impl_->Normal(primitive);
      if (normal == glm::dvec3(0.0)) continue;
      const size_t i = pixel[k];
      const double t = impl_->PlaneHit(primitive, lines[k].origin, lines[k].direction,
                                       starts[k] + double(rays[k].ray.tfar));
      surface.primitive[i] = primitive;
      surface.ws_point[i] = lines[k].origin + t * lines[k].direction;
      surface.ws_normal[i] = glm::dot(normal, lines[k].direction) < 0.0 ? normal : -normal;
      const glm::dvec4 clip = camera.clip_from_world() * glm::dvec4(surface.ws_point[i], 1.0);
      const double ndc = clip.z / clip.w;
      const double window = camera.clip_depth() == ClipDepth::kNegativeOneToOne ? 0.5 * ndc + 0.5 : ndc;
      surface.depth[i] = float(std::clamp(window, 0.0, 1.0));
    }
  });
  return surface;
}

ShadowMask TruthScene::TrueShadow(const VisibleSurface& surface, const RaySpace& ray_space) const {
  ShadowMask mask(surface.size(), PixelLight::kNotConcerned);
  impl_->TraceShadowRays(surface, ray_space, Question::kBlocked,
                         [&](size_t pixel, bool occluded, const glm::vec3&) {
                           mask[pixel] = occluded ? PixelLight::kShadowed : PixelLight::kLit;
                         });
  return mask;
}

std::vector<glm::vec3> TruthScene::TrueTransmittance(const VisibleSurface& surface,
                                                     const RaySpace& ray_space) const {
  std::vector<glm::vec3> transmittance(surface.size(), glm::vec3(1.0f));
  impl_->TraceShadowRays(surface, ray_space, Question::kTransmittance,
                         [&](size_t pixel, bool occluded, const glm::vec3& share) {
                           transmittance[pixel] = occluded ? glm::vec3(0.0f) : share;
                         });
  return transmittance;
}

absl::StatusOr<CasterMap> TruthScene::RenderCasters(const RaySpace& ray_space,
                                                    const ShadowProjection& projection) const {
  const MapSize size = projection.size;
  if (size.width < 1 || size.height < 1) {
    return absl::InvalidArgumentError(
        absl::StrFormat("projection.size: %dx%d, both must be positive", size.width, size.height));
  }
  CasterMap map;
  map.projection = projection;
  map.ray_from_texel = glm::inverse(projection.texel_from_ray);
  for (int column = 0; column < 3; ++column) {
    for (int row = 0; row < 3; ++row) {
      if (std::isfinite(projection.texel_from_ray[column][row]) &&
          std::isfinite(map.ray_from_texel[column][row])) {
        continue;
      }
      return absl::InvalidArgumentError("projection.texel_from_ray: not finite or singular");
    }
  }
  const auto texels = size_t(size.width) * size_t(size.height);
  map.along_ray.assign(texels, CasterMap::kNothing);
  map.primitive.assign(texels, kNoPrimitive);

  ForEachTile(size.width, size.height, [&](int x0, int y0, int x1, int y1) {
    std::array<RTCRayHit, kTileRays> rays;
    std::array<RaySpace::WsRay, kTileRays> lines;
    std::array<double, kTileRays> starts;
    std::array<size_t, kTileRays> texel;
    unsigned count = 0;
    for (int y = y0; y < y1; ++y) {
      for (int x = x0; x < x1; ++x) {
        const glm::dvec3 r = map.ray_from_texel * glm::dvec3(x + 0.5, y + 0.5, 1.0);
        // Real points have r.z = 1 > 0 under a directional light: this texel lies beyond its horizon.
        if (ray_space.is_directional() && !(r.z > 0.0)) continue;
        const RaySpace::WsRay line = ray_space.WorldRay(r);
        const double length = glm::length(line.direction);
        double t0 = ray_space.is_directional() ? -std::numeric_limits<double>::infinity() : 0.0;
        double t1 = std::numeric_limits<double>::infinity();
        const glm::dvec3 direction = line.direction / length;
        if (!ClipToBox(impl_->ws_box, line.origin, direction, &t0, &t1)) continue;
        lines[count] = line;
        starts[count] = t0;
        texel[count] = size_t(y) * size_t(size.width) + size_t(x);
        rays[count].ray = MakeRay(line.origin, direction, t0, t1, count);
        rays[count].hit.geomID = RTC_INVALID_GEOMETRY_ID;
        ++count;
      }
    }
    if (count == 0) return;
    Query query = MakeQuery(Question::kBlocked);
    rtcIntersect1M(impl_->scene, &query.embree, rays.data(), count, sizeof(RTCRayHit));
    for (unsigned k = 0; k < count; ++k) {
      if (rays[k].hit.geomID == RTC_INVALID_GEOMETRY_ID) continue;
      const uint32_t primitive = impl_->Primitive(rays[k].hit.geomID, rays[k].hit.primID);
      const double traced = (starts[k] + double(rays[k].ray.tfar)) / glm::length(lines[k].direction);
      map.primitive[texel[k]] = primitive;
      map.along_ray[texel[k]] = impl_->PlaneHit(primitive, lines[k].origin, lines[k].direction, traced);
    }
  });
  return map;
}

}  // namespace shadowfit
