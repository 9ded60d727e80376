#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <span>
#include <vector>

#include "absl/status/status.h"
#include "core/irregular/aligned_buffer.h"
#include "core/irregular/caster_boxes.h"
#include "core/irregular/cluster_walk.h"
#include "core/irregular/light_plan.h"
#include "core/irregular/sample_kernels.h"
#include "core/irregular/walk_kernels.h"

namespace shadowfit::irregular {

/// Where a light's answers go: strips, and pixels, row after row, layer after layer.
struct MaskImages {
  int width = 0, height = 0, strips = 0;
  uint16_t* bits = nullptr;
  uint8_t* rgb = nullptr;       ///< Null where there is none.
  uint8_t* coverage = nullptr;  ///< Null where there is none.

  /// Of a line of a piece.
  size_t RowOf(const Piece& piece, size_t line) const {
    const auto rows = static_cast<size_t>(piece.rows());
    return line / rows * static_cast<size_t>(height) + static_cast<size_t>(piece.row_begin) + line % rows;
  }
};

/// What is summed over a light's pieces.
struct PieceTotals {
  SampleCounts counts;
  size_t shadowed = 0, undecided = 0;
  MaskTimings milliseconds;
};

struct PlanSample {
  float u, v;
  int face;
};

/// Renders pieces of masks, one at a time: projects a piece's samples, sorts them into cells, streams the
/// triangles over them. Where triangles are few, pieces are so small that their samples stay in the
/// second-level cache all the while, and there is a renderer for each thread. Where triangles are many, all
/// of the frame is one piece, so that each triangle is looked at only once; the threads share the work, first
/// by lines of pixels, then by bands of rows of cells. Keeps its memory.
class PieceRenderer {
 public:
  /// Memory for pieces of this size, so that which thread renders which piece makes no difference to what is
  /// allocated. False where it runs out.
  [[nodiscard]] bool Reserve(const MaskRequest& request, const Piece& piece, bool share_work, int channels);

  /// ResourceExhausted where memory runs out; anything once the request is cancelled. Stops after projection
  /// where the single face does not hold all samples: see SampleCounts::off_face.
  absl::Status Render(const MaskRequest& request, const LightPlan& plan, const CasterBoxes& boxes,
                      const CasterInput& casters, const Piece& piece, bool share_work,
                      const MaskImages& images, PieceTotals* totals);

  size_t MemoryBytes() const;

 private:
  /// Lines of pixels whose projected samples stay in the second-level cache while they are looked at.
  struct Part {
    Lines lines;
    SampleCounts counts;
    std::vector<PlanSample> plan;  ///< Some of its samples, which plan the cells.
  };
  /// Parts with about equally many samples, handled by one task, which has a histogram of its own.
  struct Chunk {
    size_t begin = 0, end = 0;
  };
  /// Rows of cells whose samples are tested by one task. No word of answers belongs to two bands.
  struct Band {
    int face = 0;
    int row_begin = 0, row_end = 0;
    uint32_t first_cell = 0, end_cell = 0;
    uint32_t first_sample = 0, samples = 0;
  };

  /// Of a thread that handles one band after the other.
  struct BandScratch {
    AlignedBuffer<float> samples;
    LiveDepths depths;
  };

  static size_t LinesOfPart(const Piece& piece, bool share_work);
  void CutIntoParts(const Piece& piece, bool share_work);
  void CutIntoChunks(bool share_work);
  void SamplePart(const PieceTask& task, Part* part);
  static void PlanStrip(const PieceTask& task, size_t strip, unsigned samples, Part* part);
  void SetUpFaces(const LightPlan& plan, const SampleCounts& counts);
  void MeasureFaces(const LightPlan& plan, const SampleCounts& counts);
  bool Count(const PieceTask& task, bool share_work, const Cancellation* cancellation);
  void CutIntoBands(const LightPlan& plan, bool share_work);
  void Sort(const PieceTask& task, bool share_work, const Cancellation* cancellation);
  void SortByBsp(const PieceTask& task, const Cancellation* cancellation);
  bool WalkBand(const MaskRequest& request, const LightPlan& plan, const CasterBoxes& boxes,
                const CasterInput& casters, const Sample* projected, const Band& band);
  size_t CountUndecided() const;
  size_t Resolve(const PieceTask& task, const Lines& lines, int channels, const MaskImages& images);
  void ResolveColours(const PieceTask& task, const Lines& lines, int channels, const MaskImages& images);
  void ResolveCoverage(const PieceTask& task, const MaskImages& images);
  BandScratch& MyScratch();
  static SampleArrays Arrays(AlignedBuffer<float>* values, size_t count);

  std::array<Face, 6> faces_;
  size_t pixels_ = 0;    ///< Of the piece.
  size_t capacity_ = 0;  ///< Sorted samples, gaps and padding.
  uint32_t cells_ = 0;
  uint32_t end_sample_ = 0;  ///< Of sorted samples, gaps between bands included.
  std::vector<Part> parts_;
  std::vector<Chunk> chunks_;
  std::vector<Band> bands_;
  std::vector<glm::vec2> uv_;
  AlignedBuffer<uint16_t> present_, facing_, bits_;
  AlignedBuffer<uint32_t> place_;
  AlignedBuffer<Sample> projected_;   ///< By slot.
  AlignedBuffer<uint32_t> face_of_;   ///< By pixel.
  AlignedBuffer<uint32_t> order_;     ///< Slot of each sorted sample.
  std::vector<BandScratch> scratch_;  ///< Of each thread that shares the work.
  AlignedBuffer<uint32_t> next_, cell_start_;
  // Answers, per sorted sample.
  AlignedBuffer<uint32_t> shadow_, touched_, touched_twice_;
  AlignedBuffer<uint32_t> absorbance_;  ///< Channel after channel.
  // For the BSP.
  std::array<std::vector<BspNode>, 6> bsp_;
  std::vector<glm::vec3> bsp_uvd_;
  std::vector<uint32_t> bsp_order_, bsp_slots_;
};

}  // namespace shadowfit::irregular
