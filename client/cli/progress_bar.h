#pragma once

#include <chrono>
#include <string>

namespace shadowfit {

/// A progress bar on stderr: redrawn in place on a terminal, a line every tenth of the way elsewhere.
class ProgressBar {
 public:
  explicit ProgressBar(std::string label);
  ~ProgressBar();
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;

  /// done <= total.
  void Show(int done, int total);

 private:
  std::string label_;
  bool terminal_;
  bool shown_ = false;
  int tenth_ = -1;
  std::chrono::steady_clock::time_point start_;
  std::chrono::steady_clock::time_point last_;
};

}  // namespace shadowfit
