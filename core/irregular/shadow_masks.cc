#include "core/irregular/shadow_masks.h"

#include <tbb/blocked_range.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <atomic>
#include <bit>
#include <chrono>
#include <cmath>
#include <cstring>
#include <limits>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/irregular/aligned_buffer.h"
#include "core/irregular/mask_kernels.h"
#include "core/irregular/sample_layout.h"
#include "core/math/ray_space.h"

namespace shadowfit {
namespace {

using namespace irregular;  // NOLINT(google-build-using-namespace): its implementation.

/// About this many samples plan a layout.
constexpr double kPlanningSamples = 5000.0;
constexpr size_t kMostDeferred = 256;
/// Parts of the tiles for each thread: some balance, little to merge.
constexpr int kChunksPerThread = 1;
constexpr int kDeferredRows = 8;
/// So many threads have answers of their own, which are merged in the end; others share theirs.
constexpr size_t kMostPrivate = 8;
/// Clusters of a task: enough to hide its overhead, few enough to share small scenes and to cancel soon.
constexpr size_t kMostClustersPerTask = 16;

using Clock = std::chrono::steady_clock;

class Stopwatch {
 public:
  double Lap() {
    const Clock::time_point now = Clock::now();
    const double milliseconds = std::chrono::duration<double, std::milli>(now - last_).count();
    last_ = now;
    return milliseconds;
  }

 private:
  Clock::time_point last_ = Clock::now();
};

/// tbb::parallel_for over [0, count), one index a task, which skips what is left once cancelled.
template <typename Body>
void ForEach(size_t count, const Cancellation* cancellation, const Body& body) {
  tbb::parallel_for(
      tbb::blocked_range<size_t>(0, count, 1),
      [&](const tbb::blocked_range<size_t>& range) {
        for (size_t i = range.begin(); i != range.end(); ++i) {
          if (cancellation != nullptr && cancellation->Requested()) return;
          body(i);
        }
      },
      tbb::simple_partitioner());
}

/// Keep where normal . (X - origin) + offset >= 0.
struct CullPlane {
  glm::dvec3 normal;
  double offset;
};

/// A face's samples lie within these planes, and casters of theirs too.
struct FaceBounds {
  std::array<CullPlane, 5> planes;

  bool MayBlock(const glm::dvec3& centre, const glm::dvec3& half_extent) const {
    for (const CullPlane& plane : planes) {
      const double reach = glm::dot(glm::abs(plane.normal), half_extent);
      const double at = glm::dot(plane.normal, centre) + plane.offset;
      // The slack covers the rounding of corners and samples to single precision, many times over.
      if (at + reach < -1e-4 * (reach + glm::dot(glm::abs(plane.normal), glm::abs(centre)))) return false;
    }
    return true;
  }
};

/// Rows of tiles of a layer, set up by one task.
struct Chunk {
  size_t layer = 0;
  int row_begin = 0, row_end = 0;
  std::vector<PacketEntry> entries;
  std::vector<uint32_t> scattered;  ///< Tiles whose samples are sorted one by one.
  size_t first_scattered = 0;       ///< Of all chunks' scattered tiles.
  TileCounts counts;
};

}  // namespace

struct MaskRenderer::Workspace {
  // Per tile of all layers, or pixel of it.
  AlignedBuffer<float> packets;
  AlignedBuffer<uint16_t> present, facing;
  // Per sample that is sorted, tile after tile.
  AlignedBuffer<uint32_t> place;  ///< First the cell, then the place among the sorted samples.
  AlignedBuffer<uint32_t> rank;
  AlignedBuffer<float> sorted_packets;
  AlignedBuffer<float> bsp_packets;
  // Per packet: tiles, then sorted ones. One after the other of `answer_copies`, answer_stride apart; only
  // the first is used before and after the walk.
  AlignedBuffer<uint16_t> shadow, touched, touched_twice;
  size_t answer_copies = 1, answer_stride = 0;
  size_t channels = 3;  ///< Of absorbance; one where all casters are grey.
  AlignedBuffer<uint32_t> absorbance;
  AlignedBuffer<uint8_t> packet_lock;
  // Per entry, in the order of their cells.
  AlignedBuffer<float> entry_floats;
  AlignedBuffer<uint32_t> entry_packet;
  EntryArrays entries;
  // Per cell and chunk.
  AlignedBuffer<uint32_t> histograms, sort_histograms;
  AlignedBuffer<float> row_reaches;
  AlignedBuffer<uint32_t> cell_start;
  AlignedBuffer<PacketEntry> sorted_entries;
  std::vector<uint32_t> row_packets, row_entries;

  std::vector<glm::vec3> rays;
  std::vector<glm::vec2> uv;
  std::array<Face, 6> faces;
  std::vector<LayerSource> layers;
  std::vector<Chunk> chunks;
  std::vector<Caster> casters;
  std::vector<MaskState> states;  ///< One for each copy of the answers.
  std::vector<FaceBounds> face_bounds;
  tbb::enumerable_thread_specific<std::vector<DeferredTriangle>> deferred;
  std::vector<const DeferredTriangle*> all_deferred;
  std::array<std::vector<BspNode>, 6> bsp;
  std::vector<glm::vec3> bsp_uvw;
  std::vector<uint32_t> bsp_order;
  std::vector<uint32_t> bsp_place;
  std::vector<uint16_t> bsp_shadow;

  // Clusters of instances that are elsewhere in this frame, by their place in the scene's list.
  AlignedBuffer<float> moved_blocks;
  std::vector<MaskScene::Cluster> moved_clusters;
  struct MovedRange {
    size_t first = 0, end = 0;  ///< Of the scene's clusters, ascending.
    size_t first_moved = 0;     ///< Of moved_clusters.
  };
  std::vector<MovedRange> moved_ranges;

  std::vector<std::vector<uint8_t>> bits, rgb, coverage;
  std::vector<LightMask> masks;

  // Of the current request.
  LightFrame frame;
  int face_count = 1;
  int tiles_in_row = 0, tile_rows = 0;  ///< Of one layer.
  uint32_t tiles = 0;                   ///< Of all layers.
  uint32_t cells = 0;
  uint32_t rows = 0;
  size_t scattered_tiles = 0;
  uint32_t end_packet = 0;
  size_t entry_count = 0;

