#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <limits>
#include <span>
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
/// A packet is a tile of so many pixels, where the light sees these close together.
inline constexpr int kTileWidth = 4;
inline constexpr int kTileHeight = 4;
static_assert(kTileWidth * kTileHeight == kPacket && kPacket % kTileWidth == 0);
/// Close together means: in no more rows of cells than this ...
inline constexpr int kMostRowsOfPacket = 3;
/// ... and not wider than so many cells.
inline constexpr int kMostColumnsOfPacket = 5;
/// A tile may show so many surfaces that lie apart; where there are more, its samples are sorted one by one.
inline constexpr int kMostSurfacesOfTile = 3;
inline constexpr int kMostEntriesOfTile = kMostSurfacesOfTile * kMostRowsOfPacket;
/// The v axis of a face is cut into this many equal bins, which the layout gathers into rows.
inline constexpr int kRowBins = 4096;
/// Each row of cells is divided into this many, so that packets of a crowded place are no taller than they
/// are wide.
inline constexpr int kSubrows = 1;

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
  ImageView<uint8_t> known;           ///< KnownShadow of each pixel; may be null.
  RayFromPixel ray_from_pixel;
  float background = 1.0f;            ///< Window depth that means nothing was drawn.
  float depth_absolute_error = 0.0f;  ///< Of window depth.
  float depth_relative_error = 0.0f;  ///< Of window depth.
  float origin_error = 0.0f;          ///< World units, from the rounding of coordinates around the origin.
  size_t first_tile = 0;              ///< Of this layer.
};

/// A side of the cube around a point light, or the one plane that holds all samples. In it a sample has plane
/// coordinates u = x/w, v = y/w, with (x, y, w) its ray coordinates permuted so that w points out of the
/// face. (Directional: u = x, v = y.) Rows are intervals of v that hold about equally many samples; each is
/// cut into `columns` equal cells of its own range of u. A packet is entered in every row that it touches,
/// in the cell of its least u, so that what may meet a triangle is a run of entries in each of its rows.
struct Face {
  int axis = 2;
  float sign = 1.0f;
  float v_origin = 0.0f, v_scale = 0.0f;
  int rows = 0, columns = 0;
  uint32_t first_cell = 0;
  uint32_t first_row = 0;                            ///< Among the rows of all faces.
  std::vector<int32_t> row_of_bin;                   ///< Row * kSubrows + subrow of each of kRowBins
  std::vector<float> row_v_low, row_v_high;          ///< Padded for rounding; rows + kPacket values.
  std::vector<float> row_u_origin, row_u_scale;      ///< rows + kPacket values.
  std::vector<float> row_reach;                      ///< Widest entry of each row; rows + kPacket values.
  int most_rows_of_packet = 1;                       ///< Most rows that any packet is entered in.
  float u_min = 0, u_max = 0, v_min = 0, v_max = 0;  ///< Of all samples.
  float farthest = 0;                                ///< Largest w (directional: r.z) of all samples.
  uint32_t first_packet = 0, end_packet = 0;         ///< Of sorted samples.

  bool HasSamples() const { return farthest > -std::numeric_limits<float>::infinity(); }
};

/// What is known of some of a packet's samples before they are looked at, in one row of cells. A tile that
/// shows several surfaces is entered once for each.
struct PacketEntry {
  float u_min, v_min, minus_u_max, minus_v_max;
  float farthest;   ///< Largest w (directional: r.z).
  uint32_t packet;  ///< With kRepeated where the packet is entered in a lower row, too.
  uint32_t cell;
  uint32_t lanes;  ///< Bit per sample that is meant.
};
inline constexpr uint32_t kRepeated = 0x80000000u;
/// Of a sample that is in no packet.
inline constexpr uint32_t kNoPlace = 0xFFFFFFFFu;

/// Entries in the order of their cells, padded by kPacket.
struct EntryArrays {
  float *u_min = nullptr, *v_min = nullptr, *minus_u_max = nullptr, *minus_v_max = nullptr,
        *farthest = nullptr;
  uint32_t *packet = nullptr, *lanes = nullptr;
};

/// What a task counts, and the extent of its samples on each face.
struct TileCounts {
  size_t samples = 0;  ///< Pixels with a sample, in this light's reach or not.
  size_t facing_away = 0;
  size_t outside_cone = 0;
  size_t known = 0;
  size_t off_face = 0;  ///< Samples that the single face cannot hold.
  size_t entries = 0;
  int most_rows[6] = {1, 1, 1, 1, 1, 1};
  float u_min[6], u_max[6], v_min[6], v_max[6], farthest[6];

  TileCounts();
};

