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
constexpr double kPlanningSamples = 12000.0;
constexpr size_t kMostDeferred = 256;
constexpr int kDeferredRows = 8;
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

struct Chunk {
  size_t layer;
  int row_begin, row_end;
  BinCounts counts;
};

}  // namespace

struct MaskRenderer::Workspace {
  // Per pixel of all layers, rows padded to kPacket.
  AlignedBuffer<uint32_t> place;  ///< First the cell, then the place among the sorted samples.
  AlignedBuffer<uint32_t> rank;
  // Per sample, in sorted order.
  AlignedBuffer<float> packets;
  AlignedBuffer<float> bsp_packets;
  AlignedBuffer<PacketBounds> packet_bounds;
  AlignedBuffer<uint16_t> shadow, touched, touched_twice;
  AlignedBuffer<uint32_t> absorbance;
  AlignedBuffer<uint8_t> packet_lock;
  // Per cell and chunk.
  AlignedBuffer<uint32_t> histograms;
  AlignedBuffer<uint32_t> cell_start;
  std::vector<uint32_t> row_packets;

  std::vector<glm::vec3> rays;
  std::vector<glm::vec2> uv;
  std::array<Face, 6> faces;
  std::vector<LayerSource> layers;
  std::vector<Chunk> chunks;
  std::vector<Caster> casters;
  std::vector<FaceBounds> face_bounds;
  tbb::enumerable_thread_specific<std::vector<DeferredTriangle>> deferred;
  std::vector<const DeferredTriangle*> all_deferred;
  std::array<std::vector<BspNode>, 6> bsp;
  std::vector<glm::vec3> bsp_uvw;
  std::vector<uint32_t> bsp_order;
  std::vector<uint32_t> bsp_place;

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
  size_t padded_width = 0;
  size_t pixels = 0;
  uint32_t cells = 0;
  uint32_t end_packet = 0;

  absl::Status RenderLight(const MaskRequest& request, size_t light);
  void SetUpFrame(const RaySpace& ray_space);
  void SetUpLayers(const MaskRequest& request);
  SampleTask TaskFor(const Chunk& chunk, const Cancellation* cancellation) const;
  void CollectRays(const Cancellation* cancellation, int* stride);
  void PlanFaces(size_t expected_samples);
  absl::Status BinAll(const Cancellation* cancellation, size_t* off_face);
  absl::Status ReserveSamples(const MaskRequest& request);
  void PlaceAll(const Cancellation* cancellation);
  absl::Status BuildBspOrder(const Cancellation* cancellation);
  void SetUpCasters(const MaskRequest& request);
  absl::Status PlaceMovedInstances(const MaskRequest& request);
  void BoundFaces();
  void Walk(const MaskRequest& request);
  void Resolve(const MaskRequest& request, size_t light);
  void ResolveCoverage(size_t width, size_t height, std::vector<uint8_t>* out) const;
};

