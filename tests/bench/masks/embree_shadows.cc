#include "tests/bench/masks/embree_shadows.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <cmath>
#include <cstddef>
#include <limits>

namespace shadowfit::bench {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
/// Shadow rays end this share of their length before the surface that they belong to.
constexpr float kBackOff = 1e-4f;

struct TransmitContext {
  RTCIntersectContext base;
  float* transmittance;  ///< Indexed by ray id.
  const float* of_geometry;
};

void Accumulate(const RTCFilterFunctionNArguments* args) {
  auto* context = reinterpret_cast<TransmitContext*>(args->context);
  for (unsigned i = 0; i < args->N; ++i) {
    if (args->valid[i] != -1) continue;
    const unsigned id = RTCRayN_id(args->ray, args->N, i);
    const float t = context->of_geometry[RTCHitN_geomID(args->hit, args->N, i)];
    context->transmittance[id] *= t;
    if (t > 0.0f) args->valid[i] = 0;  // Goes on.
  }
}

glm::vec3 WsFromObject(const Instance& instance, const glm::vec3& p) {
  return instance.world_from_object * glm::vec4(p, 1.0f);
}

}  // namespace

std::vector<TraceMode> AllTraceModes() {
  std::vector<TraceMode> modes;
  for (const RayKernel kernel :
       {RayKernel::kSingle, RayKernel::kPacket8, RayKernel::kPacket16, RayKernel::kStream}) {
    modes.push_back({kernel, false});
    modes.push_back({kernel, true});
  }
  return modes;
}

std::string Name(const TraceMode& mode) {
  const char* kernel = mode.kernel == RayKernel::kSingle     ? "single"
                       : mode.kernel == RayKernel::kPacket8  ? "packets of 8"
                       : mode.kernel == RayKernel::kPacket16 ? "packets of 16"
                                                             : "streams";
  return std::string(kernel) + (mode.from_light ? " from the light" : " to the light");
}

EmbreeShadows::EmbreeShadows(const BenchScene& bench, int threads) : bench_(bench) {
  device_ = rtcNewDevice(("threads=" + std::to_string(threads)).c_str());
  for (const Instance& instance : bench.scene.instances) {
    std::vector<glm::vec3>& out = positions_.emplace_back();
    const Mesh& mesh = bench.scene.meshes[static_cast<size_t>(instance.mesh)];
    out.reserve(mesh.positions.size() + 2);
    for (const glm::vec3& p : mesh.positions) out.push_back(WsFromObject(instance, p));
    out.resize(out.size() + 2);
  }
}

EmbreeShadows::~EmbreeShadows() {
  if (scene_ != nullptr) rtcReleaseScene(scene_);
  rtcReleaseDevice(device_);
}

void EmbreeShadows::Build(RTCBuildQuality quality) {
  if (scene_ != nullptr) rtcReleaseScene(scene_);
  scene_ = rtcNewScene(device_);
  rtcSetSceneBuildQuality(scene_, quality);
  if (quality == RTC_BUILD_QUALITY_LOW) rtcSetSceneFlags(scene_, RTC_SCENE_FLAG_DYNAMIC);
  for (size_t i = 0; i < positions_.size(); ++i) {
    const Mesh& mesh = bench_.scene.meshes[static_cast<size_t>(bench_.scene.instances[i].mesh)];
    RTCGeometry geometry = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
    rtcSetGeometryBuildQuality(geometry, quality);
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, positions_[i].data(),
                               0, sizeof(glm::vec3), positions_[i].size() - 2);
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, mesh.triangles.data(), 0,
                               sizeof(glm::uvec3), mesh.triangles.size());
    if (bench_.scene.materials[static_cast<size_t>(mesh.material)].transmittance.x > 0.0f) {
      rtcSetGeometryOccludedFilterFunction(geometry, Accumulate);
    }
    rtcCommitGeometry(geometry);
    rtcAttachGeometryByID(scene_, geometry, static_cast<unsigned>(i));
    rtcReleaseGeometry(geometry);
  }
  rtcCommitScene(scene_);
}

