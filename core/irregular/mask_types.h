#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "core/scene/scene.h"

/// What the parts of the alias-free masks share; described in shadow_masks.h, and no part of the public
/// interface.
namespace shadowfit::irregular {

/// Triangles are stored and transformed in blocks: nine rows (a.x a.y a.z b.x .. c.z) of this many floats.
inline constexpr int kBlock = 16;
inline constexpr int kBlockFloats = 9 * kBlock;
/// Triangles of a cluster, in blocks: few enough that its box is a sharp test, many enough that the test
/// costs little, and that the samples of all of them are tested together.
inline constexpr size_t kClusterBlocks = 4;
/// Arrays that are read by vectors of any width are padded by so many elements.
inline constexpr int kPadding = 16;

/// A single face holds directions up to 75 degrees off its axis: |u| and |v| up to this.
inline constexpr float kWidestFace = 4.0f;

/// Half an ulp of 1 in single precision.
inline constexpr float kUnitRoundoff = 0x1p-24f;

/// Coordinates in which one light's samples are brought: r = rotation (X - ws_origin). The origin is the
/// light, or for a directional light, whose rays run along r.z, a point amid the samples.
struct LightFrame {
  bool directional = false;
  glm::dvec3 ws_origin{0.0};
  double rotation[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};  ///< Rows.
  bool has_cone = false;                                      ///< A spot's cone around +r.z.
  double cos_outer = -1.0;
};

/// A row of cells. Vectors read its four values at a time.
struct alignas(16) Row {
  int32_t number, first_cell;  ///< Of the face.
  float u_origin, u_scale;
};

/// A side of the cube around a point light, or the one plane that holds all samples. Its coordinates
/// (x, y, w) are those of the light's frame, permuted so that w points out of the face. In it a sample has
/// plane coordinates u = x/w, v = y/w (directional: u = x, v = y) and a depth that grows along its ray: -1/w
/// (directional: w). Rows are intervals of v that hold about equally many samples; each is cut into `columns`
/// equal cells of its own range of u. Samples are sorted by cell, row after row, so that what may meet a
/// triangle is a run of samples in each of its rows.
struct Face {
  int axis = 2;  ///< Of w in the light's frame; u and v follow it cyclically.
  double sign = 1.0;
  double rotation[3][3] = {};  ///< Rows: the axes of x, y, w in the world.
  float v_origin = 0.0f, v_scale = 0.0f;
  int rows = 0, columns = 0;
  uint32_t first_cell = 0;
  std::vector<Row> row_of_bin;  ///< The v axis is cut into equal bins, which the layout gathers into rows.
  std::vector<int32_t> first_bin_of_row;             ///< rows + 1 values.
  std::vector<float> row_v_low, row_v_high;          ///< Padded for rounding; rows + kPadding values.
  float u_min = 0, u_max = 0, v_min = 0, v_max = 0;  ///< Of all samples.
  float farthest = 0;                                ///< Largest depth of all samples.
  uint32_t first_sample = 0, end_sample = 0;

  bool HasSamples() const { return farthest > -std::numeric_limits<float>::infinity(); }

  // Samples and triangles find their cells by the same arithmetic, here and in simd.h, which is monotonic in
  // u and in v: rounding cannot part them.
  size_t BinAt(float v) const { return Clamped((v - v_origin) * v_scale, row_of_bin.size() - 1); }
  const Row& RowAt(float v) const { return row_of_bin[BinAt(v)]; }
  uint32_t CellAt(const Row& row, float u) const {
    const size_t column = Clamped((u - row.u_origin) * row.u_scale, static_cast<size_t>(columns) - 1);
    return first_cell + static_cast<uint32_t>(row.first_cell) + static_cast<uint32_t>(column);
  }

 private:
  /// Zero for NaN, which is what an infinite box comes to where v_scale is zero.
  static size_t Clamped(float value, size_t most) {
    return static_cast<size_t>(std::min(std::max(0.0f, value), static_cast<float>(most)));
  }
};

/// A face's coordinates in single precision, which bounds suffice with.
struct FaceFrame {
  float origin[3], origin_rest[3];  ///< Together to nearly twice single precision.
  float rotation[3][3];

  FaceFrame(const LightFrame& frame, const Face& face) {
    for (int i = 0; i < 3; ++i) {
      origin[i] = static_cast<float>(frame.ws_origin[i]);
      origin_rest[i] = static_cast<float>(frame.ws_origin[i] - static_cast<double>(origin[i]));
      for (int row = 0; row < 3; ++row) rotation[row][i] = static_cast<float>(face.rotation[row][i]);
    }
  }
};

/// A sample in plane coordinates of its face.
struct alignas(16) Sample {
  float u, v, depth;
  float error;  ///< Bound on the distance to the true surface point, as a share of w (point).
};

/// Sorted samples, padded by kPadding, as tests read them.
struct SampleArrays {
  float *u = nullptr, *v = nullptr, *depth = nullptr, *error = nullptr;
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
/// Beyond 2^-20 of the light nothing is left; sums are not raised any more from here on, and cannot wrap.
inline constexpr uint32_t kAbsorbanceMax = 20u << 16;

}  // namespace shadowfit::irregular