  absl::Status RenderLight(const MaskRequest& request, size_t light);
  void SetUpFrame(const RaySpace& ray_space);
  void SetUpLayers(const MaskRequest& request);
  TileTask TaskFor(Chunk& chunk, const MaskRequest& request);
  void CollectRays(const MaskRequest& request, int* stride);
  void PlanFaces(size_t expected_samples);
  absl::Status SetUpAllTiles(const MaskRequest& request, size_t* off_face);
  absl::Status SortScattered(const MaskRequest& request);
  absl::Status ReservePackets(const MaskRequest& request);
  absl::Status SortEntries(const MaskRequest& request);
  absl::Status BuildBspOrder(const MaskRequest& request);
  void SetUpCasters(const MaskRequest& request);
  absl::Status PlaceMovedInstances(const MaskRequest& request);
  void BoundFaces();
  void Walk(const MaskRequest& request);
  void CopyAnswers();
  size_t MergeAnswers();
  void GatherScattered(const MaskRequest& request);
  void Resolve(const MaskRequest& request, size_t light);
  size_t ResolveTileRow(size_t tile_row, size_t bytes_per_row, bool transmit, size_t light);
  void ResolveCoverage(size_t width, size_t height, std::vector<uint8_t>* out) const;
};

namespace {

absl::Status OutOfMemory(size_t tiles) {
  return absl::ResourceExhaustedError(absl::StrFormat("layers: no memory for %d samples", tiles * kPacket));
}

const char* KindName(const Light& light) {
  if (std::holds_alternative<PointLight>(light)) return "point";
  return std::holds_alternative<SpotLight>(light) ? "spot" : "directional";
}

absl::Status CancelledStatus(const Cancellation* cancellation) {
  if (cancellation == nullptr || !cancellation->Requested()) return absl::OkStatus();
  if (cancellation->DeadlinePassed()) return absl::DeadlineExceededError("masks: the deadline has passed");
  return absl::CancelledError("masks: cancelled");
}

template <typename T>
absl::Status CheckSize(const ImageView<T>& image, int width, int height, const std::string& name) {
  if (image.bottom_row == nullptr) {
    return absl::InvalidArgumentError(absl::StrCat(name, ": no data"));
  }
  if (image.width != width || image.height != height) {
    return absl::InvalidArgumentError(absl::StrFormat("%s: size %dx%d, but the first layer is %dx%d", name,
                                                      image.width, image.height, width, height));
  }
  return absl::OkStatus();
}

absl::Status CheckMovedInstances(const MaskRequest& request) {
  std::vector<size_t> instances;
  for (size_t i = 0; i < request.moved_instances.size(); ++i) {
    const MovedInstance& moved = request.moved_instances[i];
    if (moved.instance >= request.scene->InstanceCount()) {
      return absl::InvalidArgumentError(absl::StrFormat("moved_instances[%d].instance: %d, but there are %d",
                                                        i, moved.instance, request.scene->InstanceCount()));
    }
    for (int column = 0; column < 4; ++column) {
      for (int row = 0; row < 3; ++row) {
        if (std::isfinite(moved.world_from_object[column][row])) continue;
        return absl::InvalidArgumentError(
            absl::StrFormat("moved_instances[%d].world_from_object[%d]: not finite", i, 3 * column + row));
      }
    }
    instances.push_back(moved.instance);
  }
  std::sort(instances.begin(), instances.end());
  const auto twice = std::adjacent_find(instances.begin(), instances.end());
  if (twice == instances.end()) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrFormat("moved_instances: instance %d is there twice", *twice));
}

absl::Status CheckRequest(const MaskRequest& request) {
  if (request.scene == nullptr) return absl::InvalidArgumentError("scene: none");
  if (absl::Status status = CheckMovedInstances(request); !status.ok()) return status;
  if (request.layers.empty()) return absl::InvalidArgumentError("layers: empty");
  const auto& first = request.layers[0];
  const int width = first.ws_positions.bottom_row != nullptr ? first.ws_positions.width : first.depth.width;
  const int height =
      first.ws_positions.bottom_row != nullptr ? first.ws_positions.height : first.depth.height;
  const int largest = MaskRenderer::kMaxSize;
  if (width <= 0 || height <= 0 || width > largest || height > largest) {
    return absl::InvalidArgumentError(
        absl::StrFormat("layers[0]: size %dx%d, both must be in [1, %d]", width, height, largest));
  }
  const auto tiles = [](int size, int tile) { return (static_cast<size_t>(size) + tile - 1) / tile; };
  if (tiles(width, kTileWidth) * tiles(height, kTileHeight) * kPacket * request.layers.size() >
      MaskRenderer::kMaxPixels) {
    return absl::InvalidArgumentError(absl::StrFormat("layers: %d of %dx%d, at most %d samples in all",
                                                      request.layers.size(), width, height,
                                                      MaskRenderer::kMaxPixels));
  }
  for (size_t i = 0; i < request.layers.size(); ++i) {
    const ReceiverLayer& layer = request.layers[i];
    const std::string name = absl::StrFormat("layers[%d]", i);
    if (layer.ws_positions.bottom_row != nullptr) {
      absl::Status status = CheckSize(layer.ws_positions, width, height, name + ".positions");
      if (!status.ok()) return status;
    } else {
      if (absl::Status status = CheckSize(layer.depth, width, height, name + ".depth"); !status.ok()) {
        return status;
      }
      if (request.camera == nullptr) {
        return absl::InvalidArgumentError(absl::StrCat("camera: none, but ", name, " has no positions"));
      }
      const glm::dvec2& offset = layer.pixel_offset;
      if (!(offset.x >= 0.0 && offset.x <= 1.0 && offset.y >= 0.0 && offset.y <= 1.0)) {
        return absl::InvalidArgumentError(
            absl::StrFormat("%s.pixel_offset: (%g, %g) is outside [0,1]", name, offset.x, offset.y));
      }
    }
    if (layer.ws_normals.bottom_row != nullptr) {
      absl::Status status = CheckSize(layer.ws_normals, width, height, name + ".normals");
      if (!status.ok()) return status;
    }
  }
  if (!request.known.empty() && request.known.size() != request.lights.size() * request.layers.size()) {
    return absl::InvalidArgumentError(absl::StrFormat("known: %d pictures for %d lights and %d layers",
                                                      request.known.size(), request.lights.size(),
                                                      request.layers.size()));
  }
  for (size_t i = 0; i < request.known.size(); ++i) {
    absl::Status status = CheckSize(request.known[i], width, height, absl::StrFormat("known[%d]", i));
    if (!status.ok()) return status;
  }
  return absl::OkStatus();
}

}  // namespace

void MaskRenderer::Workspace::SetUpFrame(const RaySpace& ray_space) {
  frame = LightFrame{};
  frame.directional = ray_space.is_directional();
  if (!frame.directional) frame.ws_origin = ray_space.ws_position();
  if (ray_space.cos_outer()) {
    frame.has_cone = true;
    frame.cos_outer = *ray_space.cos_outer();
  }
}

void MaskRenderer::Workspace::SetUpLayers(const MaskRequest& request) {
  layers.resize(request.layers.size());
  const auto& first = request.layers[0];
  const bool has_positions = first.ws_positions.bottom_row != nullptr;
  const int width = has_positions ? first.ws_positions.width : first.depth.width;
  const int height = has_positions ? first.ws_positions.height : first.depth.height;
  tiles_in_row = (width + kTileWidth - 1) / kTileWidth;
  tile_rows = (height + kTileHeight - 1) / kTileHeight;
  const size_t layer_tiles = static_cast<size_t>(tiles_in_row) * static_cast<size_t>(tile_rows);
  tiles = static_cast<uint32_t>(layer_tiles * request.layers.size());
  for (size_t i = 0; i < layers.size(); ++i) {
    LayerSource& source = layers[i];
    const ReceiverLayer& layer = request.layers[i];
    source = LayerSource{};
    source.depth = layer.depth;
    source.ws_positions = layer.ws_positions;
    source.ws_normals = layer.ws_normals;
    source.first_tile = i * layer_tiles;
    if (layer.ws_positions.bottom_row != nullptr) {
      source.depth.width = width;
      source.depth.height = height;
    } else {
      source.background = static_cast<float>(BackgroundWindowDepth(request.camera->clip_depth()));
    }
    // Three roundings of the projection beside the format's own.
    source.depth_relative_error = 3.0f * kUnitRoundoff;
    switch (request.depth_precision) {
      case DepthPrecision::kFloat32:
        source.depth_relative_error += kUnitRoundoff;
        break;
      case DepthPrecision::kUnorm24:
        source.depth_absolute_error = 0.5f / 16777215.0f;
        break;
      case DepthPrecision::kUnorm16:
        source.depth_absolute_error = 0.5f / 65535.0f;
        break;
      case DepthPrecision::kFloat16:
        source.depth_relative_error += 0x1p-11f;
        source.depth_absolute_error = 0x1p-25f;
        break;
    }
  }
}

namespace {

/// World-from-pixel, then world to ray coordinates, as one matrix: see RayFromPixel.
void SetRayFromPixel(const Camera& camera, const LightFrame& frame, const ReceiverLayer& layer, int width,
                     int height, LayerSource* source) {
  const glm::dmat4& m = camera.world_from_clip();
  const double z0 = NdcFromWindowDepth(camera.clip_depth(), 0.0);
  const double z1 = NdcFromWindowDepth(camera.clip_depth(), 1.0);
  const glm::dvec4 col_x = m[0] * (2.0 / width);
  const glm::dvec4 col_y = m[1] * (2.0 / height);
  const glm::dvec4 col_z = m[2] * (z1 - z0);
  const glm::dvec4 base = m[3] + m[2] * z0 + m[0] * (2.0 * layer.pixel_offset.x / width - 1.0) +
                          m[1] * (2.0 * layer.pixel_offset.y / height - 1.0);
  const auto to_ray = [&frame](const glm::dvec4& column, double out[4]) {
    const glm::dvec3 from_origin = glm::dvec3(column) - column.w * frame.ws_origin;
    for (int row = 0; row < 3; ++row) {
      out[row] = frame.rotation[row][0] * from_origin.x + frame.rotation[row][1] * from_origin.y +
                 frame.rotation[row][2] * from_origin.z;
    }
    out[3] = column.w;
  };
  to_ray(base, source->ray_from_pixel.base);
  to_ray(col_x, source->ray_from_pixel.col_x);
  to_ray(col_y, source->ray_from_pixel.col_y);
  to_ray(col_z, source->ray_from_pixel.col_z);
}

glm::dvec3 ViewDirection(const Camera& camera) {
  const glm::dvec4 near = camera.WsFromNdc({0.0, 0.0, NearNdc(camera.clip_depth())});
  const glm::dvec4& eye = camera.ws_eye();
  // From the eye towards the near plane; an orthographic camera's eye is that direction already.
  const glm::dvec3 direction =
      eye.w != 0.0 ? glm::dvec3(near) / near.w - glm::dvec3(eye) / eye.w : glm::dvec3(eye);
  const double length = glm::length(direction);
  return length > 0.0 && std::isfinite(length) ? direction / length : glm::dvec3(0.0, 0.0, -1.0);
}

}  // namespace