std::vector<float> EmbreeShadows::Depth(const Camera& camera) const {
  const auto width = static_cast<size_t>(bench_.width), height = static_cast<size_t>(bench_.height);
  std::vector<float> depth(width * height, 1.0f);
  tbb::parallel_for(size_t{0}, height, [&](size_t y) {
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    for (size_t x = 0; x < width; ++x) {
      const double ndc_x = (double(x) + 0.5) * 2.0 / double(width) - 1.0;
      const double ndc_y = (double(y) + 0.5) * 2.0 / double(height) - 1.0;
      const glm::dvec4 near4 = camera.WsFromNdc({ndc_x, ndc_y, -1.0}),
                       far4 = camera.WsFromNdc({ndc_x, ndc_y, 1.0});
      const glm::dvec3 near(glm::dvec3(near4) / near4.w), far(glm::dvec3(far4) / far4.w);
      const glm::dvec3 direction = glm::normalize(far - near);
      RTCRayHit query{};
      query.ray.org_x = float(near.x), query.ray.org_y = float(near.y), query.ray.org_z = float(near.z);
      query.ray.dir_x = float(direction.x), query.ray.dir_y = float(direction.y),
      query.ray.dir_z = float(direction.z);
      query.ray.tfar = kInfinity;
      query.ray.mask = ~0u;
      query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
      rtcIntersect1(scene_, &context, &query);
      if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) continue;
      // The hit's plane meets the pixel's ray in double precision, as a rasteriser would place it.
      const Instance& instance = bench_.scene.instances[query.hit.geomID];
      const Mesh& mesh = bench_.scene.meshes[static_cast<size_t>(instance.mesh)];
      const glm::uvec3& t = mesh.triangles[query.hit.primID];
      const std::vector<glm::vec3>& p = positions_[query.hit.geomID];
      const glm::dvec3 a(p[t.x]), b(p[t.y]), c(p[t.z]);
      const glm::dvec3 normal = glm::cross(b - a, c - a);
      const double along = glm::dot(normal, a - near) / glm::dot(normal, direction);
      const glm::dvec4 clip = camera.clip_from_world() * glm::dvec4(near + along * direction, 1.0);
      depth[y * width + x] = static_cast<float>(0.5 * clip.z / clip.w + 0.5);
    }
  });
  return depth;
}