/// Rows of tiles of one layer.
struct TileTask {
  const LightFrame* frame = nullptr;
  const LayerSource* layer = nullptr;
  const Face* faces = nullptr;  ///< Six, or one (see single_face).
  bool single_face = true;
  bool sort_all = false;  ///< No tile is taken for a packet.
  int tiles_in_row = 0;
  int row_begin = 0, row_end = 0;              ///< Of tiles.
  const Cancellation* cancellation = nullptr;  ///< Once it asks, the rest of the rows is left out.
  // Of all tiles:
  float* packets = nullptr;
  uint16_t* present = nullptr;  ///< Bit per pixel: its sample is to be tested.
  uint16_t* facing = nullptr;   ///< Bit per pixel: its sample is in shadow untested.
  // Of this task:
  std::vector<PacketEntry>* entries = nullptr;  ///< Grows as needed; TileCounts says how many count.
  uint32_t* histogram = nullptr;                ///< Entries a cell.
  float* row_reach = nullptr;                   ///< Widest entry, per row of all faces.
  std::vector<uint32_t>* scattered =
      nullptr;  ///< Tiles whose samples lie far apart, to be sorted one by one.
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
  const float* uv = nullptr;  ///< Its own column of the block's.
};

/// Everything a triangle is tested against. Writes commute, so that neither order nor thread count changes
/// the outcome.
struct MaskState {
  const LightFrame* frame = nullptr;
  const Face* faces = nullptr;
  int face_count = 1;
  Search search = Search::kGrid;
  const uint32_t* cell_start = nullptr;  ///< Of entries.
  EntryArrays entries;
  const std::vector<BspNode>* bsp = nullptr;  ///< One tree a face.
  /// Where packet 0 would be, of those below first_sorted, and of those from it on.
  const float* packets[2] = {nullptr, nullptr};
  uint32_t first_sorted = 0;
  bool shared = true;           ///< Other threads write to the same words: only atomics will do.
  uint16_t* shadow = nullptr;   ///< Bit per sample: a caster certainly blocks it, or there is no sample.
  uint16_t* touched = nullptr;  ///< Bit per sample: it lies on a caster, within the error bound.
  uint16_t* touched_twice = nullptr;  ///< Bit per sample: on two.
  uint32_t* absorbance = nullptr;     ///< [packet][channels][kPacket]; null where only bits are asked for.
  size_t channels = 3;                ///< One where all casters are grey.
  const Cancellation* cancellation = nullptr;  ///< Once it asks, what is left is not tested.

  bool Cancelled() const { return cancellation != nullptr && cancellation->Requested(); }
  uint8_t* packet_lock = nullptr;  ///< Guards a packet's absorbance.
};

struct CasterBlocks {
  const float* geometry = nullptr;  ///< count * kBlockFloats
  const float* uvs = nullptr;       ///< count * 6 * kBlock, or null
  size_t count = 0;
  const Caster* caster = nullptr;
};

/// Ray coordinates of every `stride`-th tile of every `stride`-th row of them, for planning a layout.
void SampleRays(const TileTask& task, int stride, std::vector<glm::vec3>* rays);

/// Brings the samples of tiles into ray coordinates, and enters those tiles in cells that are packets as they
/// are.
void SetUpTiles(const TileTask& task, TileCounts* counts);

/// For samples that are sorted one by one: cell * kSubrows + subrow of each pixel of the tiles (`none` where
/// there is no sample) and its rank among the pixels of that cell and call; counts them in `histogram`. Adds
/// to the measures of faces in `counts`.
void BinSamples(const TileTask& task, std::span<const uint32_t> tiles, uint32_t none, uint32_t* cell,
                uint32_t* rank, uint32_t* histogram, TileCounts* counts);

/// Copies these samples to their places, four numbers a sample, and replaces each pixel's cell by its place
/// (kNoPlace where it is `none`). `start` is where this call's samples of each cell go; `scrap_place` takes
/// what must go somewhere.
void PlaceSamples(const TileTask& task, std::span<const uint32_t> tiles, uint32_t none, const uint32_t* start,
                  const uint32_t* rank, uint32_t scrap_place, uint32_t* cell_to_place, float* sorted_packets);

/// Makes packets of every kPacket placed samples, where they are.
void TransposePackets(float* packets, size_t count);

/// Enters packets [begin, end) of sorted samples, which all lie in `row` of a face; `shadow` is set where
/// they hold no sample. Appends to `entries`, counts in `histogram`; returns the number of entries.
size_t EnterPackets(const LightFrame& frame, const Face& face, int row, uint32_t begin, uint32_t end,
                    uint32_t first_sorted, const float* sorted_packets, const uint16_t* shadow,
                    PacketEntry* entries, uint32_t* histogram, float* row_reach);

/// Tests blocks of triangles. Triangles that cover very many packets are appended to `deferred` instead, up
/// to its capacity.
void WalkTriangles(const MaskState& state, const CasterBlocks& blocks,
                   std::vector<DeferredTriangle>* deferred);

/// Tests a deferred triangle in rows [row_begin, row_end) of its face.
void WalkDeferred(const MaskState& state, const DeferredTriangle& triangle, int row_begin, int row_end);

}  // namespace shadowfit::irregular
