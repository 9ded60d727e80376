#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>

#include "core/frame/images.h"
#include "core/irregular/mask_types.h"

/// Pixels to sorted samples and back: inner loops compiled for several instruction sets.
namespace shadowfit::irregular {

/// Pixels are handled in strips of this many of one row.
inline constexpr int kStrip = 16;

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
  RayFromPixel ray_from_pixel{};
  float background = 1.0f;            ///< Window depth that means nothing was drawn.
  float depth_absolute_error = 0.0f;  ///< Of window depth.
  float depth_relative_error = 0.0f;  ///< Of window depth.
  float origin_error = 0.0f;          ///< World units, from the rounding of coordinates around the origin.
};

/// A rectangle of pixels, in all layers. A line is a row of strips of it; lines are counted from row to row,
/// layer after layer.
struct Piece {
  int strip_begin = 0, strip_end = 0;
  int row_begin = 0, row_end = 0;
  int layers = 1;

  int strips() const { return strip_end - strip_begin; }
  int rows() const { return row_end - row_begin; }
  size_t lines() const { return static_cast<size_t>(rows()) * static_cast<size_t>(layers); }
  size_t strip_count() const { return static_cast<size_t>(strips()) * lines(); }
};

/// What there is in a piece, and the extent of its samples on each face.
struct SampleCounts {
  size_t samples = 0;  ///< Pixels with a sample, in this light's reach or not.
  size_t facing_away = 0;
  size_t outside_cone = 0;
  size_t known = 0;
  size_t off_face = 0;  ///< Samples that the single face cannot hold.
  float u_min[6], u_max[6], v_min[6], v_max[6], farthest[6];

  SampleCounts();
  void Add(const SampleCounts& other);
};

/// A piece's pixels, strip by strip.
struct PieceTask {
  const LightFrame* frame = nullptr;
  const LayerSource* layers = nullptr;
  const Face* faces = nullptr;
  int face_count = 1;  ///< Six, or one.
  Piece piece;
  // Per strip:
  uint16_t* present = nullptr;  ///< Bit per pixel: its sample is to be tested.
  uint16_t* facing = nullptr;   ///< Bit per pixel: its sample is in shadow untested.
  // Per pixel:
  Sample* samples = nullptr;    ///< Of present pixels only, by SlotOf: sorting reads a whole one at a time.
  uint32_t* face_of = nullptr;  ///< Of present pixels, where there are six faces.
  uint32_t* place = nullptr;    ///< Of present pixels: the cell, then the place in it.
};

/// Where a pixel's sample lies: those of a strip as a square of 4x4 pixels that is transposed, which is what
/// vectors make of four values of each at the least cost. Its own inverse.
constexpr size_t SlotOf(size_t pixel) {
  static_assert(kStrip == 16);
  return (pixel & ~size_t{15}) | (pixel & 3) << 2 | (pixel >> 2 & 3);
}

/// Lines [begin, end) of a piece.
struct Lines {
  size_t begin = 0, end = 0;
};

/// Of each line every so many-th strip, from another one on in each.
inline size_t FirstStrip(size_t line, size_t step) { return line * 5 % step; }

/// Brings the samples of some strips into plane coordinates: of each line the FirstStrip() and every step-th.
void ProjectSamples(const PieceTask& task, const Lines& lines, size_t step, SampleCounts* counts);

/// Finds the cell of each sample, and counts samples in `histogram` (of cells).
void BinSamples(const PieceTask& task, const Lines& lines, uint32_t* histogram);

/// Gives each sample its place: order[place] is its slot. next[cell] is where the next sample of a cell
/// goes.
void PlaceSamples(const PieceTask& task, const Lines& lines, uint32_t* next, uint32_t* order);

/// The samples of `count` slots of a piece, one after the other; what follows them up to `end` lies inside
/// of nothing.
void GatherSamples(const Sample* from, const uint32_t* order, size_t count, size_t end,
                   const SampleArrays& to);

/// The answers of strips, of which a bit per sorted sample is set in `shadow`. Returns how many bits are set.
size_t GatherAnswers(const PieceTask& task, const Lines& lines, const uint32_t* shadow, uint16_t* out);

}  // namespace shadowfit::irregular
