#include "server/flags.h"

namespace shadowfit {

void AddServerFlags(CLI::App& app, ServerOptions& options) {
  options.listen = {"127.0.0.1:7380"};
  app.option_defaults()->always_capture_default();
  app.add_option("--listen", options.listen, "Addresses, HOST:PORT (port 0: any free one) or unix:PATH")
      ->type_name("ADDR");
  app.add_flag("--allow-plaintext", options.allow_plaintext,
               "Serve without encryption on addresses that other machines can reach");
  app.add_option("--workers", options.workers, "Requests worked on at a time; 0: one for each core");
  app.add_option("--max-message-bytes", options.max_message_bytes, "Largest request that is received")
      ->transform(CLI::AsSizeValue(false));
  app.add_option("--max-admitted-bytes", options.max_admitted_bytes,
                 "Bytes of requests that wait or are worked on; beyond them clients are told to try later")
      ->transform(CLI::AsSizeValue(false));
  app.add_option("--max-admitted-jobs", options.max_admitted_jobs,
                 "Requests that wait or are worked on, likewise");
  app.add_option("--max-scene-bytes", options.max_scene_bytes,
                 "Memory for uploaded scenes; those used longest ago make room for others")
      ->transform(CLI::AsSizeValue(false));
  app.add_option("--max-streams", options.max_streams, "Streams that may be open");
  app.add_option("--max-frames-in-stream", options.max_frames_in_stream,
                 "Frames of one stream that are held; the stream is not read beyond them");
  app.add_option("--lame-duck-seconds", options.lame_duck_seconds,
                 "On SIGTERM: time between saying NOT_SERVING and going");
  app.add_option("--drain-seconds", options.drain_seconds,
                 "On SIGTERM: when streams that do not end are ended");
  app.add_option("--metrics-listen", options.metrics_listen,
                 "Where Prometheus metrics are served under /metrics, HOST:PORT; empty: nowhere");
  app.set_config("--config", "",
                 "Read flags from a TOML file whose keys are their names, without the dashes");
  app.allow_config_extras(CLI::config_extras_mode::error);
}

}  // namespace shadowfit