namespace {

absl::Status OutOfMemory(size_t pixels) {
  return absl::ResourceExhaustedError(absl::StrFormat("layers: no memory for %d samples", pixels));
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
  const size_t padded = (static_cast<size_t>(width) + kPacket - 1) / kPacket * kPacket;
  if (padded * static_cast<size_t>(height) * request.layers.size() > MaskRenderer::kMaxPixels) {
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
  padded_width = (static_cast<size_t>(width) + kPacket - 1) / kPacket * kPacket;
  pixels = padded_width * static_cast<size_t>(height) * request.layers.size();
  for (size_t i = 0; i < layers.size(); ++i) {
    LayerSource& source = layers[i];
    const ReceiverLayer& layer = request.layers[i];
    source = LayerSource{};
    source.depth = layer.depth;
    source.ws_positions = layer.ws_positions;
    source.ws_normals = layer.ws_normals;
    source.first_pixel = i * padded_width * static_cast<size_t>(height);
    if (layer.ws_positions.bottom_row != nullptr) {
      source.depth.width = width;
      source.depth.height = height;
    } else {
      source.background = static_cast<float>(BackgroundWindowDepth(request.camera->clip_depth()));
    }
    // Three roundings of the projection beside the format's own.
    source.depth_relative_error = 3.0f * kUnitRoundoff;
    switch (request.depth_format) {
      case DepthFormat::kFloat32:
        source.depth_relative_error += kUnitRoundoff;
        break;
      case DepthFormat::kUnorm24:
        source.depth_absolute_error = 0.5f / 16777215.0f;
        break;
      case DepthFormat::kUnorm16:
        source.depth_absolute_error = 0.5f / 65535.0f;
        break;
      case DepthFormat::kFloat16:
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

SampleTask MaskRenderer::Workspace::TaskFor(const Chunk& chunk, const Cancellation* cancellation) const {
  SampleTask task;
  task.frame = &frame;
  task.layer = &layers[chunk.layer];
  task.faces = faces.data();
  task.single_face = face_count == 1;
  task.marks = {cells, cells + 1};
  task.padded_width = padded_width;
  task.row_begin = chunk.row_begin;
  task.row_end = chunk.row_end;
  task.cancellation = cancellation;
  return task;
}

void MaskRenderer::Workspace::CollectRays(const Cancellation* cancellation, int* stride) {
  *stride = std::max(2, static_cast<int>(std::sqrt(2.0 * static_cast<double>(pixels) / kPlanningSamples)));
  rays.clear();
  for (size_t layer = 0; layer < layers.size(); ++layer) {
    if (cancellation != nullptr && cancellation->Requested()) return;
    SampleRays(TaskFor({layer, 0, layers[layer].depth.height, {}}, cancellation), *stride, &rays);
  }
}

void MaskRenderer::Workspace::PlanFaces(size_t expected_samples) {
  cells = 0;
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
    cells += static_cast<uint32_t>(face.rows * face.columns * kSubrows);
  }
}

absl::Status MaskRenderer::Workspace::BinAll(const Cancellation* cancellation, size_t* off_face) {
  const size_t stride = size_t{cells} + 2;
  if (!histograms.Reserve(stride * chunks.size())) return OutOfMemory(pixels);
  ForEach(chunks.size(), cancellation, [&](size_t i) {
    uint32_t* histogram = histograms.data() + i * stride;
    std::memset(histogram, 0, stride * sizeof(uint32_t));
    chunks[i].counts = BinCounts{};
    BinSamples(TaskFor(chunks[i], cancellation), place.data(), rank.data(), histogram, &chunks[i].counts);
  });
  *off_face = 0;
  if (absl::Status status = CancelledStatus(cancellation); !status.ok()) return status;
  for (const Chunk& chunk : chunks) *off_face += chunk.counts.off_face;
  return absl::OkStatus();
}

absl::Status MaskRenderer::Workspace::ReserveSamples(const MaskRequest& request) {
  // Rows of cells start at packet borders, so that no packet belongs to two rows. Three packets follow: one
  // that is lit, one in shadow, and one that takes what must be written somewhere.
  const size_t stride = size_t{cells} + 2;
  size_t rows = 0;
  for (int f = 0; f < face_count; ++f) rows += static_cast<size_t>(faces[static_cast<size_t>(f)].rows);
  row_packets.assign(rows + 1, 0);
  size_t row_base = 0;
  for (int f = 0; f < face_count; ++f) {
    const Face& face = faces[static_cast<size_t>(f)];
    tbb::parallel_for(tbb::blocked_range<int>(0, face.rows, 16), [&](const tbb::blocked_range<int>& range) {
      for (int row = range.begin(); row != range.end(); ++row) {
        const size_t row_cells = static_cast<size_t>(face.columns) * kSubrows;
        const size_t first = face.first_cell + static_cast<size_t>(row) * row_cells;
        uint32_t samples = 0;
        for (size_t chunk = 0; chunk < chunks.size(); ++chunk) {
          const uint32_t* counts = histograms.data() + chunk * stride + first;
          for (size_t cell = 0; cell < row_cells; ++cell) samples += counts[cell];
        }
        row_packets[row_base + static_cast<size_t>(row)] = (samples + kPacket - 1) / kPacket;
      }
    });
    row_base += static_cast<size_t>(face.rows);
  }
  uint32_t packet = 0;
  row_base = 0;
  for (int f = 0; f < face_count; ++f) {
    Face& face = faces[static_cast<size_t>(f)];
    face.first_packet = packet;
    for (int row = 0; row < face.rows; ++row) {
      uint32_t& entry = row_packets[row_base + static_cast<size_t>(row)];
      packet += entry;
      entry = packet - entry;
    }
    row_base += static_cast<size_t>(face.rows);
    face.end_packet = packet;
  }
  row_packets[rows] = packet;
  end_packet = packet;

  const size_t all = size_t{end_packet} + 4;
  const bool reserved = packets.Reserve(all * kPacketFloats) && packet_bounds.Reserve(all) &&
                        shadow.Reserve(all) && touched.Reserve(all) && touched_twice.Reserve(all) &&
                        cell_start.Reserve(size_t{cells} + 1) &&
                        (request.output != MaskOutput::kTransmittance ||
                         (absorbance.Reserve(all * 3 * kPacket) && packet_lock.Reserve(all)));
  return reserved ? absl::OkStatus() : OutOfMemory(pixels);
}

void MaskRenderer::Workspace::PlaceAll(const Cancellation* cancellation) {
  const size_t stride = size_t{cells} + 2;
  const size_t all = size_t{end_packet} + 4;
  std::memset(shadow.data(), 0, all * sizeof(uint16_t));
  std::memset(touched.data(), 0, all * sizeof(uint16_t));
  std::memset(touched_twice.data(), 0, all * sizeof(uint16_t));
  size_t row_base = 0;
  for (int f = 0; f < face_count; ++f) {
    const Face& face = faces[static_cast<size_t>(f)];
    tbb::parallel_for(tbb::blocked_range<int>(0, face.rows, 16), [&](const tbb::blocked_range<int>& range) {
      for (int row = range.begin(); row != range.end(); ++row) {
        const size_t row_cells = static_cast<size_t>(face.columns) * kSubrows;
        const size_t first = face.first_cell + static_cast<size_t>(row) * row_cells;
        uint32_t at = row_packets[row_base + static_cast<size_t>(row)] * kPacket;
        for (size_t cell = first; cell < first + row_cells; ++cell) {
          cell_start[cell] = at;
          for (size_t chunk = 0; chunk < chunks.size(); ++chunk) {
            uint32_t& count = histograms[chunk * stride + cell];
            const uint32_t samples = count;
            count = at;
            at += samples;
          }
        }
        // What is left of the row's last packet is no sample: NaN fails every test, and counts as decided.
        if (at % kPacket != 0) {
          const uint32_t packet = at / kPacket;
          std::fill_n(packets.data() + size_t{packet} * kPacketFloats, kPacketFloats,
                      std::numeric_limits<float>::quiet_NaN());
          shadow[packet] = static_cast<uint16_t>(0xFFFFu << (at % kPacket));
        }
      }
    });
    row_base += static_cast<size_t>(face.rows);
  }
  cell_start[cells] = end_packet * kPacket;
  shadow[end_packet + 1] = 0xFFFF;
  const CellMarks mark_places{end_packet * kPacket, (end_packet + 1) * kPacket};
  ForEach(chunks.size(), cancellation, [&](size_t i) {
    PlaceSamples(TaskFor(chunks[i], cancellation), histograms.data() + i * stride, rank.data(), mark_places,
                 (end_packet + 2) * kPacket, place.data(), packets.data());
  });
}

absl::Status MaskRenderer::Workspace::BuildBspOrder(const Cancellation* cancellation) {
  // Samples are already together; each face's are put into the tree's order. Leaves start at packet borders.
  const size_t old_samples = size_t{end_packet} * kPacket;
  bsp_place.assign(old_samples, 0);
  std::array<uint32_t, 6> first_packet{}, last_packet{};
  uint32_t packet = 0;
  for (int f = 0; f < face_count; ++f) {
    const auto index = static_cast<size_t>(f);
    const Face& face = faces[index];
    const size_t first = size_t{face.first_packet} * kPacket;
    const size_t end = size_t{face.end_packet} * kPacket;
    bsp_uvw.assign(end - first, glm::vec3(0.0f));
    bsp_order.clear();
    for (size_t i = 0; i < end - first; ++i) {
      const float* values = packets.data() + (first + i) / kPacket * kPacketFloats + (first + i) % kPacket;
      const glm::vec3 r(values[0], values[kPacket], values[2 * kPacket]);
      if (std::isnan(r.x)) continue;
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
      node.first_sample = packet * kPacket;
      node.end_sample = node.first_sample + count;
      packet += (count + kPacket - 1) / kPacket;
    }
    last_packet[index] = packet;
  }
  const size_t all = size_t{packet} + 4;
  // Grown here, and with them what the walk writes.
  if (!bsp_packets.Reserve(all * kPacketFloats) || !packet_bounds.Reserve(all) || !shadow.Reserve(all) ||
      !touched.Reserve(all) || !touched_twice.Reserve(all) ||
      (absorbance.capacity() != 0 && (!absorbance.Reserve(all * 3 * kPacket) || !packet_lock.Reserve(all)))) {
    return OutOfMemory(pixels);
  }
  std::fill_n(bsp_packets.data(), all * kPacketFloats, std::numeric_limits<float>::quiet_NaN());
  std::fill_n(shadow.data(), all, uint16_t{0xFFFF});
  std::fill_n(touched.data(), all, uint16_t{0});
  std::fill_n(touched_twice.data(), all, uint16_t{0});
  for (int f = 0; f < face_count; ++f) {
    Face& face = faces[static_cast<size_t>(f)];
    for (size_t i = size_t{face.first_packet} * kPacket; i < size_t{face.end_packet} * kPacket; ++i) {
      const float* from = packets.data() + i / kPacket * kPacketFloats + i % kPacket;
      if (std::isnan(from[0])) continue;
      const uint32_t to = bsp_place[i];
      for (int row = 0; row < 4; ++row) {
        bsp_packets[to / kPacket * kPacketFloats + static_cast<size_t>(row) * kPacket + to % kPacket] =
            from[row * kPacket];
      }
      shadow[to / kPacket] = static_cast<uint16_t>(shadow[to / kPacket] & ~(1u << (to % kPacket)));
    }
    face.first_packet = first_packet[static_cast<size_t>(f)];
    face.end_packet = last_packet[static_cast<size_t>(f)];
  }
  const uint32_t lit = end_packet * kPacket;
  for (size_t i = 0; i < pixels; ++i) {
    place[i] = place[i] < lit ? bsp_place[place[i]] : place[i] - lit + packet * kPacket;
  }
  shadow[packet] = 0;
  shadow[packet + 1] = 0xFFFF;
  end_packet = packet;
  std::swap(packets, bsp_packets);
  return absl::OkStatus();
}

void MaskRenderer::Workspace::SetUpCasters(const MaskRequest& request) {
  const std::vector<Material>& materials = request.scene->materials();
  casters.resize(materials.size());
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
                         moved_blocks.data() + blocks * kBlockFloats);
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
    if (face.first_packet == face.end_packet) continue;
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

void MaskRenderer::Workspace::Walk(const MaskRequest& request) {
  MaskState state;
  state.frame = &frame;
  state.faces = faces.data();
  state.face_count = face_count;
  state.search = request.method == MaskMethod::kBsp          ? Search::kBsp
                 : request.method == MaskMethod::kExhaustive ? Search::kExhaustive
                                                             : Search::kGrid;
  state.cell_start = cell_start.data();
  state.bsp = bsp.data();
  state.packets = packets.data();
  state.bounds = packet_bounds.data();
  state.shadow = shadow.data();
  state.touched = touched.data();
  state.touched_twice = touched_twice.data();
  if (request.output == MaskOutput::kTransmittance) {
    state.absorbance = absorbance.data();
    state.packet_lock = packet_lock.data();
    tbb::parallel_for(tbb::blocked_range<uint32_t>(0, end_packet + 2, 4096),
                      [&](const tbb::blocked_range<uint32_t>& range) {
                        std::memset(absorbance.data() + size_t{range.begin()} * 3 * kPacket, 0,
                                    range.size() * 3 * kPacket * sizeof(uint32_t));
                        std::memset(packet_lock.data() + range.begin(), 0, range.size());
                      });
  }
  for (int f = 0; f < face_count; ++f) {
    const Face& face = faces[static_cast<size_t>(f)];
    tbb::parallel_for(tbb::blocked_range<uint32_t>(face.first_packet, face.end_packet, 4096),
                      [&](const tbb::blocked_range<uint32_t>& range) {
                        BoundPackets(face, frame.directional, range.begin(), range.end(), packets.data(),
                                     packet_bounds.data());
                      });
  }
  for (auto& list : deferred) list.clear();

  const std::vector<MaskScene::Cluster>& clusters = request.scene->clusters();
  const bool exhaustive = request.method == MaskMethod::kExhaustive;
  const auto walk_cluster = [&](const MaskScene::Cluster& cluster, const float* geometry,
                                std::vector<DeferredTriangle>* list) {
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
    WalkTriangles(state, blocks, list);
  };
  const size_t grain = std::clamp(clusters.size() / 64, size_t{1}, kMostClustersPerTask);
  ForEach((clusters.size() + grain - 1) / grain, request.cancellation, [&](size_t task) {
    std::vector<DeferredTriangle>& list = deferred.local();
    list.reserve(kMostDeferred);
    std::vector<DeferredTriangle>* const deferred_to = request.method == MaskMethod::kGrid ? &list : nullptr;
    const size_t end = std::min(clusters.size(), (task + 1) * grain);
    auto range = std::upper_bound(moved_ranges.begin(), moved_ranges.end(), task * grain,
                                  [](size_t at, const MovedRange& r) { return at < r.end; });
    for (size_t c = task * grain; c < end; ++c) {
      while (range != moved_ranges.end() && c >= range->end) ++range;
      if (range != moved_ranges.end() && c >= range->first) {
        walk_cluster(moved_clusters[range->first_moved + c - range->first], moved_blocks.data(), deferred_to);
      } else {
        walk_cluster(clusters[c], request.scene->geometry(), deferred_to);
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
              const int first = static_cast<int>(band) * kDeferredRows;
              for (const DeferredTriangle* triangle : all_deferred) {
                if (triangle->face == f) {
                  WalkDeferred(state, *triangle, first, std::min(rows, first + kDeferredRows));
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

void MaskRenderer::Workspace::Resolve(const MaskRequest& request, size_t light) {
  LightMask& mask = masks[light];
  const size_t height = static_cast<size_t>(layers[0].depth.height);
  const size_t width = static_cast<size_t>(layers[0].depth.width);
  const size_t rows = height * layers.size();
  mask.bytes_per_row = padded_width / 8;
  bits[light].resize(rows * mask.bytes_per_row);
  if (request.output == MaskOutput::kTransmittance) rgb[light].resize(rows * width * 3);
  tbb::parallel_for(tbb::blocked_range<uint32_t>(0, end_packet, 8192),
                    [&](const tbb::blocked_range<uint32_t>& range) {
                      for (uint32_t p = range.begin(); p != range.end(); ++p) {
                        touched_twice[p] = static_cast<uint16_t>(touched_twice[p] & ~shadow[p]);
                      }
                    });
  for (uint32_t p = 0; p < end_packet; ++p) {
    mask.undecided_samples += static_cast<size_t>(std::popcount(touched_twice[p]));
  }
  static const AbsorbanceTable table;
  std::atomic<size_t> shadowed{0};
  tbb::parallel_for(tbb::blocked_range<size_t>(0, rows, 16), [&](const tbb::blocked_range<size_t>& range) {
    size_t count = 0;
    for (size_t row = range.begin(); row != range.end(); ++row) {
      const uint32_t* places = place.data() + row * padded_width;
      uint8_t* row_bits = bits[light].data() + row * mask.bytes_per_row;
      count += PackBits(places, padded_width, shadow.data(), row_bits);
      if (request.output != MaskOutput::kTransmittance) continue;
      uint8_t* out = rgb[light].data() + row * width * 3;
      for (size_t x = 0; x < width; ++x) {
        const uint32_t p = places[x];
        const bool blocked = (shadow[p / kPacket] >> (p % kPacket) & 1) != 0;
        const uint32_t* sums = absorbance.data() + p / kPacket * 3 * kPacket + p % kPacket;
        for (size_t channel = 0; channel < 3; ++channel) {
          out[3 * x + channel] = blocked ? 0 : table.Value(sums[channel * kPacket]);
        }
      }
    }
    shadowed.fetch_add(count, std::memory_order_relaxed);
  });
  mask.bits = bits[light];
  if (request.output == MaskOutput::kTransmittance) mask.rgb = rgb[light];
  if (request.output == MaskOutput::kCoverage) {
    ResolveCoverage(width, height, &coverage[light]);
    mask.coverage = coverage[light];
  }
  mask.shadowed_samples = shadowed.load();
  mask.faces = face_count;
  for (const Chunk& chunk : chunks) {
    mask.samples += chunk.counts.samples;
    mask.facing_away_samples += chunk.counts.facing_away;
    mask.outside_cone_samples += chunk.counts.outside_cone;
  }
}

void MaskRenderer::Workspace::ResolveCoverage(size_t width, size_t height, std::vector<uint8_t>* out) const {
  out->resize(width * height);
  const uint32_t lit_mark = end_packet * kPacket;  // Background and what is outside the cone.
  tbb::parallel_for(tbb::blocked_range<size_t>(0, height, 16), [&](const tbb::blocked_range<size_t>& range) {
    for (size_t y = range.begin(); y != range.end(); ++y) {
      for (size_t x = 0; x < width; ++x) {
        unsigned samples = 0, blocked = 0;
        for (const LayerSource& layer : layers) {
          const uint32_t p = place[layer.first_pixel + y * padded_width + x];
          samples += p != lit_mark;
          blocked += shadow[p / kPacket] >> (p % kPacket) & 1u;
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
                        absl::StrFormat("lights[%d].%s", light, ray_space.status().message()));
  }
  LightMask& mask = masks[light];
  mask = LightMask{};
  Stopwatch watch;

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
  CollectRays(request.cancellation, &stride);
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
    CollectRays(request.cancellation, &stride);
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
  const size_t expected =
      rays.size() * static_cast<size_t>(stride) * static_cast<size_t>(std::max(stride / 2, 1));
  PlanFaces(expected);
  if (absl::Status status = CancelledStatus(request.cancellation); !status.ok()) return status;
  mask.milliseconds.plan = watch.Lap();

  // 2. Sort the samples into cells.
  size_t off_face = 0;
  if (absl::Status status = BinAll(request.cancellation, &off_face); !status.ok()) return status;
  if (off_face > 0) {
    // Rare samples that the planning ones did not foresee: all directions, then.
    face_count = 6;
    PlanFaces(expected);
    if (absl::Status status = BinAll(request.cancellation, &off_face); !status.ok()) return status;
  }
  if (absl::Status status = ReserveSamples(request); !status.ok()) return status;
  mask.milliseconds.bin = watch.Lap();
  PlaceAll(request.cancellation);
  if (absl::Status status = CancelledStatus(request.cancellation); !status.ok()) return status;
  mask.milliseconds.place = watch.Lap();
  if (request.method == MaskMethod::kBsp) {
    if (absl::Status status = BuildBspOrder(request.cancellation); !status.ok()) return status;
    mask.milliseconds.hierarchy = watch.Lap();
  }

  // 3. Stream the triangles over them.
  BoundFaces();
  Walk(request);
  if (absl::Status status = CancelledStatus(request.cancellation); !status.ok()) return status;
  mask.milliseconds.walk = watch.Lap();

  // 4. Back to pixels.
  Resolve(request, light);
  mask.milliseconds.resolve = watch.Lap();
  return absl::OkStatus();
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
  if (!w.place.Reserve(w.pixels) || !w.rank.Reserve(w.pixels)) return OutOfMemory(w.pixels);
  w.chunks.clear();
  const int threads = std::max(tbb::this_task_arena::max_concurrency(), 1);
  const int height = w.layers[0].depth.height;
  const int per_layer =
      std::clamp(threads / static_cast<int>(std::min<size_t>(w.layers.size(), 1024)), 1, height);
  for (size_t layer = 0; layer < w.layers.size(); ++layer) {
    for (int i = 0; i < per_layer; ++i) {
      w.chunks.push_back({layer,
                          static_cast<int>(int64_t{height} * i / per_layer),
                          static_cast<int>(int64_t{height} * (i + 1) / per_layer),
                          {}});
    }
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
  size_t bytes = w.place.MemoryBytes() + w.rank.MemoryBytes() + w.packets.MemoryBytes() +
                 w.bsp_packets.MemoryBytes() + w.packet_bounds.MemoryBytes() + w.shadow.MemoryBytes() +
                 w.touched.MemoryBytes() + w.touched_twice.MemoryBytes() + w.absorbance.MemoryBytes() +
                 w.packet_lock.MemoryBytes() + w.histograms.MemoryBytes() + w.cell_start.MemoryBytes();
  for (const auto& mask : w.bits) bytes += mask.capacity();
  for (const auto& mask : w.rgb) bytes += mask.capacity();
  for (const auto& mask : w.coverage) bytes += mask.capacity();
  bytes += w.moved_blocks.MemoryBytes() + w.moved_clusters.capacity() * sizeof(MaskScene::Cluster);
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
