#include "client/demo/progress.h"

#include <unistd.h>

#include <cstdio>
#include <utility>

namespace shadowfit {

ProgressBar::ProgressBar(std::string what, int total)
    : what_(std::move(what)),
      total_(total),
      terminal_(isatty(STDERR_FILENO) != 0),
      start_(std::chrono::steady_clock::now()) {}

ProgressBar::~ProgressBar() {
  if (terminal_ && done_ > 0) std::fputc('\n', stderr);
}

void ProgressBar::Step() {
  constexpr int kWidth = 40;
  ++done_;
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  const double left = seconds / done_ * (total_ - done_);
  if (terminal_) {
    const std::string bar = std::string(static_cast<size_t>(kWidth * done_ / total_), '#');
    std::fprintf(stderr, "\r%s [%-*s] %d/%d, %.0f s left ", what_.c_str(), kWidth, bar.c_str(), done_, total_,
                 left);
  } else if (done_ * 10 / total_ != (done_ - 1) * 10 / total_) {
    std::fprintf(stderr, "%s %d/%d, %.0f s left\n", what_.c_str(), done_, total_, left);
  }
  std::fflush(stderr);
}

}  // namespace shadowfit
