#include "server/metrics.h"

namespace shadowfit {
namespace {

// From a tenth of a millisecond to ten seconds, about three a decade.
const prometheus::Histogram::BucketBoundaries kSeconds = {
    0.0001, 0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0};

template <typename Metric, typename Builder>
prometheus::Family<Metric>& Register(Builder builder, prometheus::Registry& registry, const char* name,
                                     const char* help) {
  return builder.Name(name).Help(help).Register(registry);
}

}  // namespace

Metrics::Metrics()
    : registry_(std::make_shared<prometheus::Registry>()),
      answers_(Register<prometheus::Counter>(
          prometheus::BuildCounter(), *registry_, "shadowfit_answers_total",
          "Requests and streamed messages answered, by method and status code.")),
      queue_seconds_(
          Register<prometheus::Histogram>(prometheus::BuildHistogram(), *registry_, "shadowfit_queue_seconds",
                                          "From arrival of a request to the start of its computation.")),
      compute_seconds_(Register<prometheus::Histogram>(prometheus::BuildHistogram(), *registry_,
                                                       "shadowfit_compute_seconds",
                                                       "From start to end of a request's computation.")),
      received_bytes_(Register<prometheus::Counter>(prometheus::BuildCounter(), *registry_,
                                                    "shadowfit_received_bytes_total",
                                                    "Bytes of requests and streamed messages, by method.")) {}

void Metrics::CountAnswer(const std::string& method, absl::StatusCode code) {
  answers_.Add({{"method", method}, {"code", absl::StatusCodeToString(code)}}).Increment();
}

void Metrics::ObserveWork(const std::string& method, double queue_seconds, double compute_seconds) {
  queue_seconds_.Add({{"method", method}}, kSeconds).Observe(queue_seconds);
  compute_seconds_.Add({{"method", method}}, kSeconds).Observe(compute_seconds);
}

void Metrics::CountReceivedBytes(const std::string& method, size_t bytes) {
  received_bytes_.Add({{"method", method}}).Increment(static_cast<double>(bytes));
}

}  // namespace shadowfit
