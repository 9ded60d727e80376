#pragma once

#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <cstddef>

namespace shadowfit {

/// Calls work(i) for every light of a frame, side by side on the threads of the caller's oneTBB arena: inside
/// tbb::task_arena(1) one after the other. Isolated, so that a thread that waits here for the last light does
/// not begin another frame meanwhile.
template <class Work>
void ForLights(size_t count, const Work& work) {
  if (count == 1) {
    work(size_t{0});
    return;
  }
  tbb::this_task_arena::isolate([&] { tbb::parallel_for(size_t{0}, count, work); });
}

}  // namespace shadowfit
