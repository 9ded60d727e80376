#include <cstdio>
#include <memory>
#include <string>

#include "absl/strings/str_format.h"
#include "client/cli/commands.h"
#include "client/cli/frame_files.h"
#include "client/embedded/service_connection.h"

namespace shadowfit {
namespace {

void PrintTable(const std::string& name, const v1::GetInfoResponse& info) {
  const v1::Limits& limits = info.limits();
  const v1::Load& load = info.load();
  constexpr double kMebibyte = 1 << 20;
  absl::PrintF("%-22s %s\n", "service", name);
  absl::PrintF("%-22s %s\n", "version", info.version());
  absl::PrintF("%-22s %.1f s%s\n", "up for", load.uptime_seconds(),
               load.draining() ? ", about to shut down" : "");
  absl::PrintF("%-22s %d\n", "workers", limits.workers());
  absl::PrintF("%-22s %.1f MiB\n", "largest request", limits.max_message_bytes() / kMebibyte);
  absl::PrintF("%-22s %d of %d\n", "requests under way", load.admitted_jobs(), limits.max_admitted_jobs());
  absl::PrintF("%-22s %.1f of %.1f MiB\n", "bytes under way", load.admitted_bytes() / kMebibyte,
               limits.max_admitted_bytes() / kMebibyte);
  absl::PrintF("%-22s %d of %d, %d frames each\n", "open streams", load.open_streams(), limits.max_streams(),
               limits.max_frames_in_stream());
  absl::PrintF("%-22s %d\n", "lights in a frame", limits.max_lights());
}

}  // namespace

void AddInfoCommand(CLI::App& app) {
  auto server = std::make_shared<std::string>();
  CLI::App* command = app.add_subcommand("info", "Print a service's version, limits and load");
  AddServerOption(*command, *server);
  command->callback([command, server] {
    const auto service = ValueOrThrow(ServiceConnection::Open(*server));
    const v1::GetInfoResponse info = ValueOrThrow(service->client().GetInfo());
    if (JsonRequested(*command)) {
      std::fputs(JsonFromMessage(info).c_str(), stdout);
    } else {
      PrintTable(service->client().name(), info);
    }
  });
}

}  // namespace shadowfit
