#include "core/bias/surface_samples.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>

namespace shadowfit {
namespace {

class DepthSurface {
 public:
  DepthSurface(const Camera& camera, const DepthView& depth) : camera_(camera), depth_(depth) {}

  bool IsSample(int x, int y) const {
    if (x < 0 || y < 0 || x >= depth_.width || y >= depth_.height) return false;
    const double z = depth_.At(x, y);
    return z >= 0.0 && z <= 1.0 && z != BackgroundWindowDepth(camera_.clip_depth());
  }

  glm::dvec3 Point(int x, int y) const {
    const glm::dvec4 ws =
        camera_.WsFromNdc({-1.0 + (2.0 * x + 1.0) / depth_.width, -1.0 + (2.0 * y + 1.0) / depth_.height,
                           NdcFromWindowDepth(camera_.clip_depth(), depth_.At(x, y))});
    return glm::dvec3(ws) / ws.w;
  }

  /// Along the surface towards growing x (dx = 1) or y (dy = 1).
  std::optional<glm::dvec3> Tangent(int x, int y, int dx, int dy, const glm::dvec3& centre) const {
    const bool after = IsSample(x + dx, y + dy);
    const bool before = IsSample(x - dx, y - dy);
    if (!after && !before) return std::nullopt;
    const double z = depth_.At(x, y);
    const bool take_after = after && (!before || std::abs(depth_.At(x + dx, y + dy) - z) <=
                                                     std::abs(depth_.At(x - dx, y - dy) - z));
    return take_after ? Point(x + dx, y + dy) - centre : centre - Point(x - dx, y - dy);
  }

 private:
  const Camera& camera_;
  const DepthView& depth_;
};

}  // namespace

SurfaceSamples SamplesFromDepth(const Camera& camera, const DepthView& depth, size_t max_samples) {
  const DepthSurface surface(camera, depth);
  int step = 1;
  const auto count = [&step](int size) { return static_cast<size_t>((size + step - 1) / step); };
  while (count(depth.width) * count(depth.height) > max_samples && step < std::max(depth.width, depth.height))
    ++step;
  const int columns = static_cast<int>(count(depth.width));
  const int rows = static_cast<int>(count(depth.height));
  const size_t pixels = static_cast<size_t>(columns) * static_cast<size_t>(rows);
  SurfaceSamples all;
  all.ws_point.resize(pixels);
  all.ws_normal.assign(pixels, glm::dvec3(0.0));
  tbb::parallel_for(tbb::blocked_range<int>(0, rows, 16), [&](const tbb::blocked_range<int>& range) {
    for (int row = range.begin(); row < range.end(); ++row) {
      for (int column = 0; column < columns; ++column) {
        const int x = column * step;
        const int y = row * step;
        if (!surface.IsSample(x, y)) continue;
        const glm::dvec3 point = surface.Point(x, y);
        const auto along_x = surface.Tangent(x, y, 1, 0, point);
        const auto along_y = surface.Tangent(x, y, 0, 1, point);
        if (!along_x || !along_y) continue;
        const glm::dvec3 normal = glm::cross(*along_x, *along_y);
        const double length = glm::length(normal);
        if (!(length > 0.0) || !std::isfinite(length)) continue;
        const bool towards_viewer = glm::dot(normal, camera.TowardsViewer(point)) > 0.0;
        const size_t i =
            static_cast<size_t>(row) * static_cast<size_t>(columns) + static_cast<size_t>(column);
        all.ws_point[i] = point;
        all.ws_normal[i] = (towards_viewer ? normal : -normal) / length;
      }
    }
  });
  // Close the gaps, in order.
  size_t kept = 0;
  for (size_t i = 0; i < pixels; ++i) {
    if (all.ws_normal[i] == glm::dvec3(0.0)) continue;
    all.ws_point[kept] = all.ws_point[i];
    all.ws_normal[kept] = all.ws_normal[i];
    ++kept;
  }
  all.ws_point.resize(kept);
  all.ws_normal.resize(kept);
  return all;
}

}  // namespace shadowfit
