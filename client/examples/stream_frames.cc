// The shortest complete use of the client library: a render loop that streams what its camera sees and takes
// light matrices as they come. The picture is made by hand here: a floor, seen from above the ground, with
// the square shadow of a roof.
//
//   stream_frames HOST:PORT | unix:PATH

#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "client/client.h"

namespace {

constexpr uint64_t kFrames = 30;
constexpr int kSize = 180;

int Fail(const absl::Status& status) {
  std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return 1;
}

/// The camera stands at (0, 0, 2) and looks along +y, with a field of view of 90 degrees: view space has x to
/// the right, y up and z backwards.
void Describe(uint64_t frame_id, shadowfit::v1::Frame* frame) {
  constexpr double kNear = 0.1;
  constexpr double kFar = 100.0;
  constexpr double kEyeHeight = 2.0;
  frame->Clear();
  frame->set_frame_id(frame_id);
  for (const double entry :
       {1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -kEyeHeight, 0.0, 1.0}) {
    frame->mutable_camera()->mutable_view()->add_m(entry);
  }
  const double a = (kFar + kNear) / (kNear - kFar);
  const double b = 2.0 * kFar * kNear / (kNear - kFar);
  for (const double entry : {1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, a, -1.0, 0.0, 0.0, b, 0.0}) {
    frame->mutable_camera()->mutable_projection()->add_m(entry);
  }

  std::vector<float> depth(kSize * kSize, 1.0f);  // 1 is the far plane: background.
  std::vector<uint32_t> bits(kSize * kSize, 0);
  for (int row = 0; row < kSize; ++row) {
    const double ndc_y = (row + 0.5) * 2.0 / kSize - 1.0;
    if (ndc_y >= -kEyeHeight / kFar) continue;  // The horizon.
    const double distance = kEyeHeight / -ndc_y;
    const double ndc_z = -a + b / -distance;
    for (int column = 0; column < kSize; ++column) {
      const double x = ((column + 0.5) * 2.0 / kSize - 1.0) * distance;
      const auto pixel = static_cast<size_t>(row) * kSize + static_cast<size_t>(column);
      depth[pixel] = static_cast<float>(0.5 * ndc_z + 0.5);
      const double roof_x = 0.05 * static_cast<double>(frame_id);
      bits[pixel] = std::abs(x - roof_x) < 2.0 && std::abs(distance - 6.0) < 2.0 ? 1 : 0;
    }
  }
  frame->mutable_depth()->set_width(kSize);
  frame->mutable_depth()->set_height(kSize);
  frame->mutable_depth()->set_data(depth.data(), depth.size() * sizeof(float));
  frame->mutable_shadow_bits()->set_width(kSize);
  frame->mutable_shadow_bits()->set_height(kSize);
  frame->mutable_shadow_bits()->set_data(bits.data(), bits.size() * sizeof(uint32_t));

  shadowfit::v1::Light* sun = frame->add_lights();
  sun->set_id(1);
  sun->mutable_directional()->mutable_direction()->set_x(0.3);
  sun->mutable_directional()->mutable_direction()->set_y(0.2);
  sun->mutable_directional()->mutable_direction()->set_z(-1.0);
  sun->mutable_shadow_map()->set_width(512);
  sun->mutable_shadow_map()->set_height(512);
}

void Use(const shadowfit::FrameOutcome& outcome) {
  if (!outcome.result.ok()) {
    std::printf("frame %llu: %s\n", static_cast<unsigned long long>(outcome.frame_id),
                outcome.result.status().ToString().c_str());
    return;
  }
  const shadowfit::v1::LightResult& light = outcome.result->lights(0);
  std::printf("frame %llu: %.1f wrong pixels predicted, %.2f ms\n",
              static_cast<unsigned long long>(outcome.frame_id), light.predicted_misclassified_pixels(),
              std::chrono::duration<double, std::milli>(outcome.round_trip).count());
}

void RenderWithTheLatestMatrices() { std::this_thread::sleep_for(std::chrono::milliseconds(16)); }

int StreamFrames(const std::string& address) {
  absl::StatusOr<std::unique_ptr<shadowfit::Client>> client = shadowfit::Client::Connect(address);
  if (!client.ok()) return Fail(client.status());
  const std::unique_ptr<shadowfit::FrameStream> stream = (*client)->OpenStream();

  for (uint64_t frame_id = 1; frame_id <= kFrames; ++frame_id) {
    if (shadowfit::v1::Frame* frame = stream->Acquire()) {  // Null: the service is behind; render on.
      Describe(frame_id, frame);
      if (absl::Status status = stream->Submit(frame); !status.ok()) return Fail(status);
    }
    while (std::optional<shadowfit::FrameOutcome> outcome = stream->Poll()) Use(*outcome);
    RenderWithTheLatestMatrices();
  }

  while (stream->in_flight() > 0) {
    if (std::optional<shadowfit::FrameOutcome> outcome = stream->Wait(std::chrono::seconds(5))) Use(*outcome);
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: %s HOST:PORT | unix:PATH\n", argv[0]);
    return 2;
  }
  return StreamFrames(argv[1]);
}
