#include "client/demo/demo.h"

#include <algorithm>
#include <chrono>
#include <memory>
#include <optional>
#include <utility>

#include "absl/strings/str_format.h"
#include "client/demo/frame_loop.h"
#include "client/demo/output_files.h"
#include "client/demo/report.h"
#include "client/render/renderer.h"
#include "core/reference/shadow_map_test.h"
#include "core/reference/truth_scene.h"

namespace shadowfit {
namespace {

namespace fs = std::filesystem;
using SteadyClock = std::chrono::steady_clock;

double MillisecondsSince(SteadyClock::time_point start) {
  return std::chrono::duration<double, std::milli>(SteadyClock::now() - start).count();
}

/// The methods that are compared: what a renderer does without the service, and what the service offers.
struct ComparedMethod {
  const char* name;
  v1::Method method;
  bool from_service;
};
constexpr ComparedMethod kMethods[] = {{"normal", v1::METHOD_NORMAL, false},
                                       {"focused", v1::METHOD_FOCUSED, false},
                                       {"paper", v1::METHOD_PAPER, true},
                                       {"default", v1::METHOD_DEFAULT, true}};
constexpr size_t kNormal = 0;
constexpr size_t kBefore = 1;
constexpr size_t kAfter = 3;

class Demo {
 public:
  Demo(const Scene& scene, Client& client, const DemoOptions& options, fs::path out)
      : scene_(scene), client_(client), options_(options), out_(std::move(out)) {}

  absl::StatusOr<DemoResult> Run(const std::function<void(int, int)>& on_frame) {
    if (absl::Status status = Prepare(); !status.ok()) return status;
    // The first frame stands still until answers arrive, as a viewer would who has just entered.
    for (size_t m = 0; m < loops_.size(); ++m) {
      for (int i = 0; i <= loops_[m]->options().latency; ++i) {
        const absl::StatusOr<FrameTrace> trace = loops_[m]->Step(walk_.cameras[0]);
        if (!trace.ok()) return trace.status();
      }
    }
    for (size_t frame = 0; frame < walk_.cameras.size(); ++frame) {
      if (absl::Status status = RunFrame(frame); !status.ok()) return status;
      on_frame(static_cast<int>(frame) + 1, options_.frames);
    }
    result_.resolution = resolution_study_->figures();
    result_.masks = mask_study_->figures();
    if (absl::Status status = WriteResults(); !status.ok()) return status;
    return std::move(result_);
  }

 private:
  absl::Status Prepare() {
    if (options_.frames < 1 || options_.frames > 100'000) {
      return absl::InvalidArgumentError(
          absl::StrFormat("frames: %d, 1 to 100000 are accepted", options_.frames));
    }
    if (options_.lights < 1 || options_.lights > kMaxLights) {
      return absl::InvalidArgumentError(
          absl::StrFormat("lights: %d, 1 to %d are accepted", options_.lights, kMaxLights));
    }
    if (absl::Status status = MakeFolder(out_ / "frames"); !status.ok()) return status;

    RendererOptions renderer_options;
    renderer_options.screen = options_.screen;
    absl::StatusOr<std::unique_ptr<Renderer>> renderer = Renderer::Create(scene_, renderer_options);
    if (!renderer.ok()) return renderer.status();
    renderer_ = *std::move(renderer);
    absl::StatusOr<TruthScene> truth = TruthScene::Create(scene_);
    if (!truth.ok()) return truth.status();
    truth_ = *std::move(truth);

    walk_ = PlanWalk(scene_, options_.frames, options_.lights,
                     static_cast<double>(options_.screen.width) / options_.screen.height);
    absl::StatusOr<std::unique_ptr<ResolutionStudy>> study =
        ResolutionStudy::Create(renderer_.get(), walk_, options_.resolution_frames);
    if (!study.ok()) return study.status();
    resolution_study_ = *std::move(study);
    absl::StatusOr<std::unique_ptr<MaskStudy>> mask_study = MaskStudy::Create(&client_, scene_, walk_);
    if (!mask_study.ok()) return mask_study.status();
    mask_study_ = *std::move(mask_study);
    result_.scene = scene_.name;
    for (const SceneLight& light : walk_.lights) {
      absl::StatusOr<RaySpace> ray_space = RaySpace::Create(light.light);
      if (!ray_space.ok()) return ray_space.status();
      ray_spaces_.push_back(*std::move(ray_space));
      result_.light_names.push_back(light.name);
    }
    for (const ComparedMethod& method : kMethods) {
      FrameLoopOptions loop_options;
      loop_options.method = method.method;
      loop_options.map_size = options_.map_size;
      if (method.from_service) {
        loop_options.latency = options_.latency;
      } else {
        loop_options.latency = 0;
        loop_options.guard_band = 0.0;
        loop_options.standard_maps_every = 0;  // These methods do not look at bits.
      }
      FrameStreamOptions stream_options;
      stream_options.max_in_flight = loop_options.latency + 1;
      stream_options.frame_timeout = std::chrono::seconds(30);
      absl::StatusOr<std::unique_ptr<FrameLoop>> loop =
          FrameLoop::Create(renderer_.get(), walk_.lights, client_.OpenStream(stream_options), loop_options);
      if (!loop.ok()) return loop.status();
      loops_.push_back(*std::move(loop));
      WalkRecord record;
      record.name = method.name;
      record.latency = loop_options.latency;
      result_.records.push_back(std::move(record));
    }
    return absl::OkStatus();
  }

