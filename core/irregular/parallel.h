#pragma once

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <cstddef>

#include "core/cancellation.h"

namespace shadowfit::irregular {

/// What is cancelled, as CancellationStatus() names it.
inline constexpr char kRendering[] = "the rendering of masks";

/// tbb::parallel_for over [0, count), one index a task, which skips what is left once cancelled.
template <typename Body>
void ForEach(size_t count, const Cancellation* cancellation, const Body& body) {
  tbb::parallel_for(
      tbb::blocked_range<size_t>(0, count, 1),
      [&](const tbb::blocked_range<size_t>& range) {
        for (size_t i = range.begin(); i != range.end(); ++i) {
          if (IsCancelled(cancellation)) return;
          body(i);
        }
      },
      tbb::simple_partitioner());
}

/// body(begin, end) on pieces of [0, count) that are worth a task; skips what is left once cancelled.
template <typename Body>
void ForEachPiece(size_t count, size_t piece, const Cancellation* cancellation, const Body& body) {
  const auto run = [&](size_t begin, size_t end) {
    if (!IsCancelled(cancellation)) body(begin, end);
  };
  if (count <= piece) {
    if (count > 0) run(size_t{0}, count);
    return;
  }
  tbb::parallel_for(tbb::blocked_range<size_t>(0, count, piece),
                    [&](const tbb::blocked_range<size_t>& range) { run(range.begin(), range.end()); });
}

}  // namespace shadowfit::irregular
