#include "server/load_collector.h"

#include <chrono>

namespace shadowfit {
namespace {

prometheus::MetricFamily Gauge(const char* name, const char* help, double value) {
  prometheus::ClientMetric metric;
  metric.gauge.value = value;
  return {name, help, prometheus::MetricType::Gauge, {metric}};
}

}  // namespace

std::vector<prometheus::MetricFamily> LoadCollector::Collect() const {
  const double uptime =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - context_.started).count();
  return {
      Gauge("shadowfit_admitted_bytes", "Bytes of requests that wait or are worked on.",
            static_cast<double>(context_.admission.bytes())),
      Gauge("shadowfit_admitted_jobs", "Requests that wait or are worked on.", context_.admission.jobs()),
      Gauge("shadowfit_open_streams", "Streams that are open.", context_.streams.count()),
      Gauge("shadowfit_draining", "1 while the service is about to shut down.",
            context_.streams.draining() ? 1 : 0),
      Gauge("shadowfit_uptime_seconds", "Since the service was started.", uptime),
  };
}

}  // namespace shadowfit
