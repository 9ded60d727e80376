#pragma once

#include <embree3/rtcore.h>

#include <cstdint>
#include <string>
#include <vector>

#include "core/scene/scene.h"
#include "tests/bench/masks/bench_scenes.h"

namespace shadowfit::bench {

/// How shadow rays are handed to Embree.
enum class RayKernel { kSingle, kPacket8, kPacket16, kStream };
struct TraceMode {
  RayKernel kernel = RayKernel::kPacket16;
  bool from_light = false;  ///< Rays run from the light to the sample, not the other way.
};
std::vector<TraceMode> AllTraceModes();
std::string Name(const TraceMode& mode);

/// The best that Embree does with the same task: hierarchies of different quality, all kinds of packets.
class EmbreeShadows {
 public:
  explicit EmbreeShadows(const BenchScene& bench, int threads);
  ~EmbreeShadows();
  EmbreeShadows(const EmbreeShadows&) = delete;
  EmbreeShadows& operator=(const EmbreeShadows&) = delete;

  void Build(RTCBuildQuality quality);

  /// Window depth of the camera's first hits; 1 where there is none.
  std::vector<float> Depth(const Camera& camera) const;

  /// One shadow ray a sample. `transmit`: multiply the transmittance of everything on the way.
  void Trace(const std::vector<glm::vec3>& ws_positions, const TraceMode& mode, bool transmit,
             std::vector<uint8_t>* shadow, std::vector<float>* transmittance) const;

 private:
  const BenchScene& bench_;
  RTCDevice device_ = nullptr;
  RTCScene scene_ = nullptr;
  std::vector<std::vector<glm::vec3>> positions_;  ///< World space, padded for Embree.
};

}  // namespace shadowfit::bench
