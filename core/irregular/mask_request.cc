#include "core/irregular/mask_request.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/irregular/sample_kernels.h"

namespace shadowfit::irregular {
namespace {

template <typename T>
absl::Status CheckSize(const ImageView<T>& image, int width, int height, const std::string& name) {
  if (image.bottom_row == nullptr) {
    return absl::InvalidArgumentError(absl::StrCat(name, ": no data"));
  }
  if (image.width != width || image.height != height) {
    return absl::InvalidArgumentError(absl::StrFormat("%s: size %dx%d, but the first layer is %dx%d", name,
                                                      image.width, image.height, width, height));
  }
  return absl::OkStatus();
}

absl::Status CheckMovedInstances(const MaskRequest& request) {
  std::vector<size_t> instances;
  for (size_t i = 0; i < request.moved_instances.size(); ++i) {
    const MovedInstance& moved = request.moved_instances[i];
    if (moved.instance >= request.scene->InstanceCount()) {
      return absl::InvalidArgumentError(absl::StrFormat("moved_instances[%d].instance: %d, but there are %d",
                                                        i, moved.instance, request.scene->InstanceCount()));
    }
    for (int column = 0; column < 4; ++column) {
      for (int row = 0; row < 3; ++row) {
        if (std::isfinite(moved.world_from_object[column][row])) continue;
        return absl::InvalidArgumentError(
            absl::StrFormat("moved_instances[%d].world_from_object[%d]: not finite", i, 3 * column + row));
      }
    }
    instances.push_back(moved.instance);
  }
  std::sort(instances.begin(), instances.end());
  const auto twice = std::adjacent_find(instances.begin(), instances.end());
  if (twice == instances.end()) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrFormat("moved_instances: instance %d is there twice", *twice));
}

}  // namespace

absl::Status CheckRequest(const MaskRequest& request) {
  if (request.scene == nullptr) return absl::InvalidArgumentError("scene: none");
  if (absl::Status status = CheckMovedInstances(request); !status.ok()) return status;
  if (request.layers.empty()) return absl::InvalidArgumentError("layers: empty");
  const auto& first = request.layers[0];
  const int width = first.ws_positions.bottom_row != nullptr ? first.ws_positions.width : first.depth.width;
  const int height =
      first.ws_positions.bottom_row != nullptr ? first.ws_positions.height : first.depth.height;
  const int largest = MaskRenderer::kMaxSize;
  if (width <= 0 || height <= 0 || width > largest || height > largest) {
    return absl::InvalidArgumentError(
        absl::StrFormat("layers[0]: size %dx%d, both must be in [1, %d]", width, height, largest));
  }
  const size_t pixels = (static_cast<size_t>(width) + kStrip - 1) / kStrip * kStrip *
                        static_cast<size_t>(height) * request.layers.size();
  if (pixels > MaskRenderer::kMaxPixels) {
    return absl::InvalidArgumentError(absl::StrFormat("layers: %d of %dx%d, at most %d samples in all",
                                                      request.layers.size(), width, height,
                                                      MaskRenderer::kMaxPixels));
  }
  for (size_t i = 0; i < request.layers.size(); ++i) {
    const ReceiverLayer& layer = request.layers[i];
    const std::string name = absl::StrFormat("layers[%d]", i);
    if (layer.ws_positions.bottom_row != nullptr) {
      absl::Status status = CheckSize(layer.ws_positions, width, height, name + ".positions");
      if (!status.ok()) return status;
    } else {
      if (absl::Status status = CheckSize(layer.depth, width, height, name + ".depth"); !status.ok()) {
        return status;
      }
      if (request.camera == nullptr) {
        return absl::InvalidArgumentError(absl::StrCat("camera: none, but ", name, " has no positions"));
      }
      const glm::dvec2& offset = layer.pixel_offset;
      if (!(offset.x >= 0.0 && offset.x <= 1.0 && offset.y >= 0.0 && offset.y <= 1.0)) {
        return absl::InvalidArgumentError(
            absl::StrFormat("%s.pixel_offset: (%g, %g) is outside [0,1]", name, offset.x, offset.y));
      }
    }
    if (layer.ws_normals.bottom_row != nullptr) {
      absl::Status status = CheckSize(layer.ws_normals, width, height, name + ".normals");
      if (!status.ok()) return status;
    }
  }
  if (!request.known.empty() && request.known.size() != request.lights.size() * request.layers.size()) {
    return absl::InvalidArgumentError(absl::StrFormat("known: %d pictures for %d lights and %d layers",
                                                      request.known.size(), request.lights.size(),
                                                      request.layers.size()));
  }
  for (size_t i = 0; i < request.known.size(); ++i) {
    absl::Status status = CheckSize(request.known[i], width, height, absl::StrFormat("known[%d]", i));
    if (!status.ok()) return status;
  }
  return absl::OkStatus();
}

}  // namespace shadowfit::irregular