  absl::Status RunFrame(size_t frame) {
    const CameraMatrices& matrices = walk_.cameras[frame];
    const absl::StatusOr<Camera> camera = Camera::Create(matrices);
    if (!camera.ok()) return camera.status();
    const VisibleSurface surface =
        truth_->RenderSurface(*camera, options_.screen.width, options_.screen.height);
    std::vector<ShadowMask> truth;
    truth.reserve(ray_spaces_.size());
    for (const RaySpace& ray_space : ray_spaces_) truth.push_back(truth_->TrueShadow(surface, ray_space));

    std::optional<ReportFrame> report;
    if (IsReported(frame)) report.emplace(ReportFrame{static_cast<int>(frame), {}, {}, {}, {}, {}, 0, 0});
    std::vector<uint8_t> wrong_before(surface.size(), 0);
    for (size_t m = 0; m < loops_.size(); ++m) {
      FrameLoop& loop = *loops_[m];
      WalkRecord& record = result_.records[m];
      const SteadyClock::time_point start = SteadyClock::now();
      absl::StatusOr<FrameTrace> trace = loop.Step(matrices);
      if (!trace.ok()) return trace.status();
      if (m == kAfter) {
        if (absl::Status status = DrawFrame(frame, *camera, loop.maps(), start, &record); !status.ok())
          return status;
      }
      AddTimes(*trace, &record);
      record.AddMatrices(loop.maps().lights());

      std::vector<uint8_t> wrong(surface.size(), 0);
      const absl::StatusOr<std::vector<ShadowMask>> by_map =
          CountWrong(surface, truth, loop.maps(), &record, &wrong);
      if (!by_map.ok()) return by_map.status();
      if (!report || (m != kBefore && m != kAfter)) continue;
      absl::StatusOr<Picture> smooth = renderer_->DrawPicture(*camera, loop.maps(), /*antialiased=*/true);
      if (!smooth.ok()) return smooth.status();
      (m == kBefore ? report->before : report->after) = *std::move(smooth);
      (m == kBefore ? report->wrong_before : report->wrong_after) = record.FrameTotal(frame);
      if (m == kBefore) {
        wrong_before = wrong;
      } else {
        report->difference = DifferencePicture(report->after, wrong_before, wrong);
        const absl::StatusOr<std::vector<ShadowMask>> exact =
            mask_study_->AddFrame(frame, matrices, surface, truth, *by_map);
        if (!exact.ok()) return exact.status();
        report->shadows_by_map = ShadowPicture(surface, *by_map);
        report->shadows_by_mask = ShadowPicture(surface, *exact);
      }
    }
    if (report) report_frames_.push_back(*std::move(report));
    return resolution_study_->AddFrame(frame, matrices, surface.Depth(), loops_[kNormal]->maps().lights());
  }

  /// The picture that a viewer would see, for which alone a frame rate is measured.
  absl::Status DrawFrame(size_t frame, const Camera& camera, const ShadowMaps& maps,
                         SteadyClock::time_point frame_start, WalkRecord* record) {
    const SteadyClock::time_point start = SteadyClock::now();
    const absl::StatusOr<Picture> picture = renderer_->DrawPicture(camera, maps);
    if (!picture.ok()) return picture.status();
    record->picture_ms.push_back(MillisecondsSince(start));
    record->frame_ms.push_back(MillisecondsSince(frame_start));
    return WritePng(out_ / "frames" / absl::StrFormat("%03d.png", frame), *picture);
  }