TileTask MaskRenderer::Workspace::TaskFor(Chunk& chunk, const MaskRequest& request) {
  const auto index = static_cast<size_t>(&chunk - chunks.data());
  TileTask task;
  task.frame = &frame;
  task.layer = &layers[chunk.layer];
  task.faces = faces.data();
  task.single_face = face_count == 1;
  task.sort_all = request.method != MaskMethod::kGrid;
  task.tiles_in_row = tiles_in_row;
  task.row_begin = chunk.row_begin;
  task.row_end = chunk.row_end;
  task.cancellation = request.cancellation;
  task.packets = packets.data();
  task.present = present.data();
  task.facing = facing.data();
  task.entries = &chunk.entries;
  task.histogram = histograms.data() + index * cells;
  task.row_reach = row_reaches.data() + index * rows;
  task.scattered = &chunk.scattered;
  return task;
}

void MaskRenderer::Workspace::CollectRays(const MaskRequest& request, int* stride) {
  *stride = std::max(1, static_cast<int>(std::sqrt(2.0 * static_cast<double>(tiles) / kPlanningSamples)));
  rays.clear();
  for (size_t layer = 0; layer < layers.size(); ++layer) {
    if (request.cancellation != nullptr && request.cancellation->Requested()) return;
    TileTask task;
    task.frame = &frame;
    task.layer = &layers[layer];
    task.tiles_in_row = tiles_in_row;
    task.row_end = tile_rows;
    SampleRays(task, *stride, &rays);
  }
}

void MaskRenderer::Workspace::PlanFaces(size_t expected_samples) {
  cells = rows = 0;
  const auto face_of = [](const glm::vec3& r) {
    const glm::vec3 a = glm::abs(r);
    const int axis = a.z >= a.x && a.z >= a.y ? 2 : a.y >= a.x ? 1 : 0;
    return 2 * axis + (r[axis] > 0.0f ? 0 : 1);
  };
  for (int f = 0; f < face_count; ++f) {
    Face& face = faces[static_cast<size_t>(f)];
    face.axis = face_count == 1 ? 2 : f / 2;
    face.sign = face_count == 1 || f % 2 == 0 ? 1.0f : -1.0f;
    uv.clear();
    for (const glm::vec3& r : rays) {
      if (face_count > 1 && face_of(r) != f) continue;
      const float w = frame.directional ? 1.0f : face.sign * r[face.axis];
      if (w > 0.0f) uv.emplace_back(r[(face.axis + 1) % 3] / w, r[(face.axis + 2) % 3] / w);
    }
    PlanFace(uv, expected_samples * uv.size() / std::max<size_t>(rays.size(), 1), &face);
    face.first_cell = cells;
    face.first_row = rows;
    cells += static_cast<uint32_t>(face.rows * face.columns);
    rows += static_cast<uint32_t>(face.rows);
  }
}

absl::Status MaskRenderer::Workspace::SetUpAllTiles(const MaskRequest& request, size_t* off_face) {
  if (!histograms.Reserve(size_t{cells} * (chunks.size() + 1)) ||
      !row_reaches.Reserve(size_t{rows} * (chunks.size() + 1))) {
    return OutOfMemory(tiles);
  }
  ForEach(chunks.size(), request.cancellation, [&](size_t i) {
    Chunk& chunk = chunks[i];
    std::memset(histograms.data() + i * cells, 0, cells * sizeof(uint32_t));
    std::fill_n(row_reaches.data() + i * rows, rows, 0.0f);
    chunk.scattered.clear();
    chunk.counts = TileCounts();
    SetUpTiles(TaskFor(chunk, request), &chunk.counts);
  });
  if (absl::Status status = CancelledStatus(request.cancellation); !status.ok()) return status;
  *off_face = 0;
  scattered_tiles = 0;
  for (Chunk& chunk : chunks) {
    *off_face += chunk.counts.off_face;
    chunk.first_scattered = scattered_tiles;
    scattered_tiles += chunk.scattered.size();
  }
  return absl::OkStatus();
}

absl::Status MaskRenderer::Workspace::ReservePackets(const MaskRequest& request) {
  const size_t all = size_t{end_packet} + 1;
  const bool transmit = request.output == MaskOutput::kTransmittance;
  const auto threads = static_cast<size_t>(std::max(tbb::this_task_arena::max_concurrency(), 1));
  answer_copies = std::min(threads, kMostPrivate + 1);
  answer_stride = (all + 63) / 64 * 64;
  const size_t answers = answer_stride * answer_copies;
  if (!sorted_packets.Reserve((all - tiles) * kPacketFloats) || !shadow.Reserve(answers) ||
      !touched.Reserve(answers) || !touched_twice.Reserve(answers) ||
      (transmit && (!absorbance.Reserve(all * channels * kPacket) || !packet_lock.Reserve(all)))) {
    return OutOfMemory(tiles);
  }
  tbb::parallel_for(tbb::blocked_range<size_t>(0, all, 1 << 14),
                    [&](const tbb::blocked_range<size_t>& range) {
                      for (size_t p = range.begin(); p != range.end(); ++p) {
                        shadow[p] = p < tiles ? static_cast<uint16_t>(~present[p]) : uint16_t{0};
                      }
                      std::memset(touched.data() + range.begin(), 0, range.size() * sizeof(uint16_t));
                      std::memset(touched_twice.data() + range.begin(), 0, range.size() * sizeof(uint16_t));
                      if (!transmit) return;
                      std::memset(absorbance.data() + range.begin() * channels * kPacket, 0,
                                  range.size() * channels * kPacket * sizeof(uint32_t));
                      std::memset(packet_lock.data() + range.begin(), 0, range.size());
                    });
  return absl::OkStatus();
}

