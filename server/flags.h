#pragma once

#include <CLI/CLI.hpp>

#include "server/options.h"

namespace shadowfit {

/// Adds a flag for each option, and `--config FILE`, whose keys are the flags' names; unknown keys are
/// errors.
void AddServerFlags(CLI::App& app, ServerOptions& options);

}  // namespace shadowfit
