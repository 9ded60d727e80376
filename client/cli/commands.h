#pragma once

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/client.h"

namespace shadowfit {

// Each command is one file: <name>_command.cc with `void Add<Name>Command(CLI::App& app)`, which adds a
// subcommand whose callback runs it. A command prints a table for people, or one JSON document with --json,
// on stdout; everything else goes to the log, which is stderr. It fails by `ThrowIfError` (exit code 1) or by
// throwing CLI::ValidationError (a wrong argument).

// Declare the commands here, in alphabetical order, and call them in main.cc.
void AddCompareCommand(CLI::App& app);
void AddDemoCommand(CLI::App& app);
void AddInfoCommand(CLI::App& app);
void AddMaskCommand(CLI::App& app);
void AddOptimizeCommand(CLI::App& app);
void AddRenderCommand(CLI::App& app);
void AddResolutionCommand(CLI::App& app);
void AddSceneCommand(CLI::App& app);

/// Whether the global flag --json was given, before or behind the command's name.
bool JsonRequested(const CLI::App& command);

/// Adds `--server ADDR` to a command that talks to the service: "HOST:PORT" or "unix:PATH"; without it,
/// `address` stays empty and the command runs the service in its own process.
CLI::Option* AddServerOption(CLI::App& command, std::string& address);

/// Adds `--timeout SECONDS` to a command that calls the service; `seconds` holds the default.
CLI::Option* AddTimeoutOption(CLI::App& command, double& seconds);

/// What such a call is made with.
CallOptions CallWithin(double seconds);

/// Writes one indented JSON document to stdout.
void PrintJson(const nlohmann::json& document);

/// Logs the error and ends the program with exit code 1.
void ThrowIfError(const absl::Status& status);

template <typename T>
T ValueOrThrow(absl::StatusOr<T> value) {
  ThrowIfError(value.status());
  return *std::move(value);
}

}  // namespace shadowfit