absl::Status MaskRenderer::Workspace::SortScattered(const MaskRequest& request) {
  end_packet = tiles;
  for (int f = 0; f < face_count; ++f) {
    faces[static_cast<size_t>(f)].first_packet = faces[static_cast<size_t>(f)].end_packet = tiles;
  }
  if (scattered_tiles == 0) return ReservePackets(request);

  // 1. Cell and rank of each sample.
  const size_t stride = size_t{cells} * kSubrows + 1;
  const auto none = static_cast<uint32_t>(stride - 1);
  if (!sort_histograms.Reserve(stride * chunks.size()) || !place.Reserve(scattered_tiles * kPacket) ||
      !rank.Reserve(scattered_tiles * kPacket)) {
    return OutOfMemory(tiles);
  }
  ForEach(chunks.size(), request.cancellation, [&](size_t i) {
    uint32_t* histogram = sort_histograms.data() + i * stride;
    std::memset(histogram, 0, stride * sizeof(uint32_t));
    const size_t first = chunks[i].first_scattered * kPacket;
    BinSamples(TaskFor(chunks[i], request), chunks[i].scattered, none, place.data() + first,
               rank.data() + first, histogram, &chunks[i].counts);
  });
  if (absl::Status status = CancelledStatus(request.cancellation); !status.ok()) return status;

  // 2. Where each row's packets go. A packet holds samples of one row, which are not too far apart.
  const auto for_each_row = [&](const auto& body) {
    for (int f = 0; f < face_count; ++f) {
      const Face& face = faces[static_cast<size_t>(f)];
      tbb::parallel_for(tbb::blocked_range<int>(0, face.rows, 16), [&](const tbb::blocked_range<int>& range) {
        for (int row = range.begin(); row != range.end(); ++row) body(face, row);
      });
    }
  };
  // Calls cell(first of its subcells, place of its first sample) and gap(place) for the cells of a row.
  const auto lay_out = [&](const Face& face, int row, uint32_t at, const auto& cell_function,
                           const auto& gap) {
    int open_column = 0;
    for (int column = 0; column < face.columns; ++column) {
      const size_t cell = (face.first_cell + static_cast<size_t>(row) * static_cast<size_t>(face.columns) +
                           static_cast<size_t>(column)) *
                          kSubrows;
      uint32_t samples = 0;
      for (size_t chunk = 0; chunk < chunks.size(); ++chunk) {
        const uint32_t* counts = sort_histograms.data() + chunk * stride + cell;
        for (int i = 0; i < kSubrows; ++i) samples += counts[i];
      }
      if (samples == 0) continue;
      if (at % kPacket != 0 && column - open_column > kMostColumnsOfPacket / 2) {
        gap(at);
        at = (at + kPacket - 1) / kPacket * kPacket;
      }
      if (at % kPacket == 0 || (at + samples - 1) / kPacket != at / kPacket) open_column = column;
      cell_function(cell, at);
      at += samples;
    }
    if (at % kPacket != 0) gap(at);
    return (at + kPacket - 1) / kPacket;
  };
  row_packets.assign(rows + 1, 0);
  for_each_row([&](const Face& face, int row) {
    row_packets[face.first_row + static_cast<uint32_t>(row)] = lay_out(
        face, row, 0, [](size_t, uint32_t) {}, [](uint32_t) {});
  });
  uint32_t packet = 0;
  for (uint32_t& count : row_packets) packet += std::exchange(count, packet);
  end_packet = tiles + packet;
  for (int f = 0; f < face_count; ++f) {
    Face& face = faces[static_cast<size_t>(f)];
    face.first_packet = tiles + row_packets[face.first_row];
    face.end_packet = tiles + row_packets[face.first_row + static_cast<uint32_t>(face.rows)];
  }
  if (absl::Status status = ReservePackets(request); !status.ok()) return status;

  // 3. Samples to their places.
  for_each_row([&](const Face& face, int row) {
    const uint32_t first = row_packets[face.first_row + static_cast<uint32_t>(row)] * kPacket;
    lay_out(
        face, row, first,
        [&](size_t cell, uint32_t at) {
          for (int i = 0; i < kSubrows; ++i) {
            for (size_t chunk = 0; chunk < chunks.size(); ++chunk) {
              at += std::exchange(sort_histograms[chunk * stride + cell + static_cast<size_t>(i)], at);
            }
          }
        },
        // What is left of a packet is no sample, and decided.
        [&](uint32_t at) {
          shadow[tiles + at / kPacket] = static_cast<uint16_t>(0xFFFFu << (at % kPacket));
        });
  });
  ForEach(chunks.size(), request.cancellation, [&](size_t i) {
    const size_t first = chunks[i].first_scattered * kPacket;
    PlaceSamples(TaskFor(chunks[i], request), chunks[i].scattered, none, sort_histograms.data() + i * stride,
                 rank.data() + first, packet * kPacket, place.data() + first, sorted_packets.data());
  });
  if (absl::Status status = CancelledStatus(request.cancellation); !status.ok()) return status;
  tbb::parallel_for(tbb::blocked_range<size_t>(0, packet, 512), [&](const tbb::blocked_range<size_t>& range) {
    TransposePackets(sorted_packets.data() + range.begin() * kPacketFloats, range.size());
  });
  return CancelledStatus(request.cancellation);
}

absl::Status MaskRenderer::Workspace::SortEntries(const MaskRequest& request) {
  // 1. Entries of the packets that were sorted; rows have cells of their own.
  const size_t sorted = end_packet - tiles;
  if (!sorted_entries.Reserve(sorted) || !cell_start.Reserve(size_t{cells} + 1)) return OutOfMemory(tiles);
  uint32_t* const sorted_histogram = histograms.data() + chunks.size() * cells;
  float* const sorted_reach = row_reaches.data() + chunks.size() * rows;
  std::memset(sorted_histogram, 0, cells * sizeof(uint32_t));
  std::fill_n(sorted_reach, rows, 0.0f);
  const auto for_each_row = [&](const auto& body) {
    for (int f = 0; f < face_count; ++f) {
      Face& face = faces[static_cast<size_t>(f)];
      tbb::parallel_for(tbb::blocked_range<int>(0, face.rows, 16), [&](const tbb::blocked_range<int>& range) {
        for (int row = range.begin(); row != range.end(); ++row) body(face, row);
      });
    }
  };
  if (sorted > 0) {
    for_each_row([&](const Face& face, int row) {
      if (request.cancellation != nullptr && request.cancellation->Requested()) return;
      const uint32_t begin = row_packets[face.first_row + static_cast<uint32_t>(row)];
      const uint32_t end = row_packets[face.first_row + static_cast<uint32_t>(row) + 1];
      EnterPackets(frame, face, row, tiles + begin, tiles + end, tiles, sorted_packets.data(), shadow.data(),
                   sorted_entries.data() + begin, sorted_histogram, sorted_reach);
    });
  }

  if (absl::Status status = CancelledStatus(request.cancellation); !status.ok()) return status;

  // 2. Where each cell's entries start.
  row_entries.assign(rows + 1, 0);
  for_each_row([&](Face& face, int row) {
    const size_t global_row = face.first_row + static_cast<size_t>(row);
    const size_t first = face.first_cell + static_cast<size_t>(row) * static_cast<size_t>(face.columns);
    uint32_t count = 0;
    float reach = 0.0f;
    for (size_t chunk = 0; chunk <= chunks.size(); ++chunk) {
      const uint32_t* counts = histograms.data() + chunk * cells + first;
      for (int column = 0; column < face.columns; ++column) count += counts[column];
      reach = std::max(reach, row_reaches[chunk * rows + global_row]);
    }
    row_entries[global_row] = count;
    // Widths are rounded, and so is what they are subtracted from.
    const float extent = std::max(std::abs(face.u_min), std::abs(face.u_max));
    face.row_reach[static_cast<size_t>(row)] = 1.001f * reach + 4.0f * kUnitRoundoff * extent;
  });
  uint32_t at = 0;
  for (uint32_t& count : row_entries) at += std::exchange(count, at);
  entry_count = at;
  const size_t padded = (entry_count + 2 * kPacket - 1) / kPacket * kPacket;
  if (!entry_floats.Reserve(5 * padded) || !entry_packet.Reserve(2 * padded)) return OutOfMemory(tiles);
  entries.u_min = entry_floats.data();
  entries.v_min = entries.u_min + padded;
  entries.minus_u_max = entries.v_min + padded;
  entries.minus_v_max = entries.minus_u_max + padded;
  entries.farthest = entries.minus_v_max + padded;
  entries.packet = entry_packet.data();
  entries.lanes = entries.packet + padded;
  for_each_row([&](const Face& face, int row) {
    uint32_t start = row_entries[face.first_row + static_cast<uint32_t>(row)];
    const size_t first = face.first_cell + static_cast<size_t>(row) * static_cast<size_t>(face.columns);
    for (size_t cell = first; cell < first + static_cast<size_t>(face.columns); ++cell) {
      cell_start[cell] = start;
      for (size_t chunk = 0; chunk <= chunks.size(); ++chunk) {
        start += std::exchange(histograms[chunk * cells + cell], start);
      }
    }
  });
  cell_start[cells] = static_cast<uint32_t>(entry_count);

  // 3. Entries to their places.
  const auto place_entries = [&](const PacketEntry* from, size_t count, uint32_t* starts) {
    for (size_t i = 0; i < count; ++i) {
      const PacketEntry& entry = from[i];
      const uint32_t to = starts[entry.cell]++;
      entries.u_min[to] = entry.u_min;
      entries.v_min[to] = entry.v_min;
      entries.minus_u_max[to] = entry.minus_u_max;
      entries.minus_v_max[to] = entry.minus_v_max;
      entries.farthest[to] = entry.farthest;
      entries.packet[to] = entry.packet;
      entries.lanes[to] = entry.lanes;
    }
  };
  ForEach(chunks.size() + 1, request.cancellation, [&](size_t i) {
    uint32_t* starts = histograms.data() + i * cells;
    if (i == chunks.size()) {
      place_entries(sorted_entries.data(), sorted, starts);
    } else {
      place_entries(chunks[i].entries.data(), chunks[i].counts.entries, starts);
    }
  });
  for (int f = 0; f < face_count; ++f) {
    int& most = faces[static_cast<size_t>(f)].most_rows_of_packet;
    most = 1;
    for (const Chunk& chunk : chunks) most = std::max(most, chunk.counts.most_rows[f]);
  }
  return CancelledStatus(request.cancellation);
}

