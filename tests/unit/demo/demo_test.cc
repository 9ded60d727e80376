#include "client/demo/demo.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <memory>
#include <string>

#include "client/demo/frame_loop.h"
#include "client/demo/output_files.h"
#include "client/demo/render_path.h"
#include "client/demo/report.h"
#include "client/embedded/service_connection.h"
#include "core/scene/procedural.h"

namespace shadowfit {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

std::string ReadText(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}

class DemoTest : public ::testing::Test {
 protected:
  DemoTest() : scene_(*MakePlaza(12000)) {
    std::string name = (fs::temp_directory_path() / "demo_test.XXXXXX").string();
    folder_ = mkdtemp(name.data());
    options_.frames = 3;
    options_.lights = 3;
    options_.screen = {160, 120};
    options_.map_size = {64, 64};
    options_.report_pictures = 2;
  }
  ~DemoTest() override { fs::remove_all(folder_); }

  void SetUp() override {
    absl::StatusOr<std::unique_ptr<ServiceConnection>> service = ServiceConnection::Open("");
    ASSERT_TRUE(service.ok()) << service.status();
    service_ = *std::move(service);
  }

  Scene scene_;
  DemoOptions options_;
  fs::path folder_;
  std::unique_ptr<ServiceConnection> service_;
};

TEST_F(DemoTest, WritesFramesReportAndRepeatableMatrices) {
  int frames = 0;
  const absl::StatusOr<DemoResult> result =
      RunDemo(scene_, service_->client(), options_, folder_ / "a", [&](int done, int total) {
        EXPECT_EQ(done, ++frames);
        EXPECT_EQ(total, 3);
      });
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(frames, 3);
  ASSERT_EQ(result->records.size(), 4u);
  for (const WalkRecord& record : result->records) {
    SCOPED_TRACE(record.name);
    ASSERT_EQ(record.wrong_pixels.size(), 3u);
    ASSERT_EQ(record.wrong_pixels[0].size(), 3u);
    EXPECT_GT(record.MeanPerFrame(), 0.0) << "maps this coarse are wrong somewhere";
    EXPECT_EQ(record.latency, record.name == "paper" || record.name == "default" ? 2 : 0);
    EXPECT_EQ(record.round_trip_ms.size(), 3u);
    EXPECT_EQ(record.optimize_ms.size(), 9u);
  }

  const nlohmann::json document = DemoJson(result->scene, result->light_names, result->records);
  EXPECT_EQ(document["scene"], "plaza");
  EXPECT_EQ(document["lights"], 3);
  for (const char* method : {"normal", "focused", "paper", "default"}) {
    EXPECT_TRUE(document["methods"][method]["meanWrongPixels"].is_number());
    EXPECT_TRUE(document["methods"][method]["worstTenPercent"]["focused"].is_number());
    EXPECT_TRUE(document["methods"][method]["medianMilliseconds"].is_number());
  }
  EXPECT_GT(document["roundTripMilliseconds"]["p50"], 0.0);
  EXPECT_GE(document["roundTripMilliseconds"]["p95"], document["roundTripMilliseconds"]["p50"]);
  EXPECT_THAT(DemoTable(result->light_names, result->records), HasSubstr("2 frames before"));

  const ResolutionFigures& figures = result->resolution;
  EXPECT_EQ(figures.frames, (std::vector<int>{0, 1, 2}));
  ASSERT_EQ(figures.lights.size(), 2u) << "the sun and the first spot";
  for (const ResolutionRecord& record : figures.lights) {
    for (size_t i = 0; i < 3; ++i) {
      EXPECT_GE(record.recommended[i], record.recommended_99[i] / 1.04);
      EXPECT_LE(record.recommended[i], figures.limit);
      EXPECT_GT(record.share_used[i], 0.0);
      EXPECT_LE(record.share_used[i], 110.0);
      EXPECT_GT(record.estimate_ms[i], 0.0);
      EXPECT_GT(record.fixed_ms[i], 0.0);
    }
  }
  EXPECT_EQ(ResolutionJson(figures)["lights"][1]["recommended"].size(), 3u);
  EXPECT_THAT(ResolutionTable(figures), HasSubstr(figures.lights[1].light));

  const MaskFigures& masks = result->masks;
  EXPECT_EQ(masks.frames, (std::vector<int>{0, 2}));
  ASSERT_EQ(masks.lights.size(), 3u);
  for (const MaskRecord& record : masks.lights) {
    for (size_t i = 0; i < masks.frames.size(); ++i) {
      const auto frame = static_cast<size_t>(masks.frames[i]);
      const auto light = static_cast<size_t>(&record - masks.lights.data());
      EXPECT_EQ(record.wrong_by_map[i], result->records[3].wrong_pixels[frame][light]);
      // A pixel or two in 19200 lie within the rounding of their depth from an edge.
      EXPECT_LE(record.wrong_by_mask[i], 20 + record.undecided[i]) << record.light;
      EXPECT_GT(record.mask_ms[i], 0.0);
    }
  }
  EXPECT_EQ(MaskJson(masks)["lights"][2]["wrongPixelsOfMask"].size(), 2u);
  EXPECT_THAT(MaskTable(masks), HasSubstr(masks.lights[2].light));

  for (const char* name : {"000.png", "001.png", "002.png"}) {
    EXPECT_EQ(ReadText(folder_ / "a/frames" / name).substr(1, 3), "PNG");
  }
  EXPECT_TRUE(fs::exists(folder_ / "a/comparison.png"));
  const std::string report = ReadText(folder_ / "a/report.html");
  EXPECT_THAT(report, HasSubstr("data:image/jpeg;base64,/9j/"));
  EXPECT_THAT(report, HasSubstr("<polyline"));
  EXPECT_THAT(report, HasSubstr("texels needed"));
  EXPECT_THAT(report, HasSubstr("wrong by mask"));
  EXPECT_THAT(report, ::testing::Not(HasSubstr("src=\"http"))) << "the report needs no other file";

  // What is drawn depends on the frames alone, not on how fast the service answers.
  const absl::StatusOr<DemoResult> again =
      RunDemo(scene_, service_->client(), options_, folder_ / "b", [](int, int) {});
  ASSERT_TRUE(again.ok()) << again.status();
  const std::string matrices = ReadText(folder_ / "a/matrices.json");
  EXPECT_EQ(matrices, ReadText(folder_ / "b/matrices.json"));
  EXPECT_EQ(nlohmann::json::parse(matrices)["methods"]["paper"].size(), 3u);
}

TEST_F(DemoTest, RefusesBadOptions) {
  DemoOptions options = options_;
  options.frames = 0;
  EXPECT_THAT(
      std::string(RunDemo(scene_, service_->client(), options, folder_, [](int, int) {}).status().message()),
      HasSubstr("frames: 0"));
  options = options_;
  options.lights = 33;
  EXPECT_THAT(
      std::string(RunDemo(scene_, service_->client(), options, folder_, [](int, int) {}).status().message()),
      HasSubstr("lights: 33"));
  std::ofstream(folder_ / "file") << "in the way";
  EXPECT_THAT(std::string(RunDemo(scene_, service_->client(), options_, folder_ / "file", [](int, int) {})
                              .status()
                              .message()),
              HasSubstr((folder_ / "file").string()));
}

TEST_F(DemoTest, RendersACameraPath) {
  absl::StatusOr<CameraPath> path = ParseCameraPath(R"({"width": 96, "height": 64,
    "shadowMap": {"width": 64, "height": 32},
    "frames": [{"eye": [12, -18, 3], "target": [0, 0, 2]}, {"eye": [12.2, -18, 3], "target": [0, 0, 2]}]})");
  ASSERT_TRUE(path.ok()) << path.status();
  const absl::StatusOr<RenderedPath> rendered =
      RenderPath(scene_, service_->client(), *path, v1::METHOD_PAPER, 1, folder_ / "path", [](int, int) {});
  ASSERT_TRUE(rendered.ok()) << rendered.status();
  EXPECT_EQ(rendered->frames, 2u);
  EXPECT_EQ(rendered->lights, 4u) << "the scene's own";
  EXPECT_EQ(ReadText(folder_ / "path/001.png").substr(1, 3), "PNG");
  EXPECT_TRUE(fs::exists(folder_ / "path/matrices.json"));
}

