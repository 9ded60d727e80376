#include <gtest/gtest.h>
#include <stdlib.h>

#include <filesystem>
#include <fstream>
#include <string>

#include "client/client.h"
#include "tests/process/server_process.h"

namespace shadowfit {
namespace {

using testing::Ran;
using testing::ServerProcess;

class TemporaryFolder {
 public:
  TemporaryFolder() {
    char folder[] = "/tmp/shadowfit_process_XXXXXX";
    path_ = mkdtemp(folder);
  }
  ~TemporaryFolder() { std::filesystem::remove_all(path_); }
  std::string operator/(const std::string& name) const { return path_ + "/" + name; }

 private:
  std::string path_;
};

std::string Write(const std::string& path, const std::string& text) {
  std::ofstream(path) << text;
  return path;
}

TEST(ServerProgram, TakesItsFlagsFromAFileToo) {
  const TemporaryFolder folder;
  const std::string config =
      Write(folder / "server.toml", "workers = 3\nmax-message-bytes = \"8MiB\"\nlame-duck-seconds = 0.0\n");
  ServerProcess server({"--config", config, "--max-admitted-jobs", "5"});
  const auto client = Client::Connect(server.address());
  ASSERT_TRUE(client.ok()) << client.status();
  const auto info = (*client)->GetInfo();
  ASSERT_TRUE(info.ok()) << info.status();
  EXPECT_EQ(info->limits().workers(), 3U);
  EXPECT_EQ(info->limits().max_message_bytes(), 8U << 20);
  EXPECT_EQ(info->limits().max_admitted_jobs(), 5U);
}

TEST(ServerProgram, ChecksItsConfiguration) {
  const TemporaryFolder folder;
  const auto check = [&](const std::string& text) {
    return Ran({SHADOWFIT_SERVER_PROGRAM, "--check-config", "--config", Write(folder / "server.toml", text)});
  };
  EXPECT_EQ(check("workers = 2\nlisten = [\"127.0.0.1:1\", \"unix:/tmp/x\"]\n").code, 0);
  const Ran unknown = check("wrkers = 2\n");
  EXPECT_NE(unknown.code, 0);
  EXPECT_NE(unknown.error.find("wrkers"), std::string::npos) << unknown.error;
  const Ran malformed = check("workers = \"many\"\n");
  EXPECT_NE(malformed.code, 0);
  EXPECT_NE(malformed.error.find("workers"), std::string::npos) << malformed.error;
  const Ran refused = check("listen = [\"0.0.0.0:1\"]\n");
  EXPECT_NE(refused.code, 0);
  EXPECT_NE(refused.error.find("--allow-plaintext"), std::string::npos) << refused.error;
  EXPECT_EQ(check("listen = [\"0.0.0.0:1\"]\nallow-plaintext = true\n").code, 0);
  EXPECT_NE(Ran({SHADOWFIT_SERVER_PROGRAM, "--check-config", "--config", folder / "absent.toml"}).code, 0);
}

TEST(ServerProgram, SaysWhyItCannotStart) {
  ServerProcess first;
  const Ran second({SHADOWFIT_SERVER_PROGRAM, "--listen", first.address()});
  EXPECT_EQ(second.code, 1);
  EXPECT_NE(second.error.find("cannot bind " + first.address()), std::string::npos) << second.error;
}

TEST(ServerProgram, ListensOnAUnixSocket) {
  const TemporaryFolder folder;
  const std::string socket = "unix:" + (folder / "socket");
  ServerProcess server({socket});
  const auto client = Client::Connect(socket);
  ASSERT_TRUE(client.ok()) << client.status();
  EXPECT_TRUE((*client)->GetInfo().ok());
}

}  // namespace
}  // namespace shadowfit
