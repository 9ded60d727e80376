#include <google/protobuf/util/json_util.h>
#include <gtest/gtest.h>
#include <stdlib.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <memory>
#include <string>
#include <vector>

#include "core/fit/frame_optimizer.h"
#include "shadowfit/v1/info.pb.h"
#include "shadowfit/v1/resolution.pb.h"
#include "tests/process/server_process.h"
#include "tests/support/wire_frame.h"
// Behind Protobuf, whose headers need byte-swap macros that OpenImageIO takes away.
#include "tests/support/write_exr.h"

namespace shadowfit {
namespace {

using testing::MatrixBytes;
using testing::OwnedFrame;
using testing::Ran;
using testing::ServerProcess;
using testing::WriteExr;

class Commands : public ::testing::Test {
 protected:
  Commands() {
    char folder[] = "/tmp/shadowfit_commands_XXXXXX";
    folder_ = mkdtemp(folder);
  }
  ~Commands() override { std::filesystem::remove_all(folder_); }

  /// 32 lights, so that bits need all 32 of their digits.
  void WriteFrameFiles() {
    owned_ = testing::RandomFrame(21, 64, 48, 32);
    for (size_t i = 0; i < owned_.bits.size(); i += 7) owned_.bits[i] ^= 0x80000001U;
    v1::Frame frame = testing::WireFrame(77, owned_.request);
    frame.clear_depth();
    frame.clear_shadow_bits();
    std::string json;
    ASSERT_TRUE(google::protobuf::util::MessageToJsonString(frame, &json).ok());
    Write("frame.json", json);
    WriteExr(Path("depth.exr"), OIIO::TypeDesc::FLOAT, owned_.request.depth);
    WriteExr(Path("bits.exr"), OIIO::TypeDesc::UINT32, *owned_.request.bits);
    FrameOptimizer optimizer;
    FrameSummary summary;
    ASSERT_TRUE(optimizer.Optimize(owned_.request, options_, Cancellation(), &summary).ok());
    expected_ = MatrixBytes(summary);
  }

  std::string Path(const std::string& name) const { return folder_ + "/" + name; }
  void Write(const std::string& name, const std::string& text) const { std::ofstream(Path(name)) << text; }
  std::string Read(const std::string& name) const {
    std::ifstream file(Path(name));
    return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  }

  std::vector<std::string> With(std::vector<std::string> program, std::vector<std::string> more) const {
    program.insert(program.end(), {"--frame", Path("frame.json"), "--depth", Path("depth.exr"), "--bits",
                                   Path("bits.exr"), "--out", Path("result.json")});
    program.insert(program.end(), more.begin(), more.end());
    return program;
  }

  void ExpectResult(const std::string& json) const {
    v1::FrameResult result;
    const auto parsed = google::protobuf::util::JsonStringToMessage(json, &result);
    ASSERT_TRUE(parsed.ok()) << parsed.ToString() << "\n" << json;
    EXPECT_EQ(result.frame_id(), 77U);
    EXPECT_EQ(result.lights_size(), 32);
    EXPECT_EQ(MatrixBytes(result), expected_);
  }