TEST_F(DemoTest, FrameLoopUsesTheAnswerOfItsLatency) {
  absl::StatusOr<std::unique_ptr<Renderer>> renderer = Renderer::Create(scene_, {{160, 120}, {96, 72}});
  ASSERT_TRUE(renderer.ok());
  const Walk walk = PlanWalk(scene_, 5, 2, 4.0 / 3.0);
  const auto matrices_with = [&](int latency) {
    FrameLoopOptions options;
    options.method = v1::METHOD_FOCUSED;  // Depends on the camera alone.
    options.map_size = {64, 64};
    options.latency = latency;
    options.guard_band = 0.0;
    FrameStreamOptions stream;
    stream.max_in_flight = latency + 1;
    auto loop =
        *FrameLoop::Create(renderer->get(), walk.lights, service_->client().OpenStream(stream), options);
    std::vector<glm::dmat4> matrices;
    for (const CameraMatrices& camera : walk.cameras) {
      const absl::StatusOr<FrameTrace> trace = loop->Step(camera);
      EXPECT_TRUE(trace.ok()) << trace.status();
      EXPECT_EQ(trace->round_trip_ms.has_value(), matrices.size() >= static_cast<size_t>(latency));
      matrices.push_back(loop->maps().lights()[0].clip_from_world);
    }
    return matrices;
  };
  const std::vector<glm::dmat4> at_once = matrices_with(0);
  const std::vector<glm::dmat4> later = matrices_with(2);
  for (size_t frame = 2; frame < 5; ++frame) EXPECT_EQ(later[frame], at_once[frame - 2]) << frame;
  EXPECT_NE(at_once[0], at_once[1]) << "the camera moved";
  EXPECT_EQ(later[0], at_once[0]) << "before the first answer, conventional maps";
}

