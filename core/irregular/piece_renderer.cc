#include "core/irregular/piece_renderer.h"

#include <tbb/task_arena.h>

#include <algorithm>
#include <atomic>
#include <bit>
#include <chrono>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "absl/strings/str_format.h"
#include "core/irregular/parallel.h"
#include "core/irregular/sample_layout.h"

namespace shadowfit::irregular {
namespace {

/// Arrays that are written side by side start at different places of a page: the processor takes addresses
/// that agree in their last twelve bits for the same at first.
constexpr size_t kStagger = 272;
/// Of a part of a piece that is shared.
constexpr size_t kPartPixels = 1 << 15;
/// Where a piece has several parts, one strip of so many plans its cells.
constexpr size_t kPlanStep = 16;
/// Histograms are as large as all cells: no more of them than so many.
constexpr size_t kMostChunks = 8;
/// Bands of each thread, enough to balance, few enough for most triangles to lie in one; and the least that a
/// band should hold.
constexpr int kBandsPerThread = 8;
constexpr double kLeastOfBand = 1 << 13;
/// A band starts at a word of answers, after a word that is nobody's: vectors reach beyond the end of a run.
constexpr uint32_t kWordBits = 32;

/// body(i) for all i < count, in parallel where the work is to be shared.
template <typename Body>
void Each(bool share_work, size_t count, const Cancellation* cancellation, const Body& body) {
  if (share_work) {
    ForEach(count, cancellation, body);
  } else {
    for (size_t i = 0; i < count; ++i) body(i);
  }
}

class Stopwatch {
 public:
  double Lap() {
    const Clock::time_point now = Clock::now();
    const double milliseconds = std::chrono::duration<double, std::milli>(now - last_).count();
    last_ = now;
    return milliseconds;
  }