void EmbreeShadows::Trace(const std::vector<glm::vec3>& ws_positions, const TraceMode& mode, bool transmit,
                          std::vector<uint8_t>* shadow, std::vector<float>* transmittance) const {
  const int width = bench_.width, height = bench_.height;
  shadow->resize(ws_positions.size());
  if (transmit) transmittance->assign(ws_positions.size(), 1.0f);
  std::vector<float> of_geometry;
  for (const Instance& instance : bench_.scene.instances) {
    const Mesh& mesh = bench_.scene.meshes[static_cast<size_t>(instance.mesh)];
    of_geometry.push_back(bench_.scene.materials[static_cast<size_t>(mesh.material)].transmittance.x);
  }
  const glm::vec3 light(bench_.light.ws_position);
  // Tiles of 4x4 pixels are one packet of 16; a stream is a tile of 32x32.
  constexpr int kTile = 32;
  const int tiles_x = (width + kTile - 1) / kTile, tiles_y = (height + kTile - 1) / kTile;
  tbb::parallel_for(0, tiles_x * tiles_y, [&](int tile) {
    alignas(64) float
        rays[12][kTile * kTile];  // org 3, tnear, dir 3, time, tfar, and mask, id, flags as integers
    auto* mask = reinterpret_cast<unsigned*>(rays[9]);
    auto* id = reinterpret_cast<unsigned*>(rays[10]);
    auto* flags = reinterpret_cast<unsigned*>(rays[11]);
    const int x0 = tile % tiles_x * kTile, y0 = tile / tiles_x * kTile;
    int count = 0;
    for (int block = 0; block < kTile * kTile / 16; ++block) {
      for (int i = 0; i < 16; ++i) {
        const int x = x0 + block % (kTile / 4) * 4 + i % 4, y = y0 + block / (kTile / 4) * 4 + i / 4;
        const bool inside = x < width && y < height;
        const size_t pixel =
            inside ? static_cast<size_t>(y) * static_cast<size_t>(width) + static_cast<size_t>(x) : 0;
        const glm::vec3& p = ws_positions[pixel];
        const bool valid = inside && !std::isnan(p.x);
        const glm::vec3 from = mode.from_light ? light : p, to = mode.from_light ? p : light;
        for (int k = 0; k < 3; ++k) rays[k][count] = from[k], rays[4 + k][count] = to[k] - from[k];
        rays[3][count] = mode.from_light ? 0.0f : kBackOff;
        rays[7][count] = 0.0f;
        rays[8][count] = valid ? (mode.from_light ? 1.0f - kBackOff : 1.0f) : -kInfinity;
        mask[count] = ~0u;
        id[count] = static_cast<unsigned>(pixel);
        flags[count] = 0;
        ++count;
      }
    }
    TransmitContext context;
    rtcInitIntersectContext(&context.base);
    context.base.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    context.transmittance = transmit ? transmittance->data() : nullptr;
    context.of_geometry = of_geometry.data();
    if (mode.kernel == RayKernel::kStream) {
      RTCRayNp np{rays[0], rays[1], rays[2], rays[3], rays[4], rays[5],
                  rays[6], rays[7], rays[8], mask,    id,      flags};
      rtcOccludedNp(scene_, &context.base, &np, static_cast<unsigned>(count));
    } else if (mode.kernel == RayKernel::kSingle) {
      for (int i = 0; i < count; ++i) {
        if (!(rays[8][i] > 0.0f)) continue;
        RTCRay ray{rays[0][i], rays[1][i], rays[2][i], rays[3][i], rays[4][i], rays[5][i],
                   rays[6][i], rays[7][i], rays[8][i], mask[i],    id[i],      flags[i]};
        rtcOccluded1(scene_, &context.base, &ray);
        rays[8][i] = ray.tfar;
      }
    } else {
      const auto packets = [&]<typename Packet, int kSize>(auto&& trace) {
        alignas(64) int valid[kSize];
        for (int first = 0; first < count; first += kSize) {
          Packet packet;
          const auto copy = [&](auto& out, const auto* from) {
            for (int i = 0; i < kSize; ++i) out[i] = from[first + i];
          };
          copy(packet.org_x, rays[0]), copy(packet.org_y, rays[1]), copy(packet.org_z, rays[2]);
          copy(packet.tnear, rays[3]), copy(packet.dir_x, rays[4]), copy(packet.dir_y, rays[5]);
          copy(packet.dir_z, rays[6]), copy(packet.time, rays[7]), copy(packet.tfar, rays[8]);
          copy(packet.mask, mask), copy(packet.id, id), copy(packet.flags, flags);
          for (int i = 0; i < kSize; ++i) valid[i] = packet.tfar[i] > 0.0f ? -1 : 0;
          trace(valid, &packet);
          for (int i = 0; i < kSize; ++i) rays[8][first + i] = packet.tfar[i];
        }
      };
      if (mode.kernel == RayKernel::kPacket8) {
        packets.operator()<RTCRay8, 8>(
            [&](const int* valid, RTCRay8* packet) { rtcOccluded8(valid, scene_, &context.base, packet); });
      } else {
        packets.operator()<RTCRay16, 16>(
            [&](const int* valid, RTCRay16* packet) { rtcOccluded16(valid, scene_, &context.base, packet); });
      }
    }
    int i = 0;
    for (int block = 0; block < kTile * kTile / 16; ++block) {
      for (int k = 0; k < 16; ++k, ++i) {
        const int x = x0 + block % (kTile / 4) * 4 + k % 4, y = y0 + block / (kTile / 4) * 4 + k / 4;
        if (x >= width || y >= height) continue;
        const size_t pixel = static_cast<size_t>(y) * static_cast<size_t>(width) + static_cast<size_t>(x);
        (*shadow)[pixel] = !std::isnan(ws_positions[pixel].x) && rays[8][i] < 0.0f;
      }
    }
  });
}

}  // namespace shadowfit::bench