absl::Status MaskRenderer::Workspace::BuildBspOrder(const MaskRequest& request) {
  // Samples are already together; each face's are put into the tree's order. Leaves start at packet borders.
  const Cancellation* cancellation = request.cancellation;
  bsp_place.assign(static_cast<size_t>(end_packet - tiles) * kPacket, 0);
  const auto is_sample = [this](size_t i) { return (shadow[tiles + i / kPacket] >> (i % kPacket) & 1) == 0; };
  std::array<uint32_t, 6> first_packet{}, last_packet{};
  uint32_t packet = 0;
  for (int f = 0; f < face_count; ++f) {
    const auto index = static_cast<size_t>(f);
    const Face& face = faces[index];
    const size_t first = static_cast<size_t>(face.first_packet - tiles) * kPacket;
    const size_t end = static_cast<size_t>(face.end_packet - tiles) * kPacket;
    bsp_uvw.assign(end - first, glm::vec3(0.0f));
    bsp_order.clear();
    for (size_t i = 0; i < end - first; ++i) {
      if (!is_sample(first + i)) continue;
      const float* values =
          sorted_packets.data() + (first + i) / kPacket * kPacketFloats + (first + i) % kPacket;
      const glm::vec3 r(values[0], values[kPacket], values[2 * kPacket]);
      const float w = frame.directional ? 1.0f : face.sign * r[face.axis];
      bsp_uvw[i] = {r[(face.axis + 1) % 3] / w, r[(face.axis + 2) % 3] / w, frame.directional ? r.z : w};
      bsp_order.push_back(static_cast<uint32_t>(i));
    }
    if (absl::Status status = CancelledStatus(cancellation); !status.ok()) return status;
    BuildBsp(bsp_uvw, bsp_order, cancellation, &bsp[index]);
    if (absl::Status status = CancelledStatus(cancellation); !status.ok()) return status;
    first_packet[index] = packet;
    for (BspNode& node : bsp[index]) {
      if (node.right >= 0) continue;
      const uint32_t count = node.end_sample - node.first_sample;
      for (uint32_t i = 0; i < count; ++i) {
        bsp_place[first + bsp_order[node.first_sample + i]] = packet * kPacket + i;
      }
      node.first_sample = (tiles + packet) * kPacket;
      node.end_sample = node.first_sample + count;
      packet += (count + kPacket - 1) / kPacket;
    }
    last_packet[index] = packet;
  }
  if (!bsp_packets.Reserve(size_t{packet} * kPacketFloats)) return OutOfMemory(tiles);
  bsp_shadow.assign(packet, 0xFFFF);
  for (size_t i = 0; i < bsp_place.size(); ++i) {
    if (!is_sample(i)) continue;
    const uint32_t to = bsp_place[i];
    for (size_t row = 0; row < 4; ++row) {
      bsp_packets[to / kPacket * kPacketFloats + row * kPacket + to % kPacket] =
          sorted_packets[i / kPacket * kPacketFloats + row * kPacket + i % kPacket];
    }
    bsp_shadow[to / kPacket] = static_cast<uint16_t>(bsp_shadow[to / kPacket] & ~(1u << (to % kPacket)));
  }
  for (size_t i = 0; i < scattered_tiles * kPacket; ++i) {
    if (place[i] != kNoPlace) place[i] = bsp_place[place[i]];
  }
  for (int f = 0; f < face_count; ++f) {
    faces[static_cast<size_t>(f)].first_packet = tiles + first_packet[static_cast<size_t>(f)];
    faces[static_cast<size_t>(f)].end_packet = tiles + last_packet[static_cast<size_t>(f)];
  }
  end_packet = tiles + packet;
  if (absl::Status status = ReservePackets(request); !status.ok()) return status;
  std::copy(bsp_shadow.begin(), bsp_shadow.end(), shadow.data() + tiles);
  std::swap(sorted_packets, bsp_packets);
  return absl::OkStatus();
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
  moved_ranges.clear();
  moved_clusters.clear();
  size_t blocks = 0;
  for (const MovedInstance& moved : request.moved_instances)
    blocks += request.scene->BlocksOf(moved.instance);
  if (!moved_blocks.Reserve(blocks * kBlockFloats)) {
    return absl::ResourceExhaustedError(
        absl::StrFormat("moved_instances: no memory for %d triangles", blocks * kBlock));
  }
  blocks = 0;
  for (const MovedInstance& moved : request.moved_instances) {
    if (absl::Status status = CancelledStatus(request.cancellation); !status.ok()) return status;
    const auto [first, end] = request.scene->ClustersOf(moved.instance);
    const size_t first_moved = moved_clusters.size();
    const auto& clusters = request.scene->clusters();
    moved_clusters.insert(moved_clusters.end(), clusters.begin() + static_cast<std::ptrdiff_t>(first),
                          clusters.begin() + static_cast<std::ptrdiff_t>(end));
    const std::span<MaskScene::Cluster> mine(moved_clusters.data() + first_moved, end - first);
    request.scene->Place(moved.instance, moved.world_from_object, mine,
                         moved_blocks.data() + blocks * kBlockFloats, request.cancellation);
    for (MaskScene::Cluster& cluster : mine) cluster.first_block += static_cast<uint32_t>(blocks);
    blocks += request.scene->BlocksOf(moved.instance);
    moved_ranges.push_back({first, end, first_moved});
  }
  std::sort(moved_ranges.begin(), moved_ranges.end(),
            [](const MovedRange& a, const MovedRange& b) { return a.first < b.first; });
  return absl::OkStatus();
}

void MaskRenderer::Workspace::BoundFaces() {
  face_bounds.clear();
  for (int f = 0; f < face_count; ++f) {
    Face& face = faces[static_cast<size_t>(f)];
    face.u_min = face.v_min = std::numeric_limits<float>::infinity();
    face.u_max = face.v_max = face.farthest = -std::numeric_limits<float>::infinity();
    for (const Chunk& chunk : chunks) {
      face.u_min = std::min(face.u_min, chunk.counts.u_min[f]);
      face.u_max = std::max(face.u_max, chunk.counts.u_max[f]);
      face.v_min = std::min(face.v_min, chunk.counts.v_min[f]);
      face.v_max = std::max(face.v_max, chunk.counts.v_max[f]);
      face.farthest = std::max(face.farthest, chunk.counts.farthest[f]);
    }
    if (!face.HasSamples()) continue;
    const auto axis_of = [this](int axis) {
      return glm::dvec3(frame.rotation[axis][0], frame.rotation[axis][1], frame.rotation[axis][2]);
    };
    const glm::dvec3 x = axis_of((face.axis + 1) % 3);
    const glm::dvec3 y = axis_of((face.axis + 2) % 3);
    const glm::dvec3 w = static_cast<double>(face.sign) * axis_of(face.axis);
    const double u0 = face.u_min, u1 = face.u_max, v0 = face.v_min, v1 = face.v_max;
    FaceBounds& bounds = face_bounds.emplace_back();
    if (frame.directional) {
      bounds.planes = {{{x, -u0}, {-x, u1}, {y, -v0}, {-y, v1}, {-w, face.farthest}}};
    } else {
      bounds.planes = {
          {{x - u0 * w, 0}, {u1 * w - x, 0}, {y - v0 * w, 0}, {v1 * w - y, 0}, {-w, face.farthest}}};
    }
  }
}

void MaskRenderer::Workspace::CopyAnswers() {
  const size_t all = size_t{end_packet} + 1;
  for (size_t copy = 1; copy < answer_copies; ++copy) {
    tbb::parallel_for(tbb::blocked_range<size_t>(0, all, 1 << 14), [&](const tbb::blocked_range<size_t>& r) {
      const size_t to = copy * answer_stride + r.begin(), bytes = r.size() * sizeof(uint16_t);
      std::memcpy(shadow.data() + to, shadow.data() + r.begin(), bytes);
      std::memset(touched.data() + to, 0, bytes);
      std::memset(touched_twice.data() + to, 0, bytes);
    });
  }
}