 private:
  using Clock = std::chrono::steady_clock;
  Clock::time_point last_ = Clock::now();
};

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

size_t PieceRenderer::LinesOfPart(const Piece& piece, bool share_work) {
  const size_t line_pixels = static_cast<size_t>(piece.strips()) * kStrip;
  return share_work ? std::max<size_t>(1, kPartPixels / line_pixels) : piece.lines();
}

void PieceRenderer::CutIntoParts(const Piece& piece, bool share_work) {
  const size_t lines = piece.lines(), step = LinesOfPart(piece, share_work);
  parts_.resize((lines + step - 1) / step);
  for (size_t i = 0; i < parts_.size(); ++i) {
    parts_[i].lines = {i * step, std::min(lines, (i + 1) * step)};
    parts_[i].counts = SampleCounts();
    parts_[i].plan.clear();
  }
}

void PieceRenderer::CutIntoChunks(bool share_work) {
  size_t all = 0, taken = 0;
  for (const Part& part : parts_) all += part.plan.size();
  const size_t wanted = share_work
                            ? std::clamp<size_t>(static_cast<size_t>(tbb::this_task_arena::max_concurrency()),
                                                 1, std::min(kMostChunks, parts_.size()))
                            : 1;
  chunks_.clear();
  for (size_t i = 0; i < parts_.size(); ++i) {
    if (chunks_.empty() || taken * wanted > all * chunks_.size()) {
      chunks_.push_back({i, i + 1});
    } else {
      chunks_.back().end = i + 1;
    }
    taken += parts_[i].plan.size();
  }
}

/// Looks at all samples of a part that is alone, and at some strips of each of several.
void PieceRenderer::SamplePart(const PieceTask& task, Part* part) {
  const bool few = parts_.size() > 1;
  ProjectSamples(task, part->lines, few ? kPlanStep : 1, &part->counts);
  const auto strips = static_cast<size_t>(task.piece.strips());
  const size_t step = few ? kPlanStep : 2;
  for (size_t line = part->lines.begin; line < part->lines.end; ++line) {
    for (size_t i = FirstStrip(line, step); i < strips; i += step)
      PlanStrip(task, line * strips + i, few ? 3 : 1, part);
  }
}

void PieceRenderer::PlanStrip(const PieceTask& task, size_t strip, unsigned samples, Part* part) {
  const auto present = static_cast<unsigned>(task.present[strip]);
  if (present == 0) return;
  for (unsigned i = 0; i < samples; ++i) {
    const auto shift = static_cast<unsigned>((strip * 5 + i * 6) % kStrip);
    const unsigned later = present >> shift << shift;
    const size_t pixel = strip * kStrip + static_cast<size_t>(std::countr_zero(later != 0 ? later : present));
    const Sample& sample = task.samples[SlotOf(pixel)];
    part->plan.push_back(
        {sample.u, sample.v, task.face_count > 1 ? static_cast<int>(task.face_of[pixel]) : 0});
  }
}

bool PieceRenderer::Reserve(const MaskRequest& request, const Piece& piece, bool share_work, int channels) {
  pixels_ = piece.strip_count() * kStrip;
  capacity_ = pixels_ + 2 * kWordBits * (static_cast<size_t>(pixels_ / kLeastOfBand) + 8);
  const size_t words = capacity_ / kWordBits + 2;
  const bool transmit = request.output == MaskOutput::kTransmittance;
  const size_t threads =
      share_work ? static_cast<size_t>(std::max(tbb::this_task_arena::max_concurrency(), 1)) : 1;
  if (scratch_.size() < threads) scratch_.resize(threads);
  // Of a band, if they are equal.
  const size_t band_samples = share_work ? capacity_ / (kBandsPerThread * threads) : capacity_;
  for (BandScratch& scratch : scratch_) {
    if (!scratch.samples.Reserve(4 * (band_samples + kStagger)) || !scratch.depths.Reserve(band_samples)) {
      return false;
    }
  }
  if (!share_work) {
    parts_.resize(std::max<size_t>(parts_.size(), 1));
    parts_[0].plan.reserve(piece.strip_count());
    if (!next_.Reserve(pixels_ / 2) || !cell_start_.Reserve(pixels_ / 2 + 1)) return false;
  }
  return present_.Reserve(piece.strip_count()) && facing_.Reserve(piece.strip_count()) &&
         bits_.Reserve(piece.strip_count()) && place_.Reserve(pixels_) && order_.Reserve(capacity_) &&
         projected_.Reserve(pixels_) && face_of_.Reserve(pixels_) && shadow_.Reserve(words) &&
         touched_.Reserve(words) && touched_twice_.Reserve(words) &&
         (!transmit || absorbance_.Reserve(static_cast<size_t>(channels) * capacity_));
}

PieceRenderer::BandScratch& PieceRenderer::MyScratch() {
  if (scratch_.size() == 1) return scratch_[0];
  return scratch_[static_cast<size_t>(tbb::this_task_arena::current_thread_index()) % scratch_.size()];
}

SampleArrays PieceRenderer::Arrays(AlignedBuffer<float>* values, size_t count) {
  const size_t stride = count + kStagger;
  return {values->data(), values->data() + stride, values->data() + 2 * stride, values->data() + 3 * stride};
}

void PieceRenderer::MeasureFaces(const LightPlan& plan, const SampleCounts& counts) {
  for (int f = 0; f < plan.face_count; ++f) {
    Face& face = faces_[static_cast<size_t>(f)];
    face.u_min = counts.u_min[f];
    face.u_max = counts.u_max[f];
    face.v_min = counts.v_min[f];
    face.v_max = counts.v_max[f];
    face.farthest = counts.farthest[f];
  }
}

/// Cells for the samples that were looked at; others of six faces may turn up, and get one cell.
void PieceRenderer::SetUpFaces(const LightPlan& plan, const SampleCounts& counts) {
  MeasureFaces(plan, counts);
  size_t planned = 0;
  for (const Part& part : parts_) planned += part.plan.size();
  cells_ = 0;
  for (int f = 0; f < plan.face_count; ++f) {
    Face& face = faces_[static_cast<size_t>(f)];
    uv_.clear();
    for (const Part& part : parts_) {
      for (const PlanSample& sample : part.plan) {
        if (sample.face == f) uv_.emplace_back(sample.u, sample.v);
      }
    }
    PlanFace(uv_,
             static_cast<double>(pixels_) * static_cast<double>(uv_.size()) /
                 std::max(1.0, static_cast<double>(planned)),
             &face);
    face.first_cell = cells_;
    cells_ += static_cast<uint32_t>(face.rows * face.columns);
  }
}

/// Rows hold about equally many samples, and so do bands. There are no more of them for a light of six faces:
/// clusters that two bands share are walked for both.
void PieceRenderer::CutIntoBands(const LightPlan& plan, bool share_work) {
  bands_.clear();
  for (int f = 0; f < plan.face_count; ++f) {
    const Face& face = faces_[static_cast<size_t>(f)];
    const double cells = static_cast<double>(face.rows) * face.columns;
    const double share = cells / static_cast<double>(cells_);
    const double wanted =
        share * std::min(static_cast<double>(kBandsPerThread * tbb::this_task_arena::max_concurrency()),
                         static_cast<double>(pixels_) / kLeastOfBand);
    const int count =
        share_work ? std::clamp(static_cast<int>(std::ceil(wanted)), 1, std::max(face.rows / 4, 1)) : 1;
    for (int band = 0; band < count; ++band) {
      const int begin = face.rows * band / count, end = face.rows * (band + 1) / count;
      bands_.push_back({f, begin, end, face.first_cell + static_cast<uint32_t>(begin * face.columns),
                        face.first_cell + static_cast<uint32_t>(end * face.columns), 0});
    }
  }
}

/// Samples of each cell and chunk. False where memory runs out. Incomplete once cancelled.
bool PieceRenderer::Count(const PieceTask& task, bool share_work, const Cancellation* cancellation) {
  CutIntoChunks(share_work);
  if (!next_.Reserve(cells_ * chunks_.size()) || !cell_start_.Reserve(size_t{cells_} + 1)) return false;
  Each(share_work, chunks_.size(), cancellation, [&](size_t i) {
    uint32_t* const histogram = next_.data() + i * cells_;
    std::fill_n(histogram, cells_, 0u);
    for (size_t p = chunks_[i].begin; p < chunks_[i].end; ++p) {
      if (IsCancelled(cancellation)) return;
      Part& part = parts_[p];
      if (parts_.size() > 1) {
        part.counts = SampleCounts();
        ProjectSamples(task, part.lines, 1, &part.counts);
      }
      BinSamples(task, part.lines, histogram);
    }
  });
  return true;
}

/// Incomplete once cancelled.
void PieceRenderer::Sort(const PieceTask& task, bool share_work, const Cancellation* cancellation) {
  // 1. Where each band starts, and in it each cell, and in that the samples of each chunk.
  Each(share_work, bands_.size(), cancellation, [&](size_t i) {
    Band& band = bands_[i];
    band.samples = 0;
    for (size_t chunk = 0; chunk < chunks_.size(); ++chunk) {
      const uint32_t* const histogram = next_.data() + chunk * cells_;
      band.samples = std::accumulate(histogram + band.first_cell, histogram + band.end_cell, band.samples);
    }
  });
  if (IsCancelled(cancellation)) return;  // What was skipped must not be relied on.
  uint32_t at = 0;
  for (Band& band : bands_) {
    band.first_sample = at;
    at += band.samples;
    Face& face = faces_[static_cast<size_t>(band.face)];
    if (band.row_begin == 0) face.first_sample = band.first_sample;
    face.end_sample = at;
    at = (at + 2 * kWordBits - 1) / kWordBits * kWordBits;
  }
  end_sample_ = at;
  Each(share_work, bands_.size(), cancellation, [&](size_t i) {
    uint32_t start = bands_[i].first_sample;
    for (size_t cell = bands_[i].first_cell; cell < bands_[i].end_cell; ++cell) {
      cell_start_[cell] = start;
      for (size_t chunk = 0; chunk < chunks_.size(); ++chunk) {
        start += std::exchange(next_[chunk * cells_ + cell], start);
      }
    }
  });
  cell_start_[cells_] = end_sample_;
  if (IsCancelled(cancellation)) return;

  // 2. Samples to their places.
  Each(share_work, chunks_.size(), cancellation, [&](size_t i) {
    for (size_t p = chunks_[i].begin; p < chunks_[i].end; ++p) {
      if (IsCancelled(cancellation)) return;
      PlaceSamples(task, parts_[p].lines, next_.data() + i * cells_, order_.data());
    }
  });
}

void PieceRenderer::SortByBsp(const PieceTask& task, const Cancellation* cancellation) {
  for (int f = 0; f < task.face_count; ++f) {
    const Face& face = faces_[static_cast<size_t>(f)];
    if (!face.HasSamples()) continue;
    const uint32_t count = face.end_sample - face.first_sample;
    uint32_t* const slots = order_.data() + face.first_sample;
    bsp_uvd_.resize(count);
    bsp_order_.resize(count);
    for (uint32_t i = 0; i < count; ++i) {
      const Sample& sample = task.samples[slots[i]];
      bsp_uvd_[i] = {sample.u, sample.v, sample.depth};
      bsp_order_[i] = i;
    }
    std::vector<BspNode>& nodes = bsp_[static_cast<size_t>(f)];
    BuildBsp(bsp_uvd_, bsp_order_, cancellation, &nodes);
    for (BspNode& node : nodes) {
      node.first_sample += face.first_sample;
      node.end_sample += face.first_sample;
    }
    bsp_slots_.assign(slots, slots + count);
    for (uint32_t i = 0; i < count; ++i) {
      slots[i] = bsp_slots_[bsp_order_[i]];
      task.place[SlotOf(slots[i])] = face.first_sample + i;
    }
  }
}

/// False where memory runs out. Incomplete once cancelled.
bool PieceRenderer::WalkBand(const MaskRequest& request, const LightPlan& plan, const CasterBoxes& boxes,
                             const CasterInput& casters, const Sample* projected, const Band& band) {
  const Face& face = faces_[static_cast<size_t>(band.face)];
  WalkTask task;
  task.frame = &plan.frame;
  task.face = &face;
  task.row_begin = band.row_begin;
  task.row_end = band.row_end;
  task.v_min = std::max(face.v_min, face.row_v_low[static_cast<size_t>(band.row_begin)]);
  task.v_max = std::min(face.v_max, face.row_v_high[static_cast<size_t>(band.row_end - 1)]);
  task.bsp = &bsp_[static_cast<size_t>(band.face)];
  task.search = request.method == MaskMethod::kBsp          ? Search::kBsp
                : request.method == MaskMethod::kExhaustive ? Search::kExhaustive
                                                            : Search::kGrid;
  task.cell_start = cell_start_.data();
  task.shadow = shadow_.data();
  task.touched = touched_.data();
  task.touched_twice = touched_twice_.data();
  task.channels = casters.channels;
  task.cancellation = request.cancellation;
  const size_t first_sample = cell_start_[band.first_cell], end_sample = cell_start_[band.end_cell];
  task.first_sample = band.first_sample;
  task.end_sample = band.first_sample + band.samples;
  BandScratch& scratch = MyScratch();
  AlignedBuffer<float>& values = scratch.samples;
  const size_t count = end_sample - first_sample;
  if (!values.Reserve(4 * (count + kStagger))) return false;
  task.samples = Arrays(&values, count);
  GatherSamples(projected, order_.data() + first_sample, band.samples, count, task.samples);
  const auto first = static_cast<std::ptrdiff_t>(first_sample);
  SampleArrays& arrays = task.samples;
  for (float** array : {&arrays.u, &arrays.v, &arrays.depth, &arrays.error}) *array -= first;
  for (uint32_t* answers : {task.shadow, task.touched, task.touched_twice}) {
    std::fill(answers + first_sample / kWordBits, answers + end_sample / kWordBits, 0u);
  }
  if (request.output == MaskOutput::kTransmittance) {
    for (size_t channel = 0; channel < static_cast<size_t>(casters.channels); ++channel) {
      task.absorbance[channel] = absorbance_.data() + channel * capacity_;
      std::fill(task.absorbance[channel] + first_sample, task.absorbance[channel] + end_sample, 0u);
    }
  }
  return WalkClusters(task, boxes.Of(band.face), casters, &scratch.depths);
}

size_t PieceRenderer::CountUndecided() const {
  size_t count = 0;
  for (size_t word = 0; word < (size_t{end_sample_} + 31) / 32; ++word) {
    // Rare: most words have none.
    const uint32_t undecided = touched_twice_[word] & ~shadow_[word];
    if (undecided != 0) count += static_cast<size_t>(std::popcount(undecided));
  }
  return count;
}

/// Where there is no sorted sample all light arrives, but where the bit says that none does.
void PieceRenderer::ResolveColours(const PieceTask& task, const Lines& lines, int channels,
                                   const MaskImages& images) {
  static const AbsorbanceTable table;
  const Piece& piece = task.piece;
  size_t index = lines.begin * static_cast<size_t>(piece.strips());
  for (size_t line = lines.begin; line < lines.end; ++line) {
    uint8_t* const row = images.rgb + images.RowOf(piece, line) * static_cast<size_t>(images.width) * 3;
    for (int strip = piece.strip_begin; strip < piece.strip_end; ++strip, ++index) {
      const int x = strip * kStrip;
      uint8_t* out = row + static_cast<size_t>(x) * 3;
      for (int i = 0; i < std::min(kStrip, images.width - x); ++i, out += 3) {
        if ((bits_[index] >> i & 1) != 0) {
          std::fill_n(out, 3, uint8_t{0});
        } else if ((task.present[index] >> i & 1) == 0) {
          std::fill_n(out, 3, uint8_t{255});
        } else {
          const uint32_t* sum = absorbance_.data() + task.place[index * kStrip + static_cast<size_t>(i)];
          for (size_t channel = 0; channel < 3; ++channel) {
            out[channel] =
                channel < static_cast<size_t>(channels) ? table.Value(sum[channel * capacity_]) : out[0];
          }
        }
      }
    }
  }
}

void PieceRenderer::ResolveCoverage(const PieceTask& task, const MaskImages& images) {
  const Piece& piece = task.piece;
  const size_t layer_strips = piece.strip_count() / static_cast<size_t>(piece.layers);
  for (size_t strip = 0; strip < layer_strips; ++strip) {
    const int x = (piece.strip_begin + static_cast<int>(strip) % piece.strips()) * kStrip;
    const int y = piece.row_begin + static_cast<int>(strip) / piece.strips();
    uint8_t* out = images.coverage + static_cast<size_t>(y) * static_cast<size_t>(images.width);
    for (int i = 0; i < std::min(kStrip, images.width - x); ++i) {
      unsigned samples = 0, blocked = 0;
      for (size_t index = strip; index < piece.strip_count(); index += layer_strips) {
        samples += static_cast<unsigned>(task.present[index] | task.facing[index]) >> i & 1u;
        blocked += static_cast<unsigned>(bits_[index]) >> i & 1u;
      }
      const unsigned lit = samples - blocked;
      out[x + i] = samples == 0 ? uint8_t{255} : static_cast<uint8_t>((510 * lit + samples) / (2 * samples));
    }
  }
}

size_t PieceRenderer::Resolve(const PieceTask& task, const Lines& lines, int channels,
                              const MaskImages& images) {
  const Piece& piece = task.piece;
  const auto strips = static_cast<size_t>(piece.strips());
  const size_t count = GatherAnswers(task, lines, shadow_.data(), bits_.data());
  for (size_t line = lines.begin; line < lines.end; ++line) {
    std::copy_n(
        bits_.data() + line * strips, strips,
        images.bits + images.RowOf(piece, line) * static_cast<size_t>(images.strips) + piece.strip_begin);
  }
  if (images.rgb != nullptr) ResolveColours(task, lines, channels, images);
  return count;
}

absl::Status PieceRenderer::Render(const MaskRequest& request, const LightPlan& plan,
                                   const CasterBoxes& boxes, const CasterInput& casters, const Piece& piece,
                                   bool share_work, const MaskImages& images, PieceTotals* totals) {
  const Cancellation* const cancellation = request.cancellation;
  const auto out_of_memory = [&] {
    return absl::ResourceExhaustedError(absl::StrFormat("layers: no memory for %d samples", pixels_));
  };
  Stopwatch watch;
  if (!Reserve(request, piece, share_work, casters.channels)) return out_of_memory();
  PieceTask task;
  task.frame = &plan.frame;
  task.layers = plan.layers.data();
  task.faces = faces_.data();
  task.face_count = plan.face_count;
  task.piece = piece;
  task.present = present_.data();
  task.facing = facing_.data();
  task.samples = projected_.data();
  task.face_of = face_of_.data();
  task.place = place_.data();
  for (size_t f = 0; f < static_cast<size_t>(plan.face_count); ++f) {
    faces_[f].axis = plan.faces[f].axis;
    faces_[f].sign = plan.faces[f].sign;
    std::copy_n(&plan.faces[f].rotation[0][0], 9, &faces_[f].rotation[0][0]);
  }
  CutIntoParts(piece, share_work);
  Each(share_work, parts_.size(), cancellation, [&](size_t i) { SamplePart(task, &parts_[i]); });
  if (absl::Status status = CancellationStatus(cancellation, kRendering); !status.ok()) return status;
  const auto add_counts = [this] {
    SampleCounts counts;
    for (const Part& part : parts_) counts.Add(part.counts);
    return counts;
  };
  SetUpFaces(plan, add_counts());
  if (!Count(task, share_work, cancellation)) return out_of_memory();
  if (absl::Status status = CancellationStatus(cancellation, kRendering); !status.ok()) return status;
  totals->counts = add_counts();
  totals->milliseconds.project = watch.Lap();
  if (plan.face_count == 1 && totals->counts.off_face > 0) return absl::OkStatus();

  MeasureFaces(plan, totals->counts);
  CutIntoBands(plan, share_work);
  Sort(task, share_work, cancellation);
  if (absl::Status status = CancellationStatus(cancellation, kRendering); !status.ok()) return status;
  if (request.method == MaskMethod::kBsp) SortByBsp(task, cancellation);
  if (absl::Status status = CancellationStatus(cancellation, kRendering); !status.ok()) return status;
  totals->milliseconds.sort = watch.Lap();

  std::atomic<bool> no_memory{false};
  Each(share_work, bands_.size(), cancellation, [&](size_t i) {
    if (!WalkBand(request, plan, boxes, casters, task.samples, bands_[i]))
      no_memory.store(true, std::memory_order_relaxed);
  });
  if (absl::Status status = CancellationStatus(cancellation, kRendering); !status.ok()) return status;
  if (no_memory.load()) return out_of_memory();
  totals->milliseconds.walk = watch.Lap();

  std::atomic<size_t> shadowed{0};
  Each(share_work, parts_.size(), cancellation, [&](size_t i) {
    shadowed.fetch_add(Resolve(task, parts_[i].lines, casters.channels, images), std::memory_order_relaxed);
  });
  totals->shadowed = shadowed.load();
  totals->undecided = CountUndecided();
  if (images.coverage != nullptr) ResolveCoverage(task, images);
  totals->milliseconds.resolve = watch.Lap();
  return absl::OkStatus();
}

size_t PieceRenderer::MemoryBytes() const {
  size_t bytes = 0;
  for (const BandScratch& scratch : scratch_)
    bytes += scratch.samples.MemoryBytes() + scratch.depths.MemoryBytes();
  for (const Part& part : parts_) bytes += part.plan.capacity() * sizeof(PlanSample);
  return bytes + projected_.MemoryBytes() + face_of_.MemoryBytes() + present_.MemoryBytes() +
         facing_.MemoryBytes() + bits_.MemoryBytes() + place_.MemoryBytes() + order_.MemoryBytes() +
         next_.MemoryBytes() + cell_start_.MemoryBytes() + shadow_.MemoryBytes() + touched_.MemoryBytes() +
         touched_twice_.MemoryBytes() + absorbance_.MemoryBytes() + bsp_uvd_.capacity() * sizeof(glm::vec3) +
         (bsp_order_.capacity() + bsp_slots_.capacity()) * sizeof(uint32_t);
}

}  // namespace shadowfit::irregular