  /// Evenly spread over the walk, first and last frame among them.
  bool IsReported(size_t frame) const {
    const int shown = std::min(options_.report_pictures, options_.frames);
    for (int i = 0; i < shown; ++i) {
      const int at = shown > 1 ? i * (options_.frames - 1) / (shown - 1) : 0;
      if (frame == static_cast<size_t>(at)) return true;
    }
    return false;
  }

  static void AddTimes(const FrameTrace& trace, WalkRecord* record) {
    record->samples_ms.push_back(trace.samples_ms);
    record->wait_ms.push_back(trace.wait_ms);
    record->shadow_maps_ms.push_back(trace.shadow_maps_ms);
    if (trace.round_trip_ms) record->round_trip_ms.push_back(*trace.round_trip_ms);
    record->optimize_ms.insert(record->optimize_ms.end(), trace.optimize_ms.begin(), trace.optimize_ms.end());
  }

  /// The exact map test with the very matrices that the maps were drawn with; its answers, one a light.
  absl::StatusOr<std::vector<ShadowMask>> CountWrong(const VisibleSurface& surface,
                                                     const std::vector<ShadowMask>& truth,
                                                     const ShadowMaps& maps, WalkRecord* record,
                                                     std::vector<uint8_t>* wrong) const {
    std::vector<ShadowMask> answers;
    std::vector<int>& counts = record->wrong_pixels.emplace_back();
    for (size_t light = 0; light < ray_spaces_.size(); ++light) {
      const LightView& view = maps.lights()[light];
      ShadowProjection projection;
      if (!ProjectionFromClip(ray_spaces_[light], view.clip_from_world, view.map_size, &projection)) {
        return absl::InternalError(absl::StrFormat(
            "%s, light %d: the matrix in the answer is not this light's", record->name, light));
      }
      absl::StatusOr<ShadowMask> mask =
          ShadowFromMaps(*truth_, surface, truth[light], ray_spaces_[light], std::span(&projection, 1));
      if (!mask.ok()) return mask.status();
      int count = 0;
      for (size_t i = 0; i < mask->size(); ++i) {
        if ((*mask)[i] == truth[light][i]) continue;
        ++count;
        (*wrong)[i] = 1;
      }
      counts.push_back(count);
      answers.push_back(*std::move(mask));
    }
    return answers;
  }

  absl::Status WriteResults() const {
    absl::Status status =
        WriteText(out_ / "matrices.json", MatricesJson(result_.scene, result_.records).dump());
    if (!status.ok()) return status;
    if (!report_frames_.empty()) {
      const ReportFrame& middle = report_frames_[report_frames_.size() / 2];
      status = WritePng(out_ / "comparison.png", SplitPicture(middle.before, middle.after));
      if (!status.ok()) return status;
    }
    const absl::StatusOr<std::string> html = ReportHtml(
        result_.scene, result_.light_names, result_.records, options_.map_size, report_frames_,
        result_.records[kBefore].name, result_.records[kAfter].name, result_.resolution, result_.masks);
    if (!html.ok()) return html.status();
    return WriteText(out_ / "report.html", *html);
  }

  const Scene& scene_;
  Client& client_;
  const DemoOptions options_;
  const fs::path out_;
  Walk walk_;
  std::unique_ptr<Renderer> renderer_;
  std::optional<TruthScene> truth_;
  std::vector<RaySpace> ray_spaces_;
  std::vector<std::unique_ptr<FrameLoop>> loops_;  // One a method; they die before the renderer.
  std::unique_ptr<ResolutionStudy> resolution_study_;
  std::unique_ptr<MaskStudy> mask_study_;
  std::vector<ReportFrame> report_frames_;
  DemoResult result_;
};

}  // namespace

absl::StatusOr<DemoResult> RunDemo(const Scene& scene, Client& client, const DemoOptions& options,
                                   const fs::path& out, const std::function<void(int, int)>& on_frame) {
  return Demo(scene, client, options, out).Run(on_frame);
}

}  // namespace shadowfit