  std::string folder_;
  OwnedFrame owned_;
  Options options_;
  std::string expected_;
};

TEST_F(Commands, OptimizeGivesCoresMatricesEmbeddedAndOverTheWire) {
  WriteFrameFiles();
  const Ran embedded(With({SHADOWFIT_PROGRAM, "optimize"}, {}));
  ASSERT_EQ(embedded.code, 0) << embedded.error;
  ExpectResult(Read("result.json"));
  EXPECT_NE(embedded.out.find("wrong pixels"), std::string::npos) << embedded.out;
  EXPECT_NE(embedded.out.find("Safe bias"), std::string::npos) << embedded.out;
  EXPECT_NE(Read("result.json").find("\"receiverPlaneConstant\""), std::string::npos);

  ServerProcess server;
  std::filesystem::remove(Path("result.json"));
  const Ran over_tcp(With({SHADOWFIT_PROGRAM, "optimize"}, {"--server", server.address(), "--json"}));
  ASSERT_EQ(over_tcp.code, 0) << over_tcp.error;
  ExpectResult(Read("result.json"));
  ExpectResult(over_tcp.out);  // The document and nothing else.
}

TEST_F(Commands, FilesOfAFrameReproduceItsMatricesOnAnyNumberOfThreads) {
  WriteFrameFiles();
  for (const char* workers : {"1", "2", "8"}) {
    ServerProcess server({"--workers", workers});
    std::filesystem::remove(Path("result.json"));
    const Ran replayed(With({SHADOWFIT_PROGRAM, "optimize"}, {"--server", server.address()}));
    ASSERT_EQ(replayed.code, 0) << replayed.error;
    ExpectResult(Read("result.json"));
  }
}

TEST_F(Commands, OptimizeTakesItsKnobFromItsFlag) {
  WriteFrameFiles();
  const Ran wrong(With({SHADOWFIT_PROGRAM, "optimize"}, {"--keep-within", "0.5"}));
  EXPECT_EQ(wrong.code, 1);
  EXPECT_NE(wrong.error.find("options.keep_within: 0.5, "), std::string::npos) << wrong.error;
  const Ran never(With({SHADOWFIT_PROGRAM, "optimize"}, {"--keep-within", "0"}));
  EXPECT_EQ(never.code, 0) << never.error;
  ExpectResult(Read("result.json"));
}

TEST_F(Commands, OptimizeHoldsAllShadowByItsFlag) {
  options_.standard.hold_all_shadow = true;
  WriteFrameFiles();
  const Ran whole(With({SHADOWFIT_PROGRAM, "optimize"}, {"--hold-all-shadow"}));
  ASSERT_EQ(whole.code, 0) << whole.error;
  ExpectResult(Read("result.json"));
}

TEST_F(Commands, OptimizeTakesTheMethodFromItsFlag) {
  options_.method = Method::kPaper;
  WriteFrameFiles();
  const Ran paper(With({SHADOWFIT_PROGRAM, "optimize"}, {"--method", "paper"}));
  ASSERT_EQ(paper.code, 0) << paper.error;
  ExpectResult(Read("result.json"));
  const Ran unheard(With({SHADOWFIT_PROGRAM, "optimize"}, {"--method", "unheard"}));
  EXPECT_NE(unheard.code, 0);
  EXPECT_NE(unheard.error.find("plane_optimal"), std::string::npos) << unheard.error;
}

TEST_F(Commands, OptimizeSharesABudget) {
  WriteFrameFiles();
  const Ran shared(With({SHADOWFIT_PROGRAM, "optimize"}, {"--budget", "600000", "--atlas", "1024x1024",
                                                          "--rounding", "8", "--min-side", "32"}));
  ASSERT_EQ(shared.code, 0) << shared.error;
  EXPECT_NE(shared.out.find("in the atlas at"), std::string::npos) << shared.out;
  v1::FrameResult result;
  ASSERT_TRUE(google::protobuf::util::JsonStringToMessage(Read("result.json"), &result).ok());
  uint64_t texels = 0;
  for (const v1::LightResult& light : result.lights()) {
    EXPECT_EQ(light.shadow_map().width() % 8, 0U);
    EXPECT_GE(light.shadow_map().width(), 32U);
    EXPECT_TRUE(light.has_atlas_position());
    EXPECT_NE(light.quality().worst(), v1::MAP_FLAW_UNSPECIFIED);
    texels += uint64_t{light.shadow_map().width()} * light.shadow_map().height();
  }
  EXPECT_LE(texels, 600000U);
  EXPECT_GE(texels, 500000U);

  const Ran tolerant(With({SHADOWFIT_PROGRAM, "optimize"}, {"--tolerance", "40", "--max-side", "512"}));
  ASSERT_EQ(tolerant.code, 0) << tolerant.error;
  ASSERT_TRUE(google::protobuf::util::JsonStringToMessage(Read("result.json"), &result).ok());
  for (const v1::LightResult& light : result.lights()) EXPECT_LE(light.shadow_map().width(), 512U);

  const Ran both(With({SHADOWFIT_PROGRAM, "optimize"}, {"--tolerance", "40", "--budget", "512"}));
  EXPECT_NE(both.code, 0);
  const Ran little(With({SHADOWFIT_PROGRAM, "optimize"}, {"--budget", "512"}));
  EXPECT_EQ(little.code, 1);
  EXPECT_NE(little.error.find("options.texel_budget.total_texels: 512 "), std::string::npos) << little.error;
}

#ifdef SHADOWFIT_PYTHON
TEST_F(Commands, ThePythonScriptGivesTheSameMatrices) {
  WriteFrameFiles();
  ServerProcess server;
  setenv("PYTHONPATH", SHADOWFIT_PYTHON_MODULES, 1);
  const Ran python(
      With({SHADOWFIT_PYTHON, SHADOWFIT_PYTHON_SCRIPT}, {"--server", server.address(), "--json"}));
  ASSERT_EQ(python.code, 0) << python.error;
  ExpectResult(Read("result.json"));
  ExpectResult(python.out);

  const Ran shared(
      With({SHADOWFIT_PYTHON, SHADOWFIT_PYTHON_SCRIPT},
           {"--server", server.address(), "--atlas", "1024x1024", "--rounding", "power_of_two"}));
  EXPECT_EQ(shared.code, 0) << shared.error;
  v1::FrameResult sized;
  ASSERT_TRUE(google::protobuf::util::JsonStringToMessage(Read("result.json"), &sized).ok());
  EXPECT_TRUE(sized.lights(0).has_atlas_position());

  const Ran nobody(With({SHADOWFIT_PYTHON, SHADOWFIT_PYTHON_SCRIPT}, {"--server", "127.0.0.1:1"}));
  EXPECT_EQ(nobody.code, 1);
  EXPECT_EQ(nobody.error.find("UNAVAILABLE: 127.0.0.1:1: "), 0U) << nobody.error;
}
#endif

TEST_F(Commands, OptimizeFailsWithTheReason) {
  WriteFrameFiles();
  Write("frame.json", "{}");
  const Ran ran(With({SHADOWFIT_PROGRAM, "optimize"}, {}));
  EXPECT_EQ(ran.code, 1);
  EXPECT_EQ(ran.out, "");
  EXPECT_NE(ran.error.find("camera: missing"), std::string::npos) << ran.error;
}

TEST_F(Commands, ResolutionOfACameraInTheLightsPlaceIsTheCamerasOwn) {
  WriteFrameFiles();
  // One light where the camera is, as wide as its picture.
  v1::Frame frame;
  ASSERT_TRUE(google::protobuf::util::JsonStringToMessage(Read("frame.json"), &frame).ok());
  const glm::dmat4 world_from_view = glm::inverse(owned_.request.camera.view_from_world);
  const double tangent = 1.0 / owned_.request.camera.clip_from_view[0][0];
  frame.clear_lights();
  v1::Light& light = *frame.add_lights();
  light.set_id(5);
  testing::SetVector(glm::dvec3(world_from_view[3]), light.mutable_spot()->mutable_position());
  testing::SetVector(-glm::dvec3(world_from_view[2]), light.mutable_spot()->mutable_direction());
  light.mutable_spot()->set_outer_half_angle(std::atan(tangent));
  std::string text;
  ASSERT_TRUE(google::protobuf::util::MessageToJsonString(frame, &text).ok());
  Write("frame.json", text);
  // A wall before all of the picture.
  const std::vector<float> wall(static_cast<size_t>(64) * 48, 0.5F);
  WriteExr(Path("depth.exr"), OIIO::TypeDesc::FLOAT, BottomFirst(wall.data(), 64, 48));

  const auto run = [this](std::vector<std::string> more) {
    std::vector<std::string> arguments = {SHADOWFIT_PROGRAM, "resolution",      "--frame", Path("frame.json"),
                                          "--depth",         Path("depth.exr"), "--json"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    const Ran ran(arguments);
    EXPECT_EQ(ran.code, 0) << ran.error;
    v1::ResolutionResult result;
    EXPECT_TRUE(google::protobuf::util::JsonStringToMessage(ran.out, &result).ok()) << ran.out;
    EXPECT_EQ(result.lights_size(), 1);
    return result.lights(0);
  };
  EXPECT_EQ(run({}).id(), 5U);
  EXPECT_EQ(run({}).recommended().width(), 64U);
  EXPECT_EQ(run({}).recommended().height(), 48U);
  EXPECT_EQ(run({"--max-size", "50"}).recommended().width(), 50U);
  EXPECT_EQ(run({"--max-size", "50"}).recommended().height(), 48U);
  EXPECT_EQ(run({"--rounding", "power_of_two"}).recommended().height(), 64U);
  EXPECT_GT(run({"--histogram"}).maps(0).histogram_x_size(), 0);

  const Ran table(
      {SHADOWFIT_PROGRAM, "resolution", "--frame", Path("frame.json"), "--depth", Path("depth.exr")});
  EXPECT_EQ(table.code, 0) << table.error;
  EXPECT_NE(table.out.find("64x48"), std::string::npos) << table.out;
  const Ran zero({SHADOWFIT_PROGRAM, "resolution", "--frame", Path("frame.json"), "--depth",
                  Path("depth.exr"), "--max-size", "0"});
  EXPECT_NE(zero.code, 0);
}

TEST_F(Commands, InfoTellsOfAServer) {
  ServerProcess server({"--workers", "3"});
  const Ran json({SHADOWFIT_PROGRAM, "--json", "info", "--server", server.address()});
  ASSERT_EQ(json.code, 0) << json.error;
  v1::GetInfoResponse info;
  ASSERT_TRUE(google::protobuf::util::JsonStringToMessage(json.out, &info).ok()) << json.out;
  EXPECT_EQ(info.limits().workers(), 3U);
  const Ran table({SHADOWFIT_PROGRAM, "info", "--server", server.address()});
  EXPECT_NE(table.out.find(info.version()), std::string::npos) << table.out;
  const Ran nobody({SHADOWFIT_PROGRAM, "info", "--server", "127.0.0.1"});
  EXPECT_EQ(nobody.code, 1);
  EXPECT_NE(nobody.error.find("neither HOST:PORT nor unix:PATH"), std::string::npos) << nobody.error;
}

}  // namespace
}  // namespace shadowfit
