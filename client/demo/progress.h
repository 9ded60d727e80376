#pragma once

#include <chrono>
#include <string>

namespace shadowfit {

/// A bar on stderr that is drawn over itself; plain lines at every tenth where stderr is no terminal.
class ProgressBar {
 public:
  ProgressBar(std::string what, int total);
  ~ProgressBar();
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;

  void Step();

 private:
  std::string what_;
  int total_;
  int done_ = 0;
  bool terminal_;
  std::chrono::steady_clock::time_point start_;
};

}  // namespace shadowfit
