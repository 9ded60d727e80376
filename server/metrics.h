#pragma once

#include <prometheus/counter.h>
#include <prometheus/family.h>
#include <prometheus/histogram.h>
#include <prometheus/registry.h>

#include <cstddef>
#include <memory>
#include <string>

#include "absl/status/status.h"

namespace shadowfit {

/// What the service tells Prometheus: names begin with shadowfit_, units are seconds and bytes. Thread-safe.
class Metrics {
 public:
  Metrics();

  /// One request or streamed message that got its answer. Times are those of work that was started; others
  /// were turned away.
  void CountAnswer(const std::string& method, absl::StatusCode code);
  void ObserveWork(const std::string& method, double queue_seconds, double compute_seconds);
  void CountReceivedBytes(const std::string& method, size_t bytes);

  const std::shared_ptr<prometheus::Registry>& registry() const { return registry_; }

 private:
  std::shared_ptr<prometheus::Registry> registry_;
  prometheus::Family<prometheus::Counter>& answers_;
  prometheus::Family<prometheus::Histogram>& queue_seconds_;
  prometheus::Family<prometheus::Histogram>& compute_seconds_;
  prometheus::Family<prometheus::Counter>& received_bytes_;
};

}  // namespace shadowfit