/// Into the first copy. Returns the number of undecided samples.
size_t MaskRenderer::Workspace::MergeAnswers() {
  std::atomic<size_t> undecided{0};
  tbb::parallel_for(
      tbb::blocked_range<size_t>(0, end_packet, 1 << 14), [&](const tbb::blocked_range<size_t>& range) {
        size_t count = 0;
        for (size_t p = range.begin(); p != range.end(); ++p) {
          unsigned blocked = shadow[p], once = touched[p], twice = touched_twice[p];
          for (size_t copy = 1, at = p + answer_stride; copy < answer_copies; ++copy, at += answer_stride) {
            blocked |= shadow[at];
            twice |= touched_twice[at] | (once & touched[at]);
            once |= touched[at];
          }
          shadow[p] = static_cast<uint16_t>(blocked);
          if (twice != 0) count += static_cast<size_t>(std::popcount(twice & ~blocked));
        }
        undecided.fetch_add(count, std::memory_order_relaxed);
      });
  return undecided.load();
}

void MaskRenderer::Workspace::Walk(const MaskRequest& request) {
  MaskState state;
  state.frame = &frame;
  state.faces = faces.data();
  state.face_count = face_count;
  state.search = request.method == MaskMethod::kBsp          ? Search::kBsp
                 : request.method == MaskMethod::kExhaustive ? Search::kExhaustive
                                                             : Search::kGrid;
  state.cancellation = request.cancellation;
  state.cell_start = cell_start.data();
  state.entries = entries;
  state.bsp = bsp.data();
  state.packets[0] = packets.data();
  state.packets[1] = sorted_packets.data() - size_t{tiles} * kPacketFloats;
  state.first_sorted = tiles;
  state.shadow = shadow.data();
  state.touched = touched.data();
  state.touched_twice = touched_twice.data();
  if (request.output == MaskOutput::kTransmittance) {
    state.absorbance = absorbance.data();
    state.packet_lock = packet_lock.data();
    state.channels = channels;
  }
  CopyAnswers();
  states.assign(answer_copies, state);
  for (size_t copy = 0; copy < answer_copies; ++copy) {
    states[copy].shared = copy == kMostPrivate;
    states[copy].shadow += copy * answer_stride;
    states[copy].touched += copy * answer_stride;
    states[copy].touched_twice += copy * answer_stride;
  }
  const auto my_state = [this]() -> const MaskState& {
    const int thread = tbb::this_task_arena::current_thread_index();
    return states[std::min(static_cast<size_t>(std::max(thread, 0)), answer_copies - 1)];
  };
  for (auto& list : deferred) list.clear();

  const std::vector<MaskScene::Cluster>& clusters = request.scene->clusters();
  const bool exhaustive = request.method == MaskMethod::kExhaustive;
  const auto walk_cluster = [&](const MaskState& mine, const MaskScene::Cluster& cluster,
                                const float* geometry, std::vector<DeferredTriangle>* list) {
    const Caster& caster = casters[cluster.material];
    if (!caster.casts) return;
    if (!exhaustive) {
      const glm::dvec3 low = glm::dvec3(cluster.ws_min) - frame.ws_origin;
      const glm::dvec3 high = glm::dvec3(cluster.ws_max) - frame.ws_origin;
      const glm::dvec3 centre = 0.5 * (low + high), half_extent = 0.5 * (high - low);
      if (std::none_of(face_bounds.begin(), face_bounds.end(),
                       [&](const FaceBounds& b) { return b.MayBlock(centre, half_extent); })) {
        return;
      }
    }
    CasterBlocks blocks;
    blocks.geometry = geometry + size_t{cluster.first_block} * kBlockFloats;
    blocks.uvs = cluster.first_uv < 0 ? nullptr : request.scene->uvs().data() + cluster.first_uv;
    blocks.count = cluster.block_count;
    blocks.caster = &caster;
    WalkTriangles(mine, blocks, list);
  };
  const size_t grain = std::clamp(clusters.size() / 64, size_t{1}, kMostClustersPerTask);
  ForEach((clusters.size() + grain - 1) / grain, request.cancellation, [&](size_t task) {
    const MaskState& mine = my_state();
    std::vector<DeferredTriangle>& list = deferred.local();
    list.reserve(kMostDeferred);
    std::vector<DeferredTriangle>* const deferred_to = request.method == MaskMethod::kGrid ? &list : nullptr;
    const size_t end = std::min(clusters.size(), (task + 1) * grain);
    auto range = std::upper_bound(moved_ranges.begin(), moved_ranges.end(), task * grain,
                                  [](size_t at, const MovedRange& r) { return at < r.end; });
    for (size_t c = task * grain; c < end; ++c) {
      while (range != moved_ranges.end() && c >= range->end) ++range;
      if (range != moved_ranges.end() && c >= range->first) {
        walk_cluster(mine, moved_clusters[range->first_moved + c - range->first], moved_blocks.data(),
                     deferred_to);
      } else {
        walk_cluster(mine, clusters[c], request.scene->geometry(), deferred_to);
      }
    }
  });

  all_deferred.clear();
  for (const auto& list : deferred) {
    for (const DeferredTriangle& triangle : list) all_deferred.push_back(&triangle);
  }
  for (int f = 0; f < face_count && !all_deferred.empty(); ++f) {
    const int rows = faces[static_cast<size_t>(f)].rows;
    ForEach(static_cast<size_t>((rows + kDeferredRows - 1) / kDeferredRows), request.cancellation,
            [&](size_t band) {
              const MaskState& mine = my_state();
              const int first = static_cast<int>(band) * kDeferredRows;
              for (const DeferredTriangle* triangle : all_deferred) {
                if (mine.Cancelled()) return;
                if (triangle->face == f) {
                  WalkDeferred(mine, *triangle, first, std::min(rows, first + kDeferredRows));
                }
              }
            });
  }
}

namespace {

/// RGB8 values of sums of absorbance. A table of coarse steps, in each of which the value falls by one at
/// most, and the exact sum at which it does.
class AbsorbanceTable {
 public:
  AbsorbanceTable() {
    for (int value = 0; value < 256; ++value) {
      // 255 * 2^-(sum / one) rounds to more than `value` up to this sum.
      const double most = std::log2(255.0 / (value + 0.5)) * kAbsorbanceOne;
      last_above_[static_cast<size_t>(value)] = most < 0.0 ? -1 : static_cast<int64_t>(std::floor(most));
    }
    for (size_t i = 0; i < coarse_.size(); ++i) {
      const auto sum = static_cast<double>(i << kCoarseBits);
      coarse_[i] = static_cast<uint8_t>(std::lround(255.0 * std::exp2(-sum / kAbsorbanceOne)));
    }
  }

  uint8_t Value(uint32_t sum) const {
    const size_t i = sum >> kCoarseBits;
    if (i >= coarse_.size()) return 0;
    uint8_t value = coarse_[i];
    if (value > 0 && static_cast<int64_t>(sum) > last_above_[value - 1u]) --value;
    return value;
  }

 private:
  static constexpr int kCoarseBits = 6;
  std::array<int64_t, 256> last_above_{};
  std::array<uint8_t, (10u << 16 >> kCoarseBits)> coarse_{};
};

}  // namespace

namespace {

/// Four tiles side by side, each a 16-bit word of four lines of four bits, as four lines of 16 bits: the
/// transpose of a 4x4 matrix of half-bytes.
uint64_t LinesOfTiles(uint64_t tiles) {
  static_assert(kTileWidth == 4 && kTileHeight == 4);
  const uint64_t outer = (tiles ^ (tiles >> 12)) & 0x0000F0F00000F0F0u;
  tiles ^= outer ^ (outer << 12);
  const uint64_t inner = (tiles ^ (tiles >> 24)) & 0x00000000FF00FF00u;
  return tiles ^ inner ^ (inner << 24);
}

}  // namespace

