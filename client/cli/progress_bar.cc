#include "client/cli/progress_bar.h"

#include <unistd.h>

#include <cstdio>
#include <utility>

namespace shadowfit {

using Clock = std::chrono::steady_clock;

ProgressBar::ProgressBar(std::string label)
    : label_(std::move(label)), terminal_(isatty(STDERR_FILENO) != 0), start_(Clock::now()), last_(start_) {}

ProgressBar::~ProgressBar() {
  if (terminal_ && shown_) std::fputc('\n', stderr);
}

void ProgressBar::Show(int done, int total) {
  constexpr int kWidth = 30;
  if (total <= 0) return;
  const Clock::time_point now = Clock::now();
  const double elapsed = std::chrono::duration<double>(now - start_).count();
  const double left = done > 0 ? elapsed * (total - done) / done : 0.0;
  if (!terminal_) {
    const int tenth = 10 * done / total;
    if (tenth == tenth_) return;
    tenth_ = tenth;
    std::fprintf(stderr, "%s: %d of %d, %.0f s\n", label_.c_str(), done, total, elapsed);
    return;
  }
  if (shown_ && done < total && now - last_ < std::chrono::milliseconds(100)) return;
  last_ = now;
  shown_ = true;
  const int filled = static_cast<int>(static_cast<long long>(kWidth) * done / total);
  std::fprintf(stderr, "\r%s [%s%s] %d/%d, %.0f s left \x1b[K", label_.c_str(),
               std::string(static_cast<size_t>(filled), '=').c_str(),
               std::string(static_cast<size_t>(kWidth - filled), ' ').c_str(), done, total, left);
  std::fflush(stderr);
}

}  // namespace shadowfit
