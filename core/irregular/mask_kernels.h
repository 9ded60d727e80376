#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <limits>
#include <vector>

#include "core/cancellation.h"
#include "core/frame/images.h"
#include "core/scene/scene.h"

/// The inner loops of the alias-free masks, compiled for several instruction sets. What they compute is
/// described in shadow_masks.h; this header is the boundary between plain C++ and SIMD code and no part of
/// the public interface.
namespace shadowfit::irregular {

/// Samples are tested in packets of this many, on every instruction set, so that results do not depend on it.
inline constexpr int kPacket = 16;
/// Triangles are stored and transformed in blocks: nine rows (a.x a.y a.z b.x .. c.z) of this many floats.
inline constexpr int kBlock = 16;
inline constexpr int kBlockFloats = 9 * kBlock;
/// A packet's floats: r.x, r.y, r.z and the error bound, kPacket of each.
inline constexpr int kPacketFloats = 4 * kPacket;
/// The v axis of a face is cut into this many equal bins, which the layout gathers into rows.
inline constexpr int kRowBins = 4096;
/// Each row of cells is divided into this many, so that packets of a crowded place are no taller than they
/// are wide.
inline constexpr int kSubrows = 4;

/// Half an ulp of 1 in single precision.
inline constexpr float kUnitRoundoff = 0x1p-24f;

/// Coordinates in which one light's samples and casters are compared: r = rotation (X - ws_origin). The
/// origin is the light, or for a directional light, whose rays run along r.z, a point amid the samples.
struct LightFrame {
  bool directional = false;
  glm::dvec3 ws_origin{0.0};
  double rotation[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};  ///< Rows.
  bool has_cone = false;                                      ///< A spot's cone around +r.z.
  double cos_outer = -1.0;
};

/// Homogeneous ray coordinates of a pixel: (r W, W) = base + x col_x + y col_y + window_depth col_z.
struct RayFromPixel {
  double base[4];
  double col_x[4];
  double col_y[4];
  double col_z[4];
};

/// One layer of receivers, as the kernels read it.
struct LayerSource {
  DepthView depth;
  ImageView<glm::vec3> ws_positions;  ///< Used instead of depth where its pointer is not null.
  ImageView<glm::vec3> ws_normals;    ///< May be null.
  RayFromPixel ray_from_pixel;
  float background = 1.0f;            ///< Window depth that means nothing was drawn.
  float depth_absolute_error = 0.0f;  ///< Of window depth.
  float depth_relative_error = 0.0f;  ///< Of window depth.
  float origin_error = 0.0f;          ///< World units, from the rounding of coordinates around the origin.
  size_t first_pixel = 0;             ///< Of this layer in the per-pixel arrays, whose rows are padded.
};

/// A side of the cube around a point light, or the one plane that holds all samples. In it a sample has plane
/// coordinates u = x/w, v = y/w, with (x, y, w) its ray coordinates permuted so that w points out of the
/// face. (Directional: u = x, v = y.) Rows are intervals of v that hold about equally many samples; each is
/// cut into `columns` equal cells of its own range of u. Samples are stored cell after cell, so that a run of
/// cells of one row is a run of samples.
struct Face {
  int axis = 2;
  float sign = 1.0f;
  float v_origin = 0.0f, v_scale = 0.0f;
  int rows = 0, columns = 0;
  uint32_t first_cell = 0;
  std::vector<int32_t> row_of_bin;                   ///< Row * kSubrows + subrow of each of kRowBins
  std::vector<float> row_v_low, row_v_high;          ///< Padded for rounding; rows + kPacket values.
  std::vector<float> row_u_origin, row_u_scale;      ///< rows + kPacket values.
  float u_min = 0, u_max = 0, v_min = 0, v_max = 0;  ///< Of all samples.
  float farthest = 0;                                ///< Largest w (directional: r.z) of all samples.
  uint32_t first_packet = 0, end_packet = 0;
};

/// Per-pixel cells beyond the faces' own mark pixels that need no test.
struct CellMarks {
  uint32_t lit;
  uint32_t shadowed;
};

struct BinCounts {
  size_t samples = 0;  ///< Pixels with a sample, in this light's reach or not.
  size_t facing_away = 0;
  size_t outside_cone = 0;
  size_t off_face = 0;  ///< Samples that the single face cannot hold.
  float u_min[6], u_max[6], v_min[6], v_max[6], farthest[6];
};

struct SampleTask {
  const LightFrame* frame = nullptr;
  const LayerSource* layer = nullptr;
  const Face* faces = nullptr;  ///< Six, or one (see single_face).
  bool single_face = true;
  CellMarks marks{};
  size_t padded_width = 0;  ///< Of per-pixel arrays; a multiple of kPacket.
  int row_begin = 0, row_end = 0;
  const Cancellation* cancellation = nullptr;  ///< Once it asks, the rest of the rows is left out.
};

/// What is known of a packet before its samples are looked at.
struct alignas(32) PacketBounds {
  float u_min, v_min, minus_u_max, minus_v_max;
  float farthest;  ///< Largest w (directional: r.z); -infinity once all of it is in shadow.
};

/// A node of the paper's BSP over the samples of one face.
struct BspNode {
  float u_min, u_max, v_min, v_max, farthest;
  uint32_t first_sample, end_sample;
  int32_t right = -1;  ///< Left child follows its parent; -1 marks a leaf.
};

/// How a triangle stops light.
struct Caster {
  const AlphaTexture* alpha = nullptr;  ///< Hole where AlphaAt < cutoff.
  uint8_t alpha_cutoff = 0;
  bool casts = true;  ///< False: lets all light through.
  bool transmits = false;
  uint32_t absorbance[3] = {0, 0, 0};  ///< -log2 of transmittance, in units of 1/kAbsorbanceOne.
};
inline constexpr uint32_t kAbsorbanceOne = 1u << 16;
/// Beyond 2^-20 of the light nothing is left; sums stay below this plus one caster's share, and cannot wrap.
inline constexpr uint32_t kAbsorbanceMax = 20u << 16;

enum class Search { kGrid, kBsp, kExhaustive };

/// A triangle that covers so many packets that the threads share them.
struct DeferredTriangle {
  float values[32];
  float u[8], v[8];
  int corners = 0;
  int face = 0;
  float pad_u = 0, pad_v = 0;
  bool sliver = false;
  const Caster* caster = nullptr;
  const float* uv = nullptr;
  int lane = 0;
};

/// Everything a triangle is tested against. Writes go through atomics and commute, so that neither order nor
/// thread count changes the outcome.
struct MaskState {
  const LightFrame* frame = nullptr;
  const Face* faces = nullptr;
  int face_count = 1;
  Search search = Search::kGrid;
  const uint32_t* cell_start = nullptr;
  const std::vector<BspNode>* bsp = nullptr;  ///< One tree a face.
  const float* packets = nullptr;
  PacketBounds* bounds = nullptr;
  uint16_t* shadow = nullptr;         ///< Bit per sample: a caster certainly blocks it.
  uint16_t* touched = nullptr;        ///< Bit per sample: it lies on a caster, within the error bound.
  uint16_t* touched_twice = nullptr;  ///< Bit per sample: on two.
  uint32_t* absorbance = nullptr;     ///< [packet][3][kPacket], or null where only bits are asked for.
  uint8_t* packet_lock = nullptr;     ///< Guards a packet's absorbance.
};

struct CasterBlocks {
  const float* geometry = nullptr;  ///< count * kBlockFloats
  const float* uvs = nullptr;       ///< count * 6 * kBlock, or null
  size_t count = 0;
  const Caster* caster = nullptr;
};

/// Ray coordinates of every `stride`-th strip of every `stride`-th row, for planning a layout.
void SampleRays(const SampleTask& task, int stride, std::vector<glm::vec3>* rays);

/// Writes each pixel's cell and its rank among the pixels of that cell and task; counts cells in `histogram`.
void BinSamples(const SampleTask& task, uint32_t* cell, uint32_t* rank, uint32_t* histogram,
                BinCounts* counts);

/// Writes samples into packets and replaces each pixel's cell by its place. `start` is where this task's
/// samples of each cell go; marked pixels get the places in `marks`.
void PlaceSamples(const SampleTask& task, const uint32_t* start, const uint32_t* rank,
                  const CellMarks& mark_places, uint32_t scrap_place, uint32_t* cell_to_place,
                  float* packets);

/// Bounds of packets [begin, end) of a face.
void BoundPackets(const Face& face, bool directional, uint32_t begin, uint32_t end, const float* packets,
                  PacketBounds* bounds);

/// Tests blocks of triangles. Triangles that cover very many packets are appended to `deferred` instead, up
/// to its capacity.
void WalkTriangles(const MaskState& state, const CasterBlocks& blocks,
                   std::vector<DeferredTriangle>* deferred);

/// Tests a deferred triangle in rows [row_begin, row_end) of its face.
void WalkDeferred(const MaskState& state, const DeferredTriangle& triangle, int row_begin, int row_end);

/// Packs one row of pixels: bit x % 8 of byte x / 8 is the pixel's bit of `bits` (one a sample). Writes
/// padded_width / 8 bytes. Returns how many are set.
size_t PackBits(const uint32_t* place, size_t padded_width, const uint16_t* bits, uint8_t* row);

}  // namespace shadowfit::irregular
