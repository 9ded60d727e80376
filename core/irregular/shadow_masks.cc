#include "core/irregular/shadow_masks.h"

#include <tbb/task_arena.h>

#include <algorithm>
#include <atomic>
#include <bit>
#include <chrono>
#include <cmath>
#include <deque>

#include "absl/strings/str_format.h"
#include "core/irregular/caster_boxes.h"
#include "core/irregular/light_plan.h"
#include "core/irregular/mask_request.h"
#include "core/irregular/parallel.h"
#include "core/irregular/piece_renderer.h"
#include "core/math/ray_space.h"

namespace shadowfit {
namespace {

using namespace irregular;  // NOLINT(google-build-using-namespace): its implementation.

/// Pixels of a small piece, all layers counted: what is kept of them, some forty bytes a sample, fits the
/// second-level cache.
constexpr int kPieceStrips = 16;
constexpr int kPiecePixels = 1 << 15;
/// Lights whose boxes take more are rendered in groups, or one by one.
constexpr size_t kMostBoxBytes = size_t{64} << 20;

double MillisecondsSince(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
}

const char* KindName(const Light& light) {
  if (std::holds_alternative<PointLight>(light)) return "point";
  return std::holds_alternative<SpotLight>(light) ? "spot" : "directional";
}

}  // namespace

struct MaskRenderer::Workspace {
  // Of a frame.
  std::vector<Caster> casters;
  int channels = 3;  ///< Of absorbance; one where all casters are grey.
  std::vector<MaskScene::Cluster> moved_clusters;
  std::vector<const glm::mat4x3*> moved_to;  ///< By instance, null where it is not moved; empty if none is.
  std::vector<std::span<const MaskScene::Cluster>> parts;  ///< All clusters, in their order.
  std::vector<Piece> pieces;
  bool share_work = false;  ///< One piece, rather than one a task.
  int width = 0, height = 0, strips = 0;

  // Of a light.
  std::deque<LightPlan> plans;
  std::deque<CasterBoxes> boxes;            ///< Of a light of the group that is rendered.
  std::vector<std::vector<uint16_t>> bits;  ///< A word per strip.
  std::vector<std::vector<uint8_t>> rgb, coverage;
  std::vector<LightMask> masks;

  std::vector<PieceTotals> totals;  ///< Of each light's pieces.
  PieceRenderer shared_renderer;
  std::deque<PieceRenderer> renderers;  ///< One a thread.