size_t MaskRenderer::Workspace::ResolveTileRow(size_t tile_row, size_t bytes_per_row, bool transmit,
                                               size_t light) {
  constexpr size_t kTilesInWord = kPacket / kTileWidth;
  const auto height = static_cast<size_t>(layers[0].depth.height);
  const auto width = static_cast<size_t>(layers[0].depth.width);
  const auto row_tiles = static_cast<size_t>(tiles_in_row);
  const uint16_t* from = shadow.data() + tile_row * row_tiles;
  const size_t layer = tile_row / static_cast<size_t>(tile_rows);
  const size_t first_y = tile_row % static_cast<size_t>(tile_rows) * kTileHeight;
  const size_t lines = std::min<size_t>(kTileHeight, height - first_y);
  uint8_t* out = bits[light].data() + (layer * height + first_y) * bytes_per_row;
  size_t count = 0;
  for (size_t x = 0; x < row_tiles; x += kTilesInWord) {
    uint64_t tiles_of_word = 0;  // x86 is little-endian.
    std::memcpy(&tiles_of_word, from + x, std::min(kTilesInWord, row_tiles - x) * sizeof(uint16_t));
    const uint64_t words = LinesOfTiles(tiles_of_word);
    count += static_cast<size_t>(std::popcount(words));
    for (size_t line = 0; line < lines; ++line) {
      const auto packed = static_cast<uint16_t>(words >> (16 * line));
      std::memcpy(out + line * bytes_per_row + x / kTilesInWord * 2, &packed, sizeof(packed));
    }
  }
  if (!transmit) return count;
  static const AbsorbanceTable table;
  for (size_t line = 0; line < lines; ++line) {
    uint8_t* colour = rgb[light].data() + (layer * height + first_y + line) * width * 3;
    for (size_t x = 0; x < width; ++x) {
      const size_t tile = tile_row * row_tiles + x / kTileWidth;
      const size_t lane = line * kTileWidth + x % kTileWidth;
      const bool blocked = (shadow[tile] >> lane & 1) != 0;
      const uint32_t* sums = absorbance.data() + tile * channels * kPacket + lane;
      for (size_t channel = 0; channel < 3; ++channel) {
        colour[3 * x + channel] = blocked ? 0 : table.Value(sums[std::min(channel, channels - 1) * kPacket]);
      }
    }
  }
  return count;
}

void MaskRenderer::Workspace::GatherScattered(const MaskRequest& request) {
  const bool transmit = request.output == MaskOutput::kTransmittance;
  for (const Chunk& chunk : chunks) {
    tbb::parallel_for(tbb::blocked_range<size_t>(0, chunk.scattered.size(), 256),
                      [&](const tbb::blocked_range<size_t>& range) {
                        for (size_t i = range.begin(); i != range.end(); ++i) {
                          const uint32_t tile = chunk.scattered[i];
                          const uint32_t* places = place.data() + (chunk.first_scattered + i) * kPacket;
                          unsigned bits = shadow[tile];
                          for (size_t lane = 0; lane < kPacket; ++lane) {
                            if (places[lane] == kNoPlace) continue;
                            const size_t from = tiles + places[lane] / kPacket,
                                         from_lane = places[lane] % kPacket;
                            bits |= (shadow[from] >> from_lane & 1u) << lane;
                            if (!transmit) continue;
                            for (size_t channel = 0; channel < channels; ++channel) {
                              absorbance[(size_t{tile} * channels + channel) * kPacket + lane] =
                                  absorbance[(from * channels + channel) * kPacket + from_lane];
                            }
                          }
                          shadow[tile] = static_cast<uint16_t>(bits);
                        }
                      });
  }
}

void MaskRenderer::Workspace::Resolve(const MaskRequest& request, size_t light) {
  LightMask& mask = masks[light];
  const size_t height = static_cast<size_t>(layers[0].depth.height);
  const size_t width = static_cast<size_t>(layers[0].depth.width);
  const bool transmit = request.output == MaskOutput::kTransmittance;
  mask.bytes_per_row = (width + kPacket - 1) / kPacket * 2;
  bits[light].resize(height * layers.size() * mask.bytes_per_row);
  if (transmit) rgb[light].resize(height * layers.size() * width * 3);
  mask.undecided_samples = MergeAnswers();
  if (scattered_tiles > 0) GatherScattered(request);
  tbb::parallel_for(tbb::blocked_range<size_t>(0, tiles, 1 << 14),
                    [&](const tbb::blocked_range<size_t>& range) {
                      for (size_t t = range.begin(); t != range.end(); ++t) {
                        shadow[t] = static_cast<uint16_t>((shadow[t] & present[t]) | facing[t]);
                      }
                    });

  const Cancellation* const cancellation = request.cancellation;
  std::atomic<size_t> shadowed{0};
  tbb::parallel_for(tbb::blocked_range<size_t>(0, static_cast<size_t>(tile_rows) * layers.size(), 4),
                    [&](const tbb::blocked_range<size_t>& range) {
                      size_t count = 0;
                      for (size_t row = range.begin(); row != range.end(); ++row) {
                        if (cancellation != nullptr && cancellation->Requested()) return;
                        count += ResolveTileRow(row, mask.bytes_per_row, transmit, light);
                      }
                      shadowed.fetch_add(count, std::memory_order_relaxed);
                    });
  mask.bits = bits[light];
  if (transmit) mask.rgb = rgb[light];
  if (request.output == MaskOutput::kCoverage) {
    ResolveCoverage(width, height, &coverage[light]);
    mask.coverage = coverage[light];
  }
  mask.shadowed_samples = shadowed.load();
  mask.faces = face_count;
  for (const Chunk& chunk : chunks) {
    mask.samples += chunk.counts.samples;
    mask.known_samples += chunk.counts.known;
    mask.facing_away_samples += chunk.counts.facing_away;
    mask.outside_cone_samples += chunk.counts.outside_cone;
  }
}

void MaskRenderer::Workspace::ResolveCoverage(size_t width, size_t height, std::vector<uint8_t>* out) const {
  out->resize(width * height);
  const auto row_tiles = static_cast<size_t>(tiles_in_row);
  tbb::parallel_for(tbb::blocked_range<size_t>(0, height, 16), [&](const tbb::blocked_range<size_t>& range) {
    for (size_t y = range.begin(); y != range.end(); ++y) {
      for (size_t x = 0; x < width; ++x) {
        const size_t tile_in_layer = y / kTileHeight * row_tiles + x / kTileWidth;
        const size_t lane = y % kTileHeight * kTileWidth + x % kTileWidth;
        unsigned samples = 0, blocked = 0;
        for (const LayerSource& layer : layers) {
          const size_t tile = layer.first_tile + tile_in_layer;
          samples += static_cast<unsigned>(present[tile] | facing[tile]) >> lane & 1u;
          blocked += static_cast<unsigned>(shadow[tile]) >> lane & 1u;
        }
        const unsigned lit = samples - blocked;
        (*out)[y * width + x] =
            samples == 0 ? uint8_t{255} : static_cast<uint8_t>((510 * lit + samples) / (2 * samples));
      }
    }
  });
}

