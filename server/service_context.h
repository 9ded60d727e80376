#pragma once

#include <chrono>

#include "server/admission.h"
#include "server/mask_renderers.h"
#include "server/metrics.h"
#include "server/open_streams.h"
#include "server/options.h"
#include "server/scene_store.h"
#include "server/worker_pool.h"

namespace shadowfit {

/// What all services of one server share.
struct ServiceContext {
  explicit ServiceContext(const ServerOptions& server_options)
      : options(server_options),
        admission(options.max_admitted_bytes, options.max_admitted_jobs),
        scenes(options.max_scene_bytes),
        pool(options.workers) {}

  const ServerOptions options;
  const std::chrono::steady_clock::time_point started = std::chrono::steady_clock::now();
  Metrics metrics;
  Admission admission;
  OpenStreams streams;
  SceneStore scenes;
  MaskRenderers renderers;
  WorkerPool pool;  // Last: its jobs use all of the above.
};

}  // namespace shadowfit
