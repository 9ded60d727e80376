#pragma once

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace shadowfit::testing {

/// A program that runs beside the test. Killed when it goes out of scope.
class Process {
 public:
  explicit Process(std::vector<std::string> arguments) {
    int out[2];
    int error[2];
    if (pipe2(out, O_CLOEXEC) != 0 || pipe2(error, O_CLOEXEC) != 0) throw std::runtime_error("no pipe");
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, out[1], STDOUT_FILENO);
    posix_spawn_file_actions_adddup2(&actions, error[1], STDERR_FILENO);
    std::vector<char*> argv;
    for (std::string& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    const int failed = posix_spawn(&pid_, argv[0], &actions, nullptr, argv.data(), environ);
    posix_spawn_file_actions_destroy(&actions);
    close(out[1]);
    close(error[1]);
    out_ = out[0];
    error_ = error[0];
    if (failed != 0) {
      pid_ = -1;
      throw std::runtime_error("cannot start " + arguments[0]);
    }
  }
  ~Process() {
    if (pid_ > 0) {
      Signal(SIGKILL);
      Wait();
    }
    close(out_);
    close(error_);
  }
  Process(const Process&) = delete;
  Process& operator=(const Process&) = delete;

  pid_t pid() const { return pid_; }
  void Signal(int number) const { kill(pid_, number); }

  /// The exit code, or minus the signal that ended it.
  int Wait() {
    int status = 0;
    waitpid(pid_, &status, 0);
    pid_ = -1;
    return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  }

  /// As Wait(), with all that the program wrote.
  int WaitForOutput(std::string* out, std::string* error) {
    std::thread reader([this, error] { ReadAll(error_, error); });
    ReadAll(out_, out);
    reader.join();
    return Wait();
  }

  /// Reads standard error until `text` appears; the rest of its line, or nothing after `limit`.
  std::optional<std::string> ReadErrorAfter(const std::string& text,
                                            std::chrono::milliseconds limit = std::chrono::seconds(30)) {
    const auto until = std::chrono::steady_clock::now() + limit;
    while (true) {
      const size_t at = log_.find(text);
      const size_t end = at == std::string::npos ? at : log_.find('\n', at);
      if (end != std::string::npos) return log_.substr(at + text.size(), end - at - text.size());
      const auto left =
          std::chrono::duration_cast<std::chrono::milliseconds>(until - std::chrono::steady_clock::now());
      pollfd poll_error{error_, POLLIN, 0};
      if (left.count() <= 0 || poll(&poll_error, 1, static_cast<int>(left.count())) <= 0) return std::nullopt;
      char buffer[4096];
      const ssize_t count = read(error_, buffer, sizeof(buffer));
      if (count <= 0) return std::nullopt;
      log_.append(buffer, static_cast<size_t>(count));
    }
  }

 private:
  static void ReadAll(int descriptor, std::string* text) {
    char buffer[4096];
    ssize_t count = 0;
    while ((count = read(descriptor, buffer, sizeof(buffer))) > 0)
      text->append(buffer, static_cast<size_t>(count));
  }

  pid_t pid_ = -1;
  int out_ = -1;
  int error_ = -1;
  std::string log_;
};

/// Runs a program to its end.
struct Ran {
  explicit Ran(std::vector<std::string> arguments) {
    code = Process(std::move(arguments)).WaitForOutput(&out, &error);
  }
  int code = 0;
  std::string out;
  std::string error;
};

}  // namespace shadowfit::testing