  void CutIntoPieces(const MaskRequest& request);
  void SetUpCasters(const MaskRequest& request);
  absl::Status PlaceMovedInstances(const MaskRequest& request);
  absl::Status PlanLight(const MaskRequest& request, size_t light);
  size_t EndOfGroup(size_t clusters, size_t begin, size_t end) const;
  MaskImages ImagesOf(const MaskRequest& request, size_t light);
  absl::Status BoundCasters(const MaskRequest& request, size_t begin, size_t end);
  absl::Status RenderLights(const MaskRequest& request, size_t begin, size_t end);
  void Sum(const MaskRequest& request, size_t light);
};

void MaskRenderer::Workspace::CutIntoPieces(const MaskRequest& request) {
  const ReceiverLayer& first = request.layers[0];
  const bool has_positions = first.ws_positions.bottom_row != nullptr;
  width = has_positions ? first.ws_positions.width : first.depth.width;
  height = has_positions ? first.ws_positions.height : first.depth.height;
  strips = (width + kStrip - 1) / kStrip;
  const int layers = static_cast<int>(request.layers.size());
  const bool many = request.scene->TriangleCount() > kMostTrianglesOfPieces;
  share_work = request.method == MaskMethod::kGrid &&
               (request.pieces == MaskPieces::kFrame || (request.pieces == MaskPieces::kAuto && many));
  const int columns = share_work ? strips : kPieceStrips;
  const int rows = share_work ? height : std::max(1, kPiecePixels / (kPieceStrips * kStrip * layers));
  pieces.clear();
  for (int y = 0; y < height; y += rows) {
    for (int strip = 0; strip < strips; strip += columns) {
      pieces.push_back({strip, std::min(strip + columns, strips), y, std::min(y + rows, height), layers});
    }
  }
}

void MaskRenderer::Workspace::SetUpCasters(const MaskRequest& request) {
  const std::vector<Material>& materials = request.scene->materials();
  casters.resize(materials.size());
  channels = 1;
  for (size_t i = 0; i < materials.size(); ++i) {
    const Material& material = materials[i];
    Caster& caster = casters[i];
    caster = Caster{};
    if (material.alpha_texture >= 0) {
      caster.alpha = &request.scene->alpha_textures()[static_cast<size_t>(material.alpha_texture)];
      caster.alpha_cutoff = material.alpha_cutoff;
    }
    const glm::vec3& t = material.transmittance;
    if (t == glm::vec3(0.0f)) continue;
    if (request.output != MaskOutput::kTransmittance) {
      caster.casts = (t.x + t.y + t.z) / 3.0f < 0.5f;
      continue;
    }
    caster.transmits = true;
    caster.casts = t != glm::vec3(1.0f);
    for (int channel = 0; channel < 3; ++channel) {
      const double absorbed = t[channel] > 0.0f ? -std::log2(static_cast<double>(t[channel])) : 1e9;
      caster.absorbance[channel] = static_cast<uint32_t>(
          std::min(std::round(absorbed * kAbsorbanceOne), static_cast<double>(kAbsorbanceMax)));
      if (caster.absorbance[channel] != caster.absorbance[0]) channels = 3;
    }
  }
}

absl::Status MaskRenderer::Workspace::PlaceMovedInstances(const MaskRequest& request) {
  std::vector<const MovedInstance*> order;
  for (const MovedInstance& moved : request.moved_instances) order.push_back(&moved);
  std::sort(order.begin(), order.end(),
            [](const MovedInstance* a, const MovedInstance* b) { return a->instance < b->instance; });
  moved_clusters.clear();
  for (const MovedInstance* moved : order) {
    const std::span<const MaskScene::Cluster> clusters = request.scene->ClustersOf(moved->instance);
    moved_clusters.insert(moved_clusters.end(), clusters.begin(), clusters.end());
  }
  moved_to.assign(order.empty() ? 0 : request.scene->InstanceCount(), nullptr);
  parts.clear();
  const std::span<const MaskScene::Cluster> all(request.scene->clusters());
  size_t at = 0, moved_at = 0;
  for (const MovedInstance* moved : order) {
    const std::span<const MaskScene::Cluster> clusters = request.scene->ClustersOf(moved->instance);
    const auto first = static_cast<size_t>(clusters.data() - all.data());
    if (first > at) parts.push_back(all.subspan(at, first - at));
    parts.emplace_back(std::span(moved_clusters).subspan(moved_at, clusters.size()));
    at = first + clusters.size();
    moved_at += clusters.size();
    moved_to[moved->instance] = &moved->world_from_object;
  }
  parts.push_back(all.subspan(at));
  ForEachPiece(moved_clusters.size(), ClusteredMesh::kTaskClusters, request.cancellation,
               [&](size_t begin, size_t end) {
                 for (MaskScene::Cluster& cluster : std::span(moved_clusters).subspan(begin, end - begin)) {
                   request.scene->Place(*moved_to[cluster.instance], &cluster);
                 }
               });
  return CancellationStatus(request.cancellation, kRendering);
}

absl::Status MaskRenderer::Workspace::PlanLight(const MaskRequest& request, size_t light) {
  const absl::StatusOr<RaySpace> ray_space = RaySpace::Create(request.lights[light]);
  if (!ray_space.ok()) {
    return absl::Status(ray_space.status().code(),
                        absl::StrFormat("lights[%d].%s.%s", light, KindName(request.lights[light]),
                                        ray_space.status().message()));
  }
  const auto start = std::chrono::steady_clock::now();
  plans[light].Plan(request, light, *ray_space);
  masks[light] = LightMask{};
  masks[light].milliseconds.plan = MillisecondsSince(start);
  return CancellationStatus(request.cancellation, kRendering);
}

/// The lights [begin, EndOfGroup()) are rendered together: one at least.
size_t MaskRenderer::Workspace::EndOfGroup(size_t clusters, size_t begin, size_t end) const {
  size_t bytes = 0;
  for (size_t light = begin; light < end; ++light) {
    bytes += CasterBoxes::BytesFor(clusters, plans[light]);
    if (light > begin && bytes > kMostBoxBytes) return light;
  }
  return end;
}

absl::Status MaskRenderer::Workspace::BoundCasters(const MaskRequest& request, size_t begin, size_t end) {
  if (boxes.size() < end - begin) boxes.resize(end - begin);
  for (size_t light = begin; light < end; ++light) {
    const auto start = std::chrono::steady_clock::now();
    if (!boxes[light - begin].Compute(parts, plans[light], request.cancellation)) {
      return absl::ResourceExhaustedError(
          absl::StrFormat("scene: no memory for boxes of %d clusters", request.scene->clusters().size()));
    }
    masks[light].milliseconds.plan += MillisecondsSince(start);
    if (absl::Status status = CancellationStatus(request.cancellation, kRendering); !status.ok())
      return status;
  }
  return absl::OkStatus();
}

MaskImages MaskRenderer::Workspace::ImagesOf(const MaskRequest& request, size_t light) {
  const auto rows = static_cast<size_t>(height) * request.layers.size();
  const auto row_pixels = static_cast<size_t>(width);
  MaskImages images = {width, height, strips};
  bits[light].resize(rows * static_cast<size_t>(strips));
  images.bits = bits[light].data();
  if (request.output == MaskOutput::kTransmittance) {
    rgb[light].resize(rows * row_pixels * 3);
    images.rgb = rgb[light].data();
  }
  if (request.output == MaskOutput::kCoverage) {
    coverage[light].resize(static_cast<size_t>(height) * row_pixels);
    images.coverage = coverage[light].data();
  }
  return images;
}

/// A piece is rendered for one light after the other, while its depths are in the cache. World positions are
/// not shared between lights: from a pixel's depth it is one matrix to each light's coordinates
/// (RayFromPixel), eight multiplications a pixel as rows share the rest; from its position it would be nine,
/// and three doubles to store and to read.
absl::Status MaskRenderer::Workspace::RenderLights(const MaskRequest& request, size_t begin, size_t end) {
  if (absl::Status status = BoundCasters(request, begin, end); !status.ok()) return status;
  const CasterInput input = {request.scene, moved_to, casters, channels};
  std::vector<MaskImages> images;
  images.reserve(end - begin);
  for (size_t light = begin; light < end; ++light) images.push_back(ImagesOf(request, light));
  std::atomic<bool> failed{false};
  const auto render = [&](PieceRenderer& renderer, size_t i) {
    for (size_t light = begin; light < end; ++light) {
      const absl::Status status =
          renderer.Render(request, plans[light], boxes[light - begin], input, pieces[i], share_work,
                          images[light - begin], &totals[light * pieces.size() + i]);
      if (absl::IsResourceExhausted(status)) failed.store(true, std::memory_order_relaxed);
    }
  };
  if (share_work) {
    render(shared_renderer, 0);
  } else {
    const auto threads = static_cast<size_t>(std::max(tbb::this_task_arena::max_concurrency(), 1));
    if (renderers.size() < threads) renderers.resize(threads);
    for (PieceRenderer& renderer : renderers) {
      if (!renderer.Reserve(request, pieces[0], share_work, channels)) failed.store(true);
    }
    ForEach(pieces.size(), request.cancellation, [&](size_t i) {
      render(renderers[static_cast<size_t>(tbb::this_task_arena::current_thread_index())], i);
    });
  }
  if (absl::Status status = CancellationStatus(request.cancellation, kRendering); !status.ok()) return status;
  if (!failed.load()) return absl::OkStatus();
  return absl::ResourceExhaustedError(
      absl::StrFormat("layers: no memory for pieces of %d samples", kPiecePixels));
}

void MaskRenderer::Workspace::Sum(const MaskRequest& request, size_t light) {
  LightMask& mask = masks[light];
  mask.faces = plans[light].face_count;
  for (size_t i = 0; i < pieces.size(); ++i) {
    const PieceTotals& piece = totals[light * pieces.size() + i];
    mask.samples += piece.counts.samples;
    mask.known_samples += piece.counts.known;
    mask.facing_away_samples += piece.counts.facing_away;
    mask.outside_cone_samples += piece.counts.outside_cone;
    mask.shadowed_samples += piece.shadowed;
    mask.undecided_samples += piece.undecided;
    mask.milliseconds.project += piece.milliseconds.project;
    mask.milliseconds.sort += piece.milliseconds.sort;
    mask.milliseconds.walk += piece.milliseconds.walk;
    mask.milliseconds.resolve += piece.milliseconds.resolve;
  }
  static_assert(std::endian::native == std::endian::little);
  mask.bits = {reinterpret_cast<const uint8_t*>(bits[light].data()), bits[light].size() * sizeof(uint16_t)};
  mask.bytes_per_row = static_cast<size_t>(strips) * sizeof(uint16_t);
  if (request.output == MaskOutput::kTransmittance) mask.rgb = rgb[light];
  if (request.output == MaskOutput::kCoverage) mask.coverage = coverage[light];
}

MaskRenderer::MaskRenderer() : workspace_(std::make_unique<Workspace>()) {}
MaskRenderer::~MaskRenderer() = default;
MaskRenderer::MaskRenderer(MaskRenderer&&) noexcept = default;
MaskRenderer& MaskRenderer::operator=(MaskRenderer&&) noexcept = default;

absl::StatusOr<std::span<const LightMask>> MaskRenderer::Render(const MaskRequest& request) {
  if (absl::Status status = CheckRequest(request); !status.ok()) return status;
  Workspace& w = *workspace_;
  w.CutIntoPieces(request);
  w.SetUpCasters(request);
  if (absl::Status status = w.PlaceMovedInstances(request); !status.ok()) return status;
  const size_t lights = request.lights.size();
  w.masks.resize(lights);
  if (w.plans.size() < lights) w.plans.resize(lights);
  if (w.bits.size() < lights) w.bits.resize(lights);
  if (w.rgb.size() < lights) w.rgb.resize(lights);
  if (w.coverage.size() < lights) w.coverage.resize(lights);
  for (size_t light = 0; light < lights; ++light) {
    if (absl::Status status = w.PlanLight(request, light); !status.ok()) return status;
  }
  w.totals.assign(w.pieces.size() * lights, PieceTotals{});
  for (size_t begin = 0; begin < lights;) {
    const size_t end = w.EndOfGroup(request.scene->clusters().size(), begin, lights);
    if (absl::Status status = w.RenderLights(request, begin, end); !status.ok()) return status;
    begin = end;
  }
  std::vector<size_t> again;
  for (size_t light = 0; light < lights; ++light) {
    const PieceTotals* first = w.totals.data() + light * w.pieces.size();
    const bool off_face = std::any_of(first, first + w.pieces.size(),
                                      [](const PieceTotals& piece) { return piece.counts.off_face > 0; });
    if (off_face && w.plans[light].face_count == 1) {
      again.push_back(light);
    } else {
      w.Sum(request, light);
    }
  }
  // Rare samples that the planning ones did not foresee: all directions, then.
  for (const size_t light : again) {
    w.plans[light].UseSixFaces();
    if (absl::Status status = w.RenderLights(request, light, light + 1); !status.ok()) return status;
    w.Sum(request, light);
  }
  return std::span<const LightMask>(w.masks);
}

size_t MaskRenderer::MemoryBytes() const {
  const Workspace& w = *workspace_;
  size_t bytes = w.shared_renderer.MemoryBytes() + w.moved_clusters.capacity() * sizeof(MaskScene::Cluster) +
                 w.moved_to.capacity() * sizeof(const glm::mat4x3*);
  for (const PieceRenderer& renderer : w.renderers) bytes += renderer.MemoryBytes();
  for (const CasterBoxes& boxes : w.boxes) bytes += boxes.MemoryBytes();
  for (const auto& mask : w.bits) bytes += mask.capacity() * sizeof(uint16_t);
  for (const auto& mask : w.rgb) bytes += mask.capacity();
  for (const auto& mask : w.coverage) bytes += mask.capacity();
  return bytes;
}

std::string_view MaskMethodName(MaskMethod method) {
  switch (method) {
    case MaskMethod::kGrid:
      return "default";
    case MaskMethod::kBsp:
      return "bsp";
    case MaskMethod::kExhaustive:
      return "exhaustive";
  }
  return "unknown";
}

absl::StatusOr<MaskMethod> ParseMaskMethod(std::string_view name) {
  for (const MaskMethod method : {MaskMethod::kGrid, MaskMethod::kBsp, MaskMethod::kExhaustive}) {
    if (name == MaskMethodName(method)) return method;
  }
  return absl::InvalidArgumentError(
      absl::StrFormat("mask method: \"%s\" is none of default, bsp, exhaustive", name));
}

}  // namespace shadowfit