absl::Status MaskRenderer::Workspace::RenderLight(const MaskRequest& request, size_t light) {
  const absl::StatusOr<RaySpace> ray_space = RaySpace::Create(request.lights[light]);
  if (!ray_space.ok()) {
    return absl::Status(ray_space.status().code(),
                        absl::StrFormat("lights[%d].%s.%s", light, KindName(request.lights[light]),
                                        ray_space.status().message()));
  }
  LightMask& mask = masks[light];
  mask = LightMask{};
  Stopwatch watch;
  for (size_t i = 0; i < layers.size(); ++i) {
    layers[i].known = request.known.empty() ? ImageView<uint8_t>{} : request.known[light * layers.size() + i];
  }

  // 1. Ray coordinates whose third axis looks towards the samples, if they all lie to one side of the light.
  SetUpFrame(*ray_space);
  face_count = 6;
  cells = 0;
  const glm::dvec3 hint = request.camera != nullptr ? ViewDirection(*request.camera) : glm::dvec3(0, 1, 0);
  const auto set_matrices = [&] {
    const double extent =
        std::max({std::abs(frame.ws_origin.x), std::abs(frame.ws_origin.y), std::abs(frame.ws_origin.z)});
    for (size_t i = 0; i < layers.size(); ++i) {
      layers[i].origin_error = static_cast<float>(4.0 * static_cast<double>(kUnitRoundoff) * extent);
      if (layers[i].ws_positions.bottom_row != nullptr) continue;
      SetRayFromPixel(*request.camera, frame, request.layers[i], layers[i].depth.width,
                      layers[i].depth.height, &layers[i]);
    }
  };
  if (frame.directional || frame.has_cone) BasisAround(ray_space->ws_direction(), hint, frame.rotation);
  set_matrices();
  int stride = 2;
  CollectRays(request, &stride);
  if (frame.directional) {
    face_count = 1;
    // Only the exact value of what is subtracted matters: single precision, so that casters lose nothing by
    // it.
    glm::dvec3 sum(0.0);
    for (const glm::vec3& r : rays) sum += glm::dvec3(r);
    const glm::dvec3 centre = sum / std::max(static_cast<double>(rays.size()), 1.0);
    for (int row = 0; row < 3; ++row) {
      const double* axis = frame.rotation[row];
      frame.ws_origin += centre[row] * glm::dvec3(axis[0], axis[1], axis[2]);
    }
    frame.ws_origin = glm::dvec3(glm::vec3(frame.ws_origin));
    if (!std::isfinite(glm::dot(frame.ws_origin, frame.ws_origin))) frame.ws_origin = glm::dvec3(0.0);
    set_matrices();
    CollectRays(request, &stride);
  } else if (frame.has_cone) {
    face_count = frame.cos_outer >= 0.4 ? 1 : 6;
  } else if (const glm::dvec3 axis = SingleFaceAxis(rays); axis != glm::dvec3(0.0) || rays.empty()) {
    face_count = 1;
    BasisAround(rays.empty() ? glm::dvec3(0, 0, 1) : axis, hint, frame.rotation);
    set_matrices();
    for (glm::vec3& r : rays) {
      const glm::dvec3 old(r);
      for (int row = 0; row < 3; ++row) {
        r[row] = static_cast<float>(glm::dot(
            glm::dvec3(frame.rotation[row][0], frame.rotation[row][1], frame.rotation[row][2]), old));
      }
    }
  }
  // Two rays stand for a tile.
  const size_t expected =
      rays.size() * kPacket / 2 * static_cast<size_t>(stride) * static_cast<size_t>(stride);
  PlanFaces(expected);
  if (absl::Status status = CancelledStatus(request.cancellation); !status.ok()) return status;
  mask.milliseconds.plan = watch.Lap();

  // 2. Enter the samples in cells: tile by tile, or one by one where tiles are torn.
  size_t off_face = 0;
  if (absl::Status status = SetUpAllTiles(request, &off_face); !status.ok()) return status;
  if (off_face > 0) {
    // Rare samples that the planning ones did not foresee: all directions, then.
    face_count = 6;
    PlanFaces(expected);
    if (absl::Status status = SetUpAllTiles(request, &off_face); !status.ok()) return status;
  }
  mask.milliseconds.tiles = watch.Lap();
  if (absl::Status status = SortScattered(request); !status.ok()) return status;
  BoundFaces();
  mask.milliseconds.scattered = watch.Lap();
  if (request.method == MaskMethod::kGrid) {
    if (absl::Status status = SortEntries(request); !status.ok()) return status;
  } else if (request.method == MaskMethod::kBsp) {
    if (absl::Status status = BuildBspOrder(request); !status.ok()) return status;
  }
  mask.milliseconds.hierarchy = watch.Lap();

  // 3. Stream the triangles over them.
  Walk(request);
  if (absl::Status status = CancelledStatus(request.cancellation); !status.ok()) return status;
  mask.milliseconds.walk = watch.Lap();

  // 4. Back to pixels.
  Resolve(request, light);
  mask.milliseconds.resolve = watch.Lap();
  return CancelledStatus(request.cancellation);
}

MaskRenderer::MaskRenderer() : workspace_(std::make_unique<Workspace>()) {}
MaskRenderer::~MaskRenderer() = default;
MaskRenderer::MaskRenderer(MaskRenderer&&) noexcept = default;
MaskRenderer& MaskRenderer::operator=(MaskRenderer&&) noexcept = default;

absl::StatusOr<std::span<const LightMask>> MaskRenderer::Render(const MaskRequest& request) {
  if (absl::Status status = CheckRequest(request); !status.ok()) return status;
  Workspace& w = *workspace_;
  w.SetUpLayers(request);
  w.SetUpCasters(request);
  if (absl::Status status = w.PlaceMovedInstances(request); !status.ok()) return status;
  if (!w.packets.Reserve(size_t{w.tiles} * kPacketFloats) || !w.present.Reserve(w.tiles) ||
      !w.facing.Reserve(w.tiles)) {
    return OutOfMemory(w.tiles);
  }
  const int threads = std::max(tbb::this_task_arena::max_concurrency(), 1);
  const int per_layer =
      std::clamp(kChunksPerThread * threads / static_cast<int>(w.layers.size()), 1, w.tile_rows);
  w.chunks.resize(static_cast<size_t>(per_layer) * w.layers.size());  // They keep their memory.
  for (size_t i = 0; i < w.chunks.size(); ++i) {
    Chunk& chunk = w.chunks[i];
    const auto part = static_cast<int64_t>(i % static_cast<size_t>(per_layer));
    chunk.layer = i / static_cast<size_t>(per_layer);
    chunk.row_begin = static_cast<int>(w.tile_rows * part / per_layer);
    chunk.row_end = static_cast<int>(w.tile_rows * (part + 1) / per_layer);
  }
  w.masks.resize(request.lights.size());
  if (w.bits.size() < request.lights.size()) w.bits.resize(request.lights.size());
  if (w.rgb.size() < request.lights.size()) w.rgb.resize(request.lights.size());
  if (w.coverage.size() < request.lights.size()) w.coverage.resize(request.lights.size());
  for (size_t light = 0; light < request.lights.size(); ++light) {
    if (absl::Status status = w.RenderLight(request, light); !status.ok()) return status;
  }
  return std::span<const LightMask>(w.masks);
}

size_t MaskRenderer::MemoryBytes() const {
  const Workspace& w = *workspace_;
  size_t bytes = w.packets.MemoryBytes() + w.present.MemoryBytes() + w.facing.MemoryBytes() +
                 w.place.MemoryBytes() + w.rank.MemoryBytes() + w.sorted_packets.MemoryBytes() +
                 w.bsp_packets.MemoryBytes() + w.shadow.MemoryBytes() + w.touched.MemoryBytes() +
                 w.touched_twice.MemoryBytes() + w.absorbance.MemoryBytes() + w.packet_lock.MemoryBytes() +
                 w.entry_floats.MemoryBytes() + w.entry_packet.MemoryBytes() +
                 w.sorted_entries.MemoryBytes() + w.histograms.MemoryBytes() +
                 w.sort_histograms.MemoryBytes() + w.row_reaches.MemoryBytes() + w.cell_start.MemoryBytes();
  for (const Chunk& chunk : w.chunks) {
    bytes += chunk.entries.capacity() * sizeof(PacketEntry) + chunk.scattered.capacity() * sizeof(uint32_t);
  }
  for (const auto& mask : w.bits) bytes += mask.capacity();
  for (const auto& mask : w.rgb) bytes += mask.capacity();
  for (const auto& mask : w.coverage) bytes += mask.capacity();
  bytes += w.moved_blocks.MemoryBytes() + w.moved_clusters.capacity() * sizeof(MaskScene::Cluster);
  return bytes;
}

std::vector<uint8_t> KnownAwayFromEdges(std::span<const uint8_t> in_shadow, int width, int height,
                                        int radius) {
  const auto w = static_cast<size_t>(width), h = static_cast<size_t>(height), r = static_cast<size_t>(radius);
  // Separable: the least and the greatest answer within the radius along rows, then along columns.
  std::vector<uint8_t> seen(w * h);  // Bit 0: lit within reach; bit 1: in shadow.
  for (size_t y = 0; y < h; ++y) {
    for (size_t x = 0; x < w; ++x) {
      uint8_t bits = 0;
      const size_t end = std::min(w, x + r + 1);
      for (size_t i = x > r ? x - r : 0; i < end && bits != 3; ++i) bits |= in_shadow[y * w + i] != 0 ? 2 : 1;
      seen[y * w + x] = bits;
    }
  }
  std::vector<uint8_t> known(w * h);
  for (size_t y = 0; y < h; ++y) {
    const size_t first = y > r ? y - r : 0, end = std::min(h, y + r + 1);
    for (size_t i = first; i < end; ++i) {
      for (size_t x = 0; x < w; ++x) known[y * w + x] |= seen[i * w + x];
    }
    for (size_t x = 0; x < w; ++x) {
      uint8_t& value = known[y * w + x];
      if (value == 3) value = static_cast<uint8_t>(KnownShadow::kUnknown);
    }
  }
  return known;
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