TEST_F(DemoTest, FrameLoopEndsWhenTheServiceIsGone) {
  absl::StatusOr<std::unique_ptr<Renderer>> renderer = Renderer::Create(scene_, {{160, 120}, {96, 72}});
  ASSERT_TRUE(renderer.ok());
  const Walk walk = PlanWalk(scene_, 3, 2, 4.0 / 3.0);
  FrameLoopOptions options;
  options.map_size = {64, 64};
  auto stream = service_->client().OpenStream({});
  FrameStream* running = stream.get();
  auto loop = *FrameLoop::Create(renderer->get(), walk.lights, std::move(stream), options);
  ASSERT_TRUE(loop->Step(walk.cameras[0]).ok());
  running->Cancel();
  absl::Status status;
  for (int i = 0; i < 4 && status.ok(); ++i) status = loop->Step(walk.cameras[1]).status();
  EXPECT_FALSE(status.ok());
  EXPECT_FALSE(status.message().empty());
}

TEST(GuardBandTest, WidensTheFrustum) {
  const CameraMatrices camera = PlanWalk(Scene(), 1, 1, 1.5).cameras[0];
  const CameraMatrices wide = WithGuardBand(camera, 0.25);
  const Camera narrow_camera = *Camera::Create(camera);
  const Camera wide_camera = *Camera::Create(wide);
  glm::dvec4 ws = narrow_camera.WsFromNdc({1.0, -0.5, 0.3});
  const glm::dvec4 clip = wide_camera.clip_from_world() * ws;
  EXPECT_NEAR(clip.x / clip.w, 1.0 / 1.5, 1e-9);
  EXPECT_NEAR(clip.y / clip.w, -0.5 / 1.5, 1e-9);
  EXPECT_NEAR(clip.z / clip.w, 0.3, 1e-9);
}

TEST(ReportTest, DifferenceColoursSayWhoIsWrong) {
  const Picture picture{4, 1, {90, 90, 90, 90, 90, 90, 90, 90, 90, 90, 90, 90}};
  const Picture difference = DifferencePicture(picture, {0, 1, 0, 1}, {0, 0, 1, 1});
  EXPECT_EQ(difference.rgb[0], difference.rgb[1]);
  EXPECT_GT(difference.rgb[3], 2 * difference.rgb[5]) << "red: wrong before";
  EXPECT_GT(difference.rgb[8], 2 * difference.rgb[6]) << "blue: wrong after";
  EXPECT_EQ(difference.rgb[9], 255);
  EXPECT_EQ(difference.rgb[10], 255);
}

TEST(ReportTest, SplitPictureTakesAHalfOfEach) {
  const Picture left{4, 2, std::vector<uint8_t>(24, 10)};
  const Picture right{4, 2, std::vector<uint8_t>(24, 20)};
  const Picture split = SplitPicture(left, right);
  for (const size_t row : {0u, 12u}) {
    EXPECT_EQ(split.rgb[row + 5], 10);
    EXPECT_EQ(split.rgb[row + 6], 255);
    EXPECT_EQ(split.rgb[row + 9], 20);
  }
}

TEST(OutputFilesTest, FailuresNameTheFile) {
  const Picture picture{1, 1, {1, 2, 3}};
  EXPECT_THAT(std::string(WritePng("/nonexistent/x.png", picture).message()),
              HasSubstr("/nonexistent/x.png"));
  EXPECT_THAT(std::string(WriteText("/nonexistent/x.txt", "").message()), HasSubstr("/nonexistent/x.txt"));
  EXPECT_FALSE(MakeFolder("/proc/shadowfit").ok());
}

}  // namespace
}  // namespace shadowfit
