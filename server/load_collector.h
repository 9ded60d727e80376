#pragma once

#include <prometheus/collectable.h>
#include <prometheus/metric_family.h>

#include <vector>

#include "server/service_context.h"

namespace shadowfit {

/// The service's load as Prometheus gauges, read when they are asked for.
class LoadCollector final : public prometheus::Collectable {
 public:
  explicit LoadCollector(const ServiceContext& context) : context_(context) {}

  std::vector<prometheus::MetricFamily> Collect() const override;

 private:
  const ServiceContext& context_;
};

}  // namespace shadowfit
